"""Writes docs/appendix/hard_cases.md: runs the hard cases, and lists each with what it measured.

python tests/hard_cases/table.py
"""

import ast
import sys
from pathlib import Path

import pytest

from soft_tendon_env.evaluation.pages import stamp

HERE = Path(__file__).parent
TABLE = HERE.parents[1] / "docs" / "appendix" / "hard_cases.md"
EXPECTED = "Expected: "
HEAD = """\
# Hard cases

{stamp}

Inputs and arms that are known to break simulators of soft arms, with measured errors. Each line is a test in `tests/hard_cases`. Its
docstring says why the case is hard and what is expected. A test with several parameters has the smallest and the largest number. At most
{numbers} quantities are listed; "holds" means that the test passes without a number. `python tests/hard_cases/table.py` runs the tests and
writes this page.
"""
NUMBERS = 3
"""Quantities of a case that are listed."""


def cases() -> dict[str, str]:
    """Docstrings of all hard cases by "file.py::test"."""
    found = {}
    for path in sorted(HERE.glob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_") and path.name != "test_table.py":
                found[f"{path.name}::{node.name}"] = " ".join((ast.get_docstring(node) or "").split())
    return found


def listed() -> list[str]:
    """The cases on the committed page."""
    found, file = [], ""
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            file = f"test_{line.removeprefix('## ').lower().replace(' ', '_')}.py"
        elif line.startswith("- `"):
            found.append(f"{file}::test_{line.split('`')[1]}")
    return found


class Measurements:
    """A pytest plugin: what the tests measured and how they ended, by case."""

    def __init__(self) -> None:
        self.values: dict[str, dict[str, list[float]]] = {}
        self.outcomes: dict[str, set[str]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        case = report.nodeid.rsplit("/", 1)[-1].split("[")[0]
        if report.when == "call" or report.outcome != "passed":
            outcome = "known defect" if hasattr(report, "wasxfail") else report.outcome
            self.outcomes.setdefault(case, set()).add(outcome)
        if report.when == "call":
            for what, value in report.user_properties:
                self.values.setdefault(case, {}).setdefault(what, []).append(value)

    def summary(self, case: str) -> str:
        unhappy = sorted(self.outcomes.get(case, {"not run"}) - {"passed"})
        numbers = [f"{what}: {_span(values)}" for what, values in self.values.get(case, {}).items()]
        return "; ".join([*unhappy, *numbers[:NUMBERS]]) or "holds"


def _span(values: list[float]) -> str:
    least, greatest = f"{min(values):.2g}", f"{max(values):.2g}"
    return least if least == greatest else f"{least}…{greatest}"


def page(summaries: dict[str, str], stamp: str) -> str:
    """The page: a section for every file, a line for every case."""
    lines, last = [HEAD.format(stamp=stamp, numbers=NUMBERS).rstrip()], ""
    for case, summary in summaries.items():
        file, _, test = case.partition("::")
        if file != last:
            lines.append(f"\n## {file.removeprefix('test_').removesuffix('.py').replace('_', ' ').capitalize()}\n")
        lines.append(f"- `{test.removeprefix('test_')}`: {summary}")
        last = file
    return "\n".join(lines) + "\n"


def main() -> int:
    measurements = Measurements()
    status = pytest.main(["-q", str(HERE), f"--ignore={HERE / 'test_table.py'}"], plugins=[measurements])
    summaries = {case: measurements.summary(case) for case in cases()}
    TABLE.write_text(page(summaries, stamp()), encoding="utf-8")
    print(f"{len(summaries)} tests, written: {TABLE}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
