"""Columns of measured data: which of a file hold which quantity.

The table `[columns]` of the markers' file says so.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from soft_tendon_env.identification.markers import COUNTS, UNITS, Column, MarkerSet
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import Table, read_table

MOST_SHOWN = 200  # columns up to which an error lists them
LONGEST_NAME = 60  # letters of a column's name up to which it is one
OPTIONAL_COLUMNS = {"time", "hold"}  # of which a file needs one, unless [columns] names them


class Expected(NamedTuple):
    """Column that should hold a quantity, as `[columns]` says."""

    name: str
    key: str  # of `[columns]`
    entry: Column
    si_unit: str  # of the quantity, "" of text


class Source(NamedTuple):
    """Column of a file that holds a quantity, and the factor that makes SI units of its numbers."""

    column: str
    factor: float


def read_columns(
    path: Path, markers: MarkerSet, units: Mapping[str, str]
) -> tuple[Table, dict[str, Source]]:
    """Reads a CSV file and finds the columns that hold its quantities.

    Args:
        path: of the file.
        markers: with the table `[columns]`.
        units: SI units by quantity, "" of text.

    Returns:
        The table, and by quantity the columns that it has.

    Raises:
        ValueError: for columns that are missing, there twice, or in a unit that is unknown, for
            decimal marks of two kinds, and for a file without rows.
        FileNotFoundError: for a file that is missing.
    """
    expected = _expected_columns(markers, units)
    names = [column.name for column in expected.values()]
    table = read_table(path, names)
    sources = dict[str, Source]()
    for quantity, column in expected.items():
        header_name = _header_name(table, column.name)
        if header_name is not None:
            factor = _factor(column, header_name, table)
            sources[quantity] = Source(header_name, factor)
    # what a file names must be there
    optional = OPTIONAL_COLUMNS - markers.columns.keys()
    _check_complete(table, expected, sources, optional)
    if not table.rows:
        raise ValueError(f"{table.where}: there are no rows beneath the header")
    of_numbers = sources.keys() - {"hold", "group"}
    sources_of_numbers = [source for name, source in sources.items() if name in of_numbers]
    columns = [source.column for source in sources_of_numbers]
    _check_decimal_marks(table, columns)
    return table, sources


def matches_of(key: str, quantities: Iterable[str]) -> list[re.Match[str]]:
    """Quantities that a key of `[columns]` names; group 1 of a match is what its `*` stands for."""
    literal = re.escape(key)
    pattern = re.compile(literal.replace(r"\*", "(.+)"))
    return [match for match in map(pattern.fullmatch, quantities) if match is not None]


def _expected_columns(markers: MarkerSet, units: Mapping[str, str]) -> dict[str, Expected]:
    """Columns by quantity as `[columns]` names them, otherwise by the quantity's own name.

    Raises ValueError for keys that are no quantities, and for units.
    """
    expected = dict[str, Expected]()
    for quantity, unit in units.items():
        expected[quantity] = Expected(quantity, quantity, Column(), unit)
    # whole names come last: they beat patterns
    columns = markers.columns.items()
    by_pattern = sorted(columns, key=lambda item: "*" not in item[0])
    for key, column in by_pattern:
        matches = matches_of(key, units)
        if not matches:
            raise ValueError(
                f"columns.{key} is no quantity that is read here: {not_among(key, units)}"
            )
        for match in matches:
            quantity = match[0]
            unit = units[quantity]
            _check_unit(key, column, unit)
            # a * in the column's name is what * stands for in the key, if there is one
            name = column.name or quantity
            if "*" in key:
                name = name.replace("*", match[1])
            expected[quantity] = Expected(name, key, column, unit)
    return expected


def _check_unit(key: str, column: Column, si_unit: str) -> None:
    """Raises ValueError for a unit or a scale that a quantity cannot have.

    Counts need a scale.
    """
    has_scale = "scale" in column.model_fields_set
    if not si_unit and (column.unit or has_scale):
        raise ValueError(f"columns.{key} is text: it has neither a unit nor a scale")
    known = UNITS.get(si_unit, {si_unit: 1.0})
    allowed = [*known, COUNTS]
    has_unit = column.unit is not None
    if has_unit and column.unit not in allowed:
        names = ", ".join(allowed)
        message = f"columns.{key}.unit is {column.unit!r}: it should be one of {names}"
        raise ValueError(message)
    has_counts = column.unit == COUNTS
    if has_counts and not has_scale:
        raise ValueError(
            f"columns.{key}.unit is {COUNTS!r}: scale should say how many {si_unit} a count is"
        )


def _factor(expected: Expected, column: str, table: Table) -> float:
    """Factor that makes SI units of a column's numbers.

    Raises ValueError where the file itself gives another unit than `[columns]`.
    """
    units = UNITS.get(expected.si_unit, {})
    entry = expected.entry
    of_file = table.units.get(column)
    if of_file is not None and of_file not in units:
        of_file = None  # of another kind of quantity, such as a unit of what is counted
    unit = entry.unit or of_file or expected.si_unit
    if of_file is not None and unit != of_file:
        raise ValueError(
            f"{table.where}: column {column} is in {of_file}, says the file, and"
            f" columns.{expected.key}.unit is {unit!r}: they should be the same"
        )
    unit_factor = units.get(unit, 1.0)
    return entry.sign * entry.scale * unit_factor


def _header_name(table: Table, column: str) -> str | None:
    """Name of a column in a table's header, also in other letters of case; None without it.

    Raises ValueError for several.
    """
    if column in table.header:
        return column
    numbered = [name for name in table.header if name.rpartition(".")[0] == column]
    if f"{column}.0" in numbered:
        names = ", ".join(numbered)
        raise ValueError(
            f"{table.where}: column {column} is there {len(numbered)} times: [columns] names one of"
            f" them by {names}"
        )
    folded = column.casefold()
    matches = [name for name in table.header if name.casefold() == folded]
    if len(matches) > 1:
        names = " and as ".join(matches)
        message = f"{table.where}: column {column} is there as {names}"
        raise ValueError(message)
    if not matches:
        return None
    return matches[0]


def _check_complete(
    table: Table,
    expected: Mapping[str, Expected],
    sources: Mapping[str, Source],
    optional: set[str],
) -> None:
    """Raises ValueError where a table lacks columns, of `time` and `hold` both."""
    unread = expected.keys() - sources.keys()
    absent = unread - optional
    absent_names = (expected[quantity].name for quantity in absent)
    missing = sorted(absent_names)
    has_optional = bool(sources.keys() & OPTIONAL_COLUMNS)
    if not missing and not has_optional:
        missing = sorted(OPTIONAL_COLUMNS)
    if missing:
        names = ", ".join(missing)
        text = (
            f"there is no column {names}: [columns] of the markers' file gives columns other names"
        )
        columns_there = _columns_there(missing[0], table)
        message = f"{table.where}: {text}; {columns_there}"
        raise ValueError(message)


def _columns_there(missing: str, table: Table) -> str:
    """End of an error about a missing column: those of the table, or that there is none."""
    # what is no table is not shown
    cells = len(table.header)
    lengths = map(len, table.header)
    longest = max(lengths, default=0)
    is_long = cells > MOST_SHOWN or longest > LONGEST_NAME
    first_row = ""
    if table.rows:
        _, row = table.rows[0]
        first_row = "".join(row)
    is_digit = (character.isdigit() for character in first_row)
    has_numbers = any(is_digit)
    if is_long or not has_numbers:
        return (
            f"the line that seems to be the header has {cells} cells, the longest of {longest}"
            f" letters, and {len(table.rows)} rows beneath it: is the file a table?"
        )
    return not_among(missing, table.header)


def _check_decimal_marks(table: Table, columns: Sequence[str]) -> None:
    """Raises ValueError where some numbers of the columns have decimal commas and some points."""
    places = [table.header.index(column) for column in columns]
    marks = dict[str, str]()  # the last row with each
    for where, cells in table.rows:
        for place in places:
            is_date = ":" in cells[place]
            for mark in ",.":
                has_mark = mark in cells[place]
                if has_mark and not is_date:
                    marks[mark] = where
    if len(marks) > 1:
        raise ValueError(
            f"{marks[',']} has decimal commas and {marks['.']} points: numbers should have one"
            " decimal mark, and no others"
        )
