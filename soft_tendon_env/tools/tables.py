"""Tables from files: rows of text from CSV or Parquet, each with where it stands."""

import csv
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from soft_tendon_env.tools.files import MOST_BINARY, read_text

LOGGED = "measured_time"
"""Column by which logs of robots are known, every row of which ends with a newline."""


def rows_of(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Rows of a table, its header first, as where they stand and their cells; by its suffix it is Parquet, else CSV.

    Raises FileNotFoundError, and ValueError for a file that cannot be read, or for Parquet without PyArrow.
    """
    if path.suffix != ".parquet":
        lines = csv.reader(whole_lines(path, read_text(path, MOST_BINARY)))  # minutes of a log have tens of megabytes
        for cells in lines:
            yield f"{path}, line {lines.line_num}", cells
        return
    try:
        columns = pyarrow().parquet.read_table(path).to_pydict()
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except OSError as error:  # ArrowInvalid is a ValueError that says all
        raise ValueError(f"{path} cannot be read as Parquet: {error}") from error
    yield str(path), [*columns]
    for number, values in enumerate(zip(*columns.values(), strict=True), 1):
        yield f"{path}, row {number}", ["" if value is None else str(value) for value in values]


def whole_lines(path: Path, text: str) -> list[str]:
    """Lines of a table, without a last one that was cut off when the writer was killed, or power was lost; a warning says so."""
    text = text.rstrip("\0")  # of blocks that never came to the disk
    lines = text.splitlines()
    if len(lines) > 1 and not text.endswith("\n"):
        earlier, last = (sum(map(line.count, ",;\t|")) for line in lines[-2:])
        if LOGGED in lines[0] or last < earlier:
            warnings.warn(f"{path}, line {len(lines)} was cut off: it is left out, the rows before it are whole", stacklevel=2)
            return lines[:-1]
    return lines


def pyarrow() -> Any:
    """PyArrow with its Parquet files. Raises ValueError where it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ValueError('tables in Parquet need PyArrow: pip install "soft_tendon_env[recording]", or take a .csv file') from error
    return pyarrow
