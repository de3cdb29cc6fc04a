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

# column by which logs of robots are known, every row of which ends with a newline
LOGGED = "measured_time"
SEPARATORS = ",;\t|"  # of cells; a header with none of them is separated by spaces
COMMENTS = (
    "#",
    "%",
    # beginnings of lines that are skipped; the header may be one of them, as NumPy and rostopic
    # write it
)
ABSENT = {"", "nan", "na", "n/a", "null", "none"}  # cells that hold no number
PREAMBLE = 100  # lines among which the header is looked for


class Table(NamedTuple):
    """Table of text. where: the header stands, with the separator that was recognised; rows: where
    each stands, and its cells."""

    where: str
    header: list[str]
    rows: list[tuple[str, list[str]]]

    def numbers(self, columns: Iterable[tuple[str, float]]) -> Array:
        """Numbers (rows, columns) of columns by name, times their factors; NaN where there are
        none. Raises ValueError for other text."""
        places = [(self.header.index(name), name, factor) for name, factor in columns]
        found = [
            [read_number(where, name, cells[i], factor) for i, name, factor in places]
            for where, cells in self.rows
        ]
        return np.array(found, dtype=np.float64).reshape(len(self.rows), len(places))


def read_number(where: str, name: str, text: str, factor: float = 1.0) -> float:
    """A cell as a number, NaN where there is none. Raises ValueError for other text and
    infinity."""
    if text.casefold() in ABSENT:
        return math.nan
    try:
        value = math.nan if "_" in text else float(text.replace(",", ".")) * factor
    except ValueError:
        value = math.nan
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
    lines = _whole_lines(path, read_text(path, "replace"))  # bytes that are no text are no numbers
    first, separator, header = _header(lines, {name.casefold() for name in names})
    where = f"{path}, line {first + 1}" + (
        f" (separated by {separator!r})" if len(header) > 1 else ""
    )
    rows = list[tuple[str, list[str]]]()
    for number, line in enumerate(lines[first + 1 :], first + 2):
        try:
            cells = [] if line.startswith(COMMENTS) else _cells(line, separator)
        except csv.Error as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from error
        cells = (
            cells[: len(header)] if not any(cells[len(header) :]) else cells
        )  # without empty ones beyond the header's
        if any(cells):
            rows.append((f"{path}, line {number}", cells))
        if any(cells) and len(cells) != len(header):
            raise ValueError(
                f"{rows[-1][0]}: there are {len(cells)} cells, the header has {len(header)}:"
                f" {where}"
            )
    return Table(where, header, rows)


def _cells(line: str, separator: str) -> list[str]:
    """Cells of a line; where spaces separate, any number of them does, and tabs. Raises
    csv.Error."""
    line = " ".join(line.split()) if separator == " " else line
    return [
        cell.strip()
        for cell in next(
            csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), []
        )
    ]


def _header(lines: Sequence[str], names: set[str]) -> tuple[int, str, list[str]]:
    """Place of the header among the lines, its separator and its cells."""
    best, most = (0, ",", list[str]()), -1
    for place, line in enumerate(lines[:PREAMBLE]):
        is_comment = line.startswith(COMMENTS)
        text = line.lstrip("".join(COMMENTS) + " \t") if is_comment else line
        separator = max(SEPARATORS, key=text.count)
        separator = separator if separator in text.strip() else " "
        with contextlib.suppress(csv.Error):  # which the reader tells
            cells = _cells(text, separator)
            found = (
                len(names.intersection(map(str.casefold, cells))) - is_comment
            )  # a comment counts by its names alone
            if any(cells) and found > most:
                best, most = (place, separator, cells), found
    place, separator, cells = best
    while cells and not cells[-1]:
        cells = cells[:-1]
    return place, separator, cells


def _whole_lines(path: Path, text: str) -> list[str]:
    """Lines of a table, without a last one that was cut off when the writer was killed, or power
    was lost; a warning says so."""
    text = text.rstrip("\0")  # of blocks that never came to the disk
    lines = text.splitlines()
    if len(lines) > 1 and not text.endswith("\n"):
        earlier, last = (sum(map(line.count, SEPARATORS)) for line in lines[-2:])
        if LOGGED in lines[0] or last < earlier:
            warnings.warn(
                f"{path}, line {len(lines)} was cut off: it is left out, the rows before it are"
                " whole",
                stacklevel=2,
            )
            return lines[:-1]
    return lines


def read_numbers(path: Path, needed: Sequence[str] = ()) -> list[dict[str, float]]:
    """The rows of a CSV file of numbers; NaN for what is empty. `needed`: columns. Raises
    ValueError, FileNotFoundError."""
    if not read_text(path).endswith("\n"):
        raise ValueError(f"{path} was cut off: its last line does not end")
    table = read_table(path)
    if missing := [name for name in needed if name not in table.header]:
        raise ValueError(
            f"{table.where}: the header should have {', '.join(needed)}, and lacks"
            f" {', '.join(missing)}"
        )
    return [
        dict(zip(table.header, row, strict=True))
        for row in table.numbers((name, 1.0) for name in table.header).tolist()
    ]
