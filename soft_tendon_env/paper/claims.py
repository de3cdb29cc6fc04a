"""Claims of the paper about its figures, beside what is measured here."""

from collections.abc import Iterable
from typing import Any, NamedTuple

from soft_tendon_env.evaluation.tables import markdown_table


class Claim(NamedTuple):
    figure: str
    paper: str  # what it says
    measured: str
    holds: bool


class Result(NamedTuple):
    """Claims and numbers of a reproduced figure."""

    claims: list[Claim]
    numbers: dict[str, Any]  # for JSON
    more: str = ""  # further tables


def claims_table(claims: Iterable[Claim]) -> str:
    """Table of claims, as text that is Markdown as well."""
    rows = [(*claim[:3], "yes" if claim.holds else "**NO, missed**") for claim in claims]
    return markdown_table(("figure", "the paper", "measured", "holds"), rows)
