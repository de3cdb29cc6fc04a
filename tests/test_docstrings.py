"""Docstrings make sense with the name above them removed, as the pages of the API show them."""

import re
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "soft_tendon_env"
RIDDLE = re.compile(r'^ *"""(What|Of|Where|The same|Likewise|See)\b', re.MULTILINE)
"""Beginnings of a docstring, or of the text below a constant, that need the name above it."""


def test_no_docstring_needs_the_name_above_it():
    texts = {path.relative_to(PACKAGE): path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    found = [f"{path}: {riddle[0].strip()}" for path, text in texts.items() for riddle in RIDDLE.finditer(text)]
    assert texts and not found, found
