"""Columns of measured data: which of a file hold which quantity.

The table `[columns]` of the markers' file says so.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from soft_tendon_env.identification.markers import UNITS, MarkerSet
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.tables import Table, read_table

OPTIONAL_COLUMNS = {"time", "hold"}  # of which a file needs one, unless [columns] names them


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
    table = read_table(path, [source.column for source in expected.values()])
    sources = dict[str, Source]()
    for quantity, (column, factor) in expected.items():
        header_name = _header_name(table, column)
        if header_name is not None:
            sources[quantity] = Source(header_name, factor)
    _check_complete(table, expected, sources, OPTIONAL_COLUMNS - markers.columns.keys())
    if not table.rows:
        raise ValueError(f"{table.where}: there are no rows beneath the header")
    _check_decimal_marks(
        table,
        [source.column for name, source in sources.items() if name not in ("hold", "group")],
    )
    return table, sources


def matches_of(key: str, quantities: Iterable[str]) -> list[re.Match[str]]:
    """Quantities that a key of `[columns]` names; group 1 of a match is what its `*` stands for."""
    pattern = re.compile(re.escape(key).replace(r"\*", "(.+)"))
    return [match for match in map(pattern.fullmatch, quantities) if match is not None]


def _expected_columns(markers: MarkerSet, units: Mapping[str, str]) -> dict[str, Source]:
    """Columns by quantity as `[columns]` names them, otherwise by the quantity's own name.

    Raises ValueError for keys that are no quantities, and for units.
    """
    expected = {quantity: Source(quantity, 1.0) for quantity in units}
    # whole names come last: they beat patterns
    by_pattern = sorted(markers.columns.items(), key=lambda item: "*" not in item[0])
    for key, column in by_pattern:
        matches = matches_of(key, units)
        if not matches:
            raise ValueError(
                f"columns.{key} is no quantity that is read here: {not_among(key, units)}"
            )
        for match in matches:
            quantity = match[0]
            si_unit = units[quantity]
            factors = {si_unit: 1.0, **UNITS.get(si_unit, {})}
            unit = si_unit if column.unit is None else column.unit
            if unit not in factors:
                raise ValueError(
                    f"columns.{key}.unit is {unit!r}: it should be one of {', '.join(factors)}"
                )
            # a * in the column's name is what * stands for in the key, if there is one
            name = column.name or quantity
            if "*" in key:
                name = name.replace("*", match[1])
            expected[quantity] = Source(name, column.sign * factors[unit])
    return expected


def _header_name(table: Table, column: str) -> str | None:
    """Name of a column in a table's header, also in other letters of case; None without it.

    Raises ValueError for several.
    """
    matches = [name for name in table.header if name.casefold() == column.casefold()]
    exact = matches.count(column)
    if exact:
        matches = [column] * exact
    if len(matches) > 1:
        raise ValueError(f"{table.where}: column {column} is there {len(matches)} times")
    return matches[0] if matches else None


def _check_complete(
    table: Table,
    expected: Mapping[str, Source],
    sources: Mapping[str, Source],
    optional: set[str],
) -> None:
    """Raises ValueError where a table lacks columns, of `time` and `hold` both."""
    absent = expected.keys() - sources.keys() - optional
    missing = sorted(expected[quantity].column for quantity in absent)
    if not missing and not sources.keys() & OPTIONAL_COLUMNS:
        missing = sorted(OPTIONAL_COLUMNS)
    if missing:
        text = (
            f"there is no column {', '.join(missing)}: [columns] of the markers' file gives columns"
            " other names"
        )
        raise ValueError(f"{table.where}: {text}; {not_among(missing[0], table.header)}")


def _check_decimal_marks(table: Table, columns: Sequence[str]) -> None:
    """Raises ValueError where some numbers of the columns have decimal commas and some points."""
    places = [table.header.index(column) for column in columns]
    marks = dict[str, str]()  # the last row with each
    for where, cells in table.rows:
        for place in places:
            for mark in ",.":
                if mark in cells[place]:
                    marks[mark] = where
    if len(marks) > 1:
        raise ValueError(
            f"{marks[',']} has decimal commas and {marks['.']} points: numbers should have one"
            " decimal mark, and no others"
        )
