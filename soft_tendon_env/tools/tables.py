"""Tables from files: rows of text from CSV or Parquet, each with where it stands."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from soft_tendon_env.tools.files import MOST_BINARY, read_text

SUFFIXES = (".csv", ".parquet")


def rows_of(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Rows of a table, its header first, as where they stand and their cells; by its suffix it is Parquet, else CSV.

    Raises FileNotFoundError, and ValueError for a file that cannot be read, or for Parquet without PyArrow.
    """
    if path.suffix != ".parquet":
        lines = csv.reader(read_text(path, MOST_BINARY).splitlines())  # minutes of a log have tens of megabytes
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


def pyarrow() -> Any:
    """PyArrow with its Parquet files. Raises ValueError where it is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ValueError('tables in Parquet need PyArrow: pip install "soft_tendon_env[recording]", or take a .csv file') from error
    return pyarrow
