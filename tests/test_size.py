"""The size of the project. Who needs more than a limit takes something else out, or changes this
table by hand."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROSE = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*.md")


def lines(path):
    return path.read_text(encoding="utf-8").count("\n")


def lines_below(folder):
    return sum(map(lines, (ROOT / folder).rglob("*.py")))


SIZES = {
    "lines of the package": lambda: lines_below("soft_tendon_env"),
    "lines of the tests": lambda: lines_below("tests"),
    "lines of the largest folder": lambda: max(
        lines_below(path) for path in (ROOT / "soft_tendon_env").iterdir() if path.is_dir()
    ),
    "lines of the longest file": lambda: max(
        lines(path) for name in ("soft_tendon_env", "tests") for path in (ROOT / name).rglob("*.py")
    ),
    "words of the documentation": lambda: sum(
        len(path.read_text(encoding="utf-8").split()) for glob in PROSE for path in ROOT.glob(glob)
    ),
}
LIMITS = {
    "lines of the package": 28_700,
    "lines of the tests": 16_500,
    "lines of the largest folder": 6_000,
    "lines of the longest file": 330,
    "words of the documentation": 35_000,
}


@pytest.mark.parametrize("name", SIZES)
def test_the_project_keeps_its_size(name):
    size, limit = SIZES[name](), LIMITS[name]
    assert size <= limit, f"{size} {name}: there should be at most {limit}"
