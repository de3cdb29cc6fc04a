"""Docstrings make sense with the name above them removed, as the pages of the API show them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "soft_tendon_env"
RIDDLE = re.compile(r"(What|Of|Where|The same|Likewise|See)\b")
"""Beginnings of a docstring that need the name above it."""
NAMED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring of modules, classes, functions, and of every string beneath an assignment."""
    for node in ast.walk(tree):
        if isinstance(node, NAMED) and (text := ast.get_docstring(node)):
            yield getattr(node, "lineno", 1), text
        if isinstance(node, ast.Module | ast.ClassDef):
            for assigned, below in zip(node.body, node.body[1:], strict=False):
                if isinstance(assigned, ast.Assign | ast.AnnAssign) and isinstance(below, ast.Expr):
                    if isinstance(below.value, ast.Constant) and isinstance(below.value.value, str):
                        yield below.lineno, below.value.value


def riddles(tree: ast.Module) -> list[int]:
    """Lines of docstrings that begin as none should."""
    return [line for line, text in docstrings(tree) if RIDDLE.match(text.strip())]


def test_no_docstring_needs_the_name_above_it():
    files = sorted(PACKAGE.rglob("*.py"))
    found = [f"{path.relative_to(PACKAGE)}:{line}" for path in files for line in riddles(ast.parse(path.read_text(encoding="utf-8")))]
    assert files and not found, f"these begin with {RIDDLE.pattern}: {found}"


@pytest.mark.cases(
    "source, lines",
    [
        ('"""What is here."""', [1]),
        ('"""Kernels."""\nX = 1\n"""Of the arm."""', [3]),
        ('class A:\n    """Arm."""\n    x: int\n    """Where it is."""\n    def f(self):\n        """Likewise."""', [5, 4]),
        ('def f():\n    """Whatever `Official` names say, seen from here."""', []),
    ],
)
def test_riddles_are_found(source, lines):
    assert sorted(riddles(ast.parse(source))) == sorted(lines)
