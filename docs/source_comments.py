"""Comments that describe fields in source code."""

import ast
import inspect
import re
import textwrap
from collections.abc import Sequence

BEHIND = re.compile(r"  # (.+)$")


def comment(lines: Sequence[str], first: int, last: int) -> str:
    """The comment at the end of a field's last line, or else the lines of comment above it; empty
    without any.

    first, last: numbers of the field's lines among all lines of the source, from 1.
    """
    behind = BEHIND.search(lines[last - 1])
    if behind:
        return behind[1]
    above: list[str] = []
    for line in reversed(lines[: first - 1]):
        if not line.lstrip().startswith("# "):
            break
        above.insert(0, line.strip().removeprefix("# "))
    return " ".join(above)


def comments_of_fields(kind: type) -> dict[str, str]:
    """Comments of the annotated fields of a class, and of those that it inherits, by name."""
    comments: dict[str, str] = {}
    for parent in reversed(kind.__mro__):
        if parent.__module__.startswith("soft_tendon_env."):
            comments |= _comments_of_own_fields(parent)
    return comments


def _comments_of_own_fields(kind: type) -> dict[str, str]:
    source = textwrap.dedent(inspect.getsource(kind))
    lines = source.splitlines()
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    return {
        node.target.id: comment(lines, node.lineno, node.end_lineno or node.lineno)
        for node in definition.body
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)
    }
