"""Docstrings make sense with the name above them removed, as the pages of the API show them."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "soft_tendon_env"
RIDDLE = re.compile(r"(What|Of|Where|The same|Likewise|See)\b")
"""Beginnings of a docstring that need the name above it."""
NAMED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def docstrings(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring, and of every string beneath an assignment, of modules, classes and functions in one another."""
    body = node.body if isinstance(node, NAMED) else []
    for before, below in zip([None, *body], body, strict=False):
        yield from docstrings(below)
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str):
            if before is None or isinstance(before, ast.Assign | ast.AnnAssign):
                yield below.lineno, below.value.value


def riddles(tree: ast.Module) -> list[int]:
    """Lines of docstrings that begin as none should."""
    return [line for line, text in docstrings(tree) if RIDDLE.match(text.strip())]


def test_no_docstring_needs_the_name_above_it():
    files = sorted(PACKAGE.rglob("*.py"))
    found = [f"{path.relative_to(PACKAGE)}:{line}" for path in files for line in riddles(ast.parse(path.read_text(encoding="utf-8")))]
    assert files and not found, f"these begin with {RIDDLE.pattern}: {found}"


def test_riddles_are_found():
    source = 'class A:\n    """Arm."""\n    x: int = 1\n    """Where it is."""\n    def f(self):\n        """Likewise."""'
    assert sorted(riddles(ast.parse(source))) == [4, 6]
