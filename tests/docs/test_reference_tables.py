"""Tables of the reference that stand in the pages are those of the present code."""

import re
from pathlib import Path
from typing import Literal

import generated
import pytest
import reference_tables
import source_comments
from pydantic import BaseModel, Field

ROOT = Path(__file__).parents[2]
PAGES = {
    block: ROOT / entry.page
    for entry in generated.listed()
    for block in entry.blocks
    if not entry.is_measured
}
"""Pages by the names of their blocks."""


def test_all_tables_stand_in_a_page():
    assert PAGES.keys() == reference_tables.TABLES.keys()


@pytest.mark.parametrize("block", reference_tables.TABLES)
def test_tables_are_current(block):
    before, after = generated.around_markers(PAGES[block], block)
    text = PAGES[block].read_text(encoding="utf-8").removeprefix(before).removesuffix(after)
    shown = generated.MADE.sub("", text).strip()
    expected = reference_tables.TABLES[block]().strip()
    assert shown == expected, f"python docs/generated.py {PAGES[block].relative_to(ROOT)}"


@pytest.mark.parametrize(
    ("annotation", "words"),
    [
        (float, "number"),
        (int | None, "integer"),
        (tuple[float, float], "2 numbers"),
        (tuple[str, ...], "list of names"),
        (tuple[Literal["a", "b"], ...], "list of names"),
        (Literal["a", "b"], '`"a"`, `"b"`'),
        (str | dict[str, float], "text or table"),
    ],
)
def test_types_are_words(annotation, words):
    assert reference_tables.type_words(annotation) == words


def test_every_key_of_a_scene_says_what_it_is():
    rows = reference_tables.scene_keys().splitlines()[2:]
    assert len(rows) > 50
    unsaid = []
    for row in rows:
        meaning = row.split("|")[-2].strip()
        without_unit = reference_tables.UNIT.sub("", meaning)
        if not without_unit.strip(" ;"):
            unsaid.append(row)
    assert unsaid == []


def test_comments_stand_beside_a_field_or_above_it():
    lines = ["a: float  # [s]", "# of b,", "# [m]", "b: float = Field(", ")", "c: int"]
    of_a = source_comments.comment(lines, 1, 1)
    of_b = source_comments.comment(lines, 4, 5)
    of_c = source_comments.comment(lines, 6, 6)
    assert of_a == "[s]"
    assert of_b == "of b, [m]"
    assert of_c == ""


def test_keys_have_units_and_defaults():
    class Own(BaseModel):
        """A table.

        Attributes:
            speed: largest speed [m/s], which [-1, 1]
                maps to.
            name: of it.
        """

        speed: float = 2.0
        name: str = Field()

    table = reference_tables.keys(Own, "key")
    _, _, *lines = table.splitlines()
    rows = [re.split(r" *\| *", line)[1:-1] for line in lines]
    assert rows == [
        ["`speed`", "number", "m/s", "`2.0`", "largest speed [m/s], which [-1, 1] maps to."],
        ["`name`", "text", "", "required", "of it."],
    ]
