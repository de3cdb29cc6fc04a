"""Tables from CSV files in their dialects: rows of text, each with where it stands."""

import contextlib
import csv
import math
import warnings
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soft_tendon_env.tools.files import read_text
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
PREAMBLE = 100
"""Lines among which the header is looked for."""


class Table(NamedTuple):
    """Table of text.

    where: the header stands, with the separator that was recognised; rows: where each stands, and
    its cells.
    """

    where: str
    header: list[str]
    rows: list[tuple[str, list[str]]]

    def numbers(self, columns: Iterable[tuple[str, float]]) -> Array:
        """Numbers (rows, columns) of columns by name, times their factors.

        They are NaN where there are none. Raises ValueError for other text.
        """
        columns = list(columns)
        places = [self.header.index(name) for name, _ in columns]
        values = np.empty((len(self.rows), len(columns)))
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
        raise ValueError(
            f"{where}: {name} is {text!r}: it should be a finite number, or empty where there is"
            " none"
        )
    return value


def read_table(path: Path, names: Collection[str] = ()) -> Table:
    """The table of a CSV file.

    Its header is the line with most of the `names`, by default the first that is no comment. Its
    separator is a comma, semicolon, tab, bar or spaces. Blank lines and comments (#, %) are left
    out. Raises FileNotFoundError, and ValueError for a file that cannot be read.
    """
    text = read_text(path, "replace")  # bytes that are no text are no numbers
    lines = _whole_lines(path, text)
    place, separator, header = _header(lines, {name.casefold() for name in names})
    where = f"{path}, line {place + 1}"
    if len(header) > 1:
        where += f" (separated by {separator!r})"

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
        # A spreadsheet writes empty cells beyond the header's.
        if not any(cells[len(header) :]):
            cells = cells[: len(header)]
        if len(cells) != len(header):
            raise ValueError(
                f"{where_row}: there are {len(cells)} cells, the header has {len(header)}: {where}"
            )
        rows.append((where_row, cells))
    return Table(where, header, rows)


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
    """Place of the header among the lines, its separator and its cells."""
    best = 0, ",", list[str]()
    best_score = -1
    for place, line in enumerate(lines[:PREAMBLE]):
        is_comment = line.startswith(COMMENTS)
        text = line.lstrip("".join(COMMENTS) + " \t") if is_comment else line
        separator = max(SEPARATORS, key=text.count)
        if separator not in text.strip():
            separator = " "
        try:
            cells = _cells(text, separator)
        except csv.Error:  # which the reader tells, where this line is one of the table
            continue
        score = len(names.intersection(cell.casefold() for cell in cells))
        # A comment counts by its names alone: without any it is below the first other line.
        if is_comment:
            score -= 1
        if any(cells) and score > best_score:
            best = place, separator, cells
            best_score = score

    place, separator, header = best
    while header and not header[-1]:  # empty cells behind the last name
        header = header[:-1]
    return place, separator, header


def _whole_lines(path: Path, text: str) -> list[str]:
    """Lines of a table, without a last one that was cut off.

    The writer was killed, or power was lost; a warning says so.
    """
    text = text.rstrip("\0")  # of blocks that never came to the disk
    lines = text.splitlines()
    if len(lines) < 2 or text.endswith("\n"):
        return lines
    # Many editors write no last newline, so a line without is cut off only if it also has fewer
    # cells than the one before, or is of a log, whose rows all end with one.
    is_shorter = _separator_count(lines[-1]) < _separator_count(lines[-2])
    if LOGGED not in lines[0] and not is_shorter:
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
    values = table.numbers((name, 1.0) for name in table.header)
    return [dict(zip(table.header, row, strict=True)) for row in values.tolist()]
