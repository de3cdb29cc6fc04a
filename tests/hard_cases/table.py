"""Runs the hard cases, and lists each with what it measured, in out/hard_cases.md and .csv;
docs/generated.py takes both over into docs/appendix.

python tests/hard_cases/table.py
"""

import ast
import csv
import sys
from pathlib import Path

import pytest

from soft_tendon_env.evaluation.tables import markdown_table, write_markdown

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TABLE = ROOT / "docs" / "appendix" / "hard_cases.csv"
OUT = ROOT / "out"
EXPECTED = "Expected: "
HEAD = """\
# Hard cases

Inputs and arms that are known to break simulators of soft arms: {count} tests in
`tests/hard_cases`, twelve of them here. [All tests](hard_cases.csv) are in a CSV file, each with
the reason why it is hard, what is expected and what was measured. A test with several parameters
has its smallest and its largest number. `python tests/hard_cases/table.py` runs the tests and
writes both files.
"""
SHOWN = {
    "test_angles.py::test_rod_of_many_turns": "a rod wound up into many turns",
    "test_branches.py::test_payloads_that_fold_the_arm": "payloads that the arm can hardly carry",
    "test_branches.py::test_weight_that_grows_on_a_column": "a column that buckles",
    "test_branches.py::test_follower_force_on_a_column": (
        "a column that flutters under a force that follows its tip"
    ),
    "test_designs.py::test_catheter": "a stiff wire",
    "test_designs.py::test_four_tendons_make_three_coordinates": "redundant tendons",
    "test_elastic_tendons.py::test_stiff_tendons_come_to_rest_where_the_statics_says": (
        "cables of 2e5 to 1e7 N/m that go slack and taut"
    ),
    "test_energy.py::test_arm_without_damping_for_ten_seconds": "an arm without damping",
    "test_hostile.py::test_numbers_that_no_arm_has": "numbers from 5e-324 to 1e308 in every key",
    "test_impacts.py::test_two_hundred_throws_and_shots": "impacts at up to 30 m/s",
    "test_loads.py::test_abrupt_tension": "150 N at once, on one or all tendons",
    "test_loads.py::test_random_tensions_for_a_minute": "random tensions up to 150 N for a minute",
}
"""Cases on the page, in words; all are in the CSV file."""
NUMBERS = 3
"""Quantities of a case that are listed."""


def cases() -> dict[str, str]:
    """Docstrings of all hard cases by "file.py::test"."""
    found = {}
    for path in sorted(HERE.glob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if (
                isinstance(node, ast.FunctionDef)
                and node.name.startswith("test_")
                and path.name != "test_table.py"
            ):
                found[f"{path.name}::{node.name}"] = " ".join(
                    (ast.get_docstring(node) or "").split()
                )
    return found


def listed() -> list[str]:
    """The cases in the committed CSV file."""
    with open(TABLE, encoding="utf-8", newline="") as file:
        return [row["case"] for row in csv.DictReader(file)]


class Measurements:
    """A pytest plugin: what the tests measured and how they ended, by case."""

    def __init__(self) -> None:
        self.values: dict[str, dict[str, list[float]]] = {}
        self.outcomes: dict[str, set[str]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        case = report.nodeid.split("[")[0].rsplit("/", 1)[-1]
        if report.when == "call" or report.outcome != "passed":
            if hasattr(report, "wasxfail"):
                outcome = "known defect"
            else:
                outcome = report.outcome
            self.outcomes.setdefault(case, set()).add(outcome)
        if report.when == "call":
            for what, value in report.user_properties:
                self.values.setdefault(case, {}).setdefault(what, []).append(value)

    def summary(self, case: str) -> str:
        unhappy = sorted(self.outcomes.get(case, {"not run"}) - {"passed"})
        numbers = [f"{what}: {_span(values)}" for what, values in self.values.get(case, {}).items()]
        return "; ".join([*unhappy, *numbers[:NUMBERS]]) or "holds"


def _number(value: float) -> str:
    """Two digits, of numbers from a hundred on all in front of the point."""
    if abs(value) >= 100.0:
        return f"{value:,.0f}"
    return f"{value:.2g}"


def _span(values: list[float]) -> str:
    least = _number(min(values))
    greatest = _number(max(values))
    if least == greatest:
        return least
    return f"{least}…{greatest}"


def page(summaries: dict[str, str]) -> str:
    """The page: a row for every case of SHOWN."""
    rows = [[label, summaries[case]] for case, label in SHOWN.items()]
    head = HEAD.format(count=len(summaries))
    return f"{head}\n{markdown_table(('case', 'measured'), rows)}\n"


def main() -> int:
    measurements = Measurements()
    status = pytest.main(
        ["-q", str(HERE), f"--ignore={HERE / 'test_table.py'}"], plugins=[measurements]
    )
    known = cases()
    summaries = {case: measurements.summary(case) for case in known}
    write_markdown(OUT / "hard_cases.md", page(summaries))
    with open(OUT / "hard_cases.csv", "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("case", "why it is hard", "measured"))
        for case, reason in known.items():
            writer.writerow((case, reason, summaries[case]))
    print(f"{len(summaries)} tests, written: {file.name}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
