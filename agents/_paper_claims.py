"""What the paper says of its figures beside what is measured here."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple


class Claim(NamedTuple):
    figure: str
    paper: str  # what it says
    measured: str
    holds: bool


class Result(NamedTuple):
    """What reproducing a figure gives."""

    claims: list[Claim]
    numbers: dict[str, Any]  # for JSON
    more: str = ""  # another table


def claims_table(claims: Iterable[Claim]) -> str:
    """As text that is Markdown as well."""
    return table(("figure", "the paper", "measured", ""), [(*claim[:3], "OK" if claim.holds else "not") for claim in claims])


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Columns as wide as what they hold, as text that is Markdown as well."""
    lines = [header, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join("| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines)
