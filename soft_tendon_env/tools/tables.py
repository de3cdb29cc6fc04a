"""Tables from CSV files in their dialects: rows of text, each with where it stands."""

import contextlib
import csv
import math
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from soft_tendon_env.tools.files import read_text
from soft_tendon_env.tools.types import Array

LOGGED = "measured_time"
"""Column by which logs of robots are known, every row of which ends with a newline."""
SEPARATORS, COMMENTS = ",;\t", ("#", "%")
"""Separators of cells; beginnings of lines that are skipped."""
ABSENT = {"", "nan", "na", "n/a", "null", "none"}
"""Cells that hold no number."""


class Table(NamedTuple):
    """Table of text. where: the header stands, with the separator that was recognised; rows: where each stands, and its cells."""

    where: str
    header: list[str]
    rows: list[tuple[str, list[str]]]

    def numbers(self, columns: Iterable[tuple[str, float]]) -> Array:
        """Numbers (rows, columns) of columns by name, times their factors; NaN where there are none. Raises ValueError for other text."""
        places = [(self.header.index(name), name, factor) for name, factor in columns]
        found = [[read_number(where, name, cells[i], factor) for i, name, factor in places] for where, cells in self.rows]
        return np.array(found, dtype=np.float64).reshape(len(self.rows), len(places))


def read_number(where: str, name: str, text: str, factor: float = 1.0) -> float:
    """A cell as a number, NaN where there is none. Raises ValueError for other text and infinity."""
    if text.casefold() in ABSENT:
        return math.nan
    with contextlib.suppress(ValueError):
        if "_" not in text and math.isfinite(value := float(text.replace(",", ".")) * factor):
            return value
    raise ValueError(f"{where}: {name} is {text!r}: it should be a finite number, or empty where there is none")


def read_table(path: Path) -> Table:
    """The table of a CSV file, separated by commas, semicolons or tabs.

    Its header is the first line that is no comment (#, %). Blank lines and comments are left out. Raises FileNotFoundError, and ValueError
    for a file that cannot be read.
    """
    lines = _whole_lines(path, read_text(path, "replace"))  # bytes that are no text are no numbers
    rows = [(number, line) for number, line in enumerate(lines, 1) if line.strip(SEPARATORS + " ") and not line.startswith(COMMENTS)]
    separator = max(SEPARATORS, key=rows[0][1].count) if rows else ","
    reader = csv.reader((line for _, line in rows), delimiter=separator, skipinitialspace=True, strict=True)
    try:
        cells = [[cell.strip() for cell in row] for row in reader]
    except csv.Error as error:
        raise ValueError(f"{path}, line {rows[reader.line_num - 1][0]} cannot be read: {error}") from error
    (header, *found), numbers = cells or [[]], [number for number, _ in rows]
    where = f"{path}, line {numbers[0] if rows else 1}" + (f" (separated by {separator!r})" if len(header) > 1 else "")
    for number, row in zip(numbers[1:], found, strict=True):
        if len(row) != len(header):
            raise ValueError(f"{path}, line {number}: there are {len(row)} cells, the header has {len(header)}: {where}")
    return Table(where, header, [(f"{path}, line {number}", row) for number, row in zip(numbers[1:], found, strict=True)])


def _whole_lines(path: Path, text: str) -> list[str]:
    """Lines of a table, without a last one that was cut off when the writer was killed, or power was lost; a warning says so."""
    lines = text.rstrip("\0").splitlines()  # of blocks that never came to the disk
    if len(lines) > 1 and not text.rstrip("\0").endswith("\n"):
        earlier, last = (sum(map(line.count, SEPARATORS)) for line in lines[-2:])
        if LOGGED in lines[0] or last < earlier:
            warnings.warn(f"{path}, line {len(lines)} was cut off: it is left out, the rows before it are whole", stacklevel=2)
            return lines[:-1]
    return lines
