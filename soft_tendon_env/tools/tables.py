"""Tables from CSV files in their dialects, and from arrays of MATLAB and NumPy.

A table has rows of text, each with where it stands.
Trackers write a block of lines above the table: OptiTrack Motive and Vicon Nexus give names over
three columns X, Y, Z, which become `NAME X`, and Nexus a line of units beneath the header.
"""

import contextlib
import csv
import math
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soft_tendon_env.tools.array_tables import ARRAY_FILES, read_arrays
from soft_tendon_env.tools.file_kinds import check_is_text
from soft_tendon_env.tools.files import read_text
from soft_tendon_env.tools.table_headers import column_names, length_unit, unit_of
from soft_tendon_env.tools.types import Array

LOGGED = "measured_time"
"""Column by which logs of robots are known, every row of which ends with a newline."""
SEPARATORS = ",;\t|"
"""Separators of cells; a header with none of them is separated by spaces."""
COMMENTS = ("#", "%")
"""Beginnings of lines that are skipped; the header may be one of them, as NumPy and rostopic write
it."""
ABSENT = {"", "nan", "na", "n/a", "null", "none"}
"""Cells that hold no number."""
SHOWN = 40
"""Letters of a cell that an error shows."""
PREAMBLE = 100
"""Lines among which the header is looked for."""
BLOCK = 6
"""Lines after an empty one among which it is too, of another part of the file."""


class Table(NamedTuple):
    """Table of text.

    where: the header stands, with the separator that was recognised; rows: where each stands, and
    its cells; units: that the file itself gives, by columns.
    """

    where: str
    header: list[str]
    rows: list[tuple[str, list[str]]]
    units: Mapping[str, str]

    def numbers(self, columns: Iterable[tuple[str, float]]) -> Array:
        """Numbers (rows, columns) of columns by name, times their factors.

        They are NaN where there are none. Raises ValueError for other text.
        """
        columns = list(columns)
        places = [self.header.index(name) for name, _ in columns]
        shape = (len(self.rows), len(columns))
        values = np.empty(shape)
        for i, (where, cells) in enumerate(self.rows):
            for j, (name, factor) in enumerate(columns):
                text = cells[places[j]]
                values[i, j] = read_number(where, name, text, factor)
        return values


def read_number(where: str, name: str, text: str, factor: float = 1.0) -> float:
    """A cell as a number, NaN where there is none.

    Raises ValueError for other text and infinity.
    """
    if text.casefold() in ABSENT:
        return math.nan
    value = math.nan
    if "_" not in text:  # which Python allows within numbers, and nobody writes into tables
        with contextlib.suppress(ValueError):  # it stays NaN, which is refused below
            value = float(text.replace(",", ".")) * factor
    if not math.isfinite(value):
        if len(text) <= SHOWN:
            shown = text
        else:
            shown = f"{text[:SHOWN]}..."
        raise ValueError(
            f"{where}: {name} is {shown!r}: it should be a finite number, or empty where there is"
            " none"
        )
    return value


def read_table(path: Path, names: Collection[str] = ()) -> Table:
    """The table of a CSV file, or of a .mat or .npz file.

    Its header is the line with most of the `names`, by default the first that is no comment. Its
    separator is a comma, semicolon, tab, bar or spaces. Blank lines and comments (#, %) are left
    out. Raises FileNotFoundError, and ValueError for a file that cannot be read.
    """
    if path.suffix.lower() in ARRAY_FILES:
        header, array_rows = read_arrays(path)
        return Table(str(path), header, array_rows, {})
    check_is_text(path)
    text = read_text(path, "replace")  # bytes that are no text are no numbers
    lines = _whole_lines(path, text)
    folded = {name.casefold() for name in names}
    place, separator, header = _header(lines, folded)
    where = f"{path}, line {place + 1}"
    if len(header) > 1:
        where += f" (separated by {separator!r})"
    units = _units_above(lines[:place], separator, header)

    rows = list[tuple[str, list[str]]]()
    for i in range(place + 1, len(lines)):
        if lines[i].startswith(COMMENTS):
            continue
        where_row = f"{path}, line {i + 1}"
        try:
            cells = _cells(lines[i], separator)
        except csv.Error as error:
            raise ValueError(f"{where_row} cannot be read: {error}") from error
        if not any(cells):
            continue
        if _is_title(lines, i, separator):
            break
        # A spreadsheet writes empty cells beyond the header's.
        if not any(cells[len(header) :]):
            cells = cells[: len(header)]
        if not rows and _is_line_of_units(cells):
            pairs = zip(header, map(unit_of, cells), strict=False)
            units = dict(pairs)
            continue
        if len(cells) != len(header):
            raise ValueError(
                f"{where_row}: there are {len(cells)} cells, the header has {len(header)}: {where}"
            )
        rows.append((where_row, cells))
    known_units = {name: unit for name, unit in units.items() if unit}
    return Table(where, header, rows, known_units)


def _units_above(above: Sequence[str], separator: str, header: Sequence[str]) -> dict[str, str]:
    """Units of columns by the lines above the header: Motive has one for all lengths."""
    unit = length_unit(_cells_of_block(above, separator))
    places = [name for name in header if name.endswith((" X", " Y", " Z"))]
    return {name: unit for name in places if "Rotation" not in name}


def _is_line_of_units(cells: Sequence[str]) -> bool:
    """Whether the cells of a row have units and no number, as beneath the header of Nexus."""
    has_units = any(unit_of(cell) for cell in cells)
    return has_units and not any(_is_number(cell) for cell in cells)


def _is_title(lines: Sequence[str], i: int, separator: str) -> bool:
    """Whether another table begins with line i, as Nexus writes it.

    An empty line is before it, and its sample rate alone in the one after.
    """
    last_row = len(lines) - 1
    if not 0 < i < last_row:
        return False
    before = _cells(lines[i - 1], separator)
    if any(before):
        return False
    title_cells = _cells(lines[i], separator)
    rate_cells = _cells(lines[i + 1], separator)
    titles = [cell for cell in title_cells if cell]
    rates = [cell for cell in rate_cells if cell]
    are_single = len(titles) == 1 and len(rates) == 1
    if not are_single:
        return False
    return _is_number(rates[0]) and not _is_number(titles[0])


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line; where spaces separate, any number of them does, and tabs.

    Raises csv.Error.
    """
    if separator == " ":
        line = " ".join(line.split())
    reader = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True)
    cells = next(reader, [])
    return [cell.strip() for cell in cells]


def _header(lines: Sequence[str], names: set[str]) -> tuple[int, str, list[str]]:
    """Place of the header among the lines, its separator and the names of its columns."""
    best = 0, ",", list[str]()
    best_score = -1
    for place in _header_places(lines):
        line = lines[place]
        is_comment = line.startswith(COMMENTS)
        if is_comment:
            text = line.lstrip("".join(COMMENTS) + " \t")
        else:
            text = line
        separator = max(SEPARATORS, key=text.count)
        if separator not in text.strip():
            separator = " "
        try:
            cells = _cells(text, separator)
        except csv.Error:  # which the reader tells, where this line is one of the table
            continue
        while cells and not cells[-1]:  # empty cells behind the last name
            cells = cells[:-1]
        above = _cells_of_block(lines[:place], separator)
        cells = column_names(cells, above)
        folded = (cell.casefold() for cell in cells)
        known_cells = names.intersection(folded)
        score = len(known_cells)
        # A comment counts by its names alone: without any it is below the first other line.
        if is_comment:
            score -= 1
        if any(cells) and score > best_score:
            best = place, separator, cells
            best_score = score
    return best


def _header_places(lines: Sequence[str]) -> list[int]:
    """Lines that may be a header: the first ones, and those after an empty line."""
    searched = min(PREAMBLE, len(lines))
    places = [*range(searched)]
    since_empty = BLOCK
    for place, line in enumerate(lines):
        if line.strip():
            since_empty = since_empty + 1
        else:
            since_empty = 0
        if place >= PREAMBLE and 0 < since_empty <= BLOCK:
            places.append(place)
    return places


def _cells_of_block(above: Sequence[str], separator: str) -> list[list[str]]:
    """Cells of the last lines above a header."""
    block = list[list[str]]()
    for line in above[-BLOCK:]:
        with contextlib.suppress(csv.Error):  # a line that is no row names no column
            block.append(_cells(line, separator))
    return block


def _whole_lines(path: Path, text: str) -> list[str]:
    """Lines of a table, without a last one that was cut off.

    The writer was killed, or power was lost; a warning says so.
    """
    text = text.rstrip("\0")  # of blocks that never came to the disk
    lines = text.splitlines()
    is_short = len(lines) < 2
    if is_short or text.endswith("\n"):
        return lines
    # Many editors write no last newline, so a line without is cut off only if it also has fewer
    # cells than the one before, or is of a log, whose rows all end with one.
    last_count = _separator_count(lines[-1])
    count_before = _separator_count(lines[-2])
    is_shorter = last_count < count_before
    is_plain = LOGGED not in lines[0]
    if is_plain and not is_shorter:
        return lines
    warnings.warn(
        f"{path}, line {len(lines)} was cut off: it is left out, the rows before it are whole",
        stacklevel=2,
    )
    return lines[:-1]


def _separator_count(line: str) -> int:
    return sum(line.count(separator) for separator in SEPARATORS)


def read_numbers(path: Path, needed: Sequence[str] = ()) -> list[dict[str, float]]:
    """The rows of a CSV file of numbers; NaN for what is empty.

    `needed`: columns. Raises ValueError, FileNotFoundError.
    """
    if not read_text(path).endswith("\n"):
        raise ValueError(f"{path} was cut off: its last line does not end")
    table = read_table(path)
    missing = [name for name in needed if name not in table.header]
    if missing:
        raise ValueError(
            f"{table.where}: the header should have {', '.join(needed)}, and lacks"
            f" {', '.join(missing)}"
        )
    columns = ((name, 1.0) for name in table.header)
    values = table.numbers(columns)
    rows = values.tolist()
    return [dict(zip(table.header, row, strict=True)) for row in rows]
