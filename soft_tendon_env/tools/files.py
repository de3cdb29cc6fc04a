"""JSON and CSV files and digests: one that is missing, cut or of something else is an error that names it."""

import contextlib
import csv
import hashlib
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from soft_tendon_env.tools.failures import describe


def read_text(path: Path) -> str:
    """Raises ValueError, FileNotFoundError."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as text: {describe(error)}") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises ValueError, FileNotFoundError."""
    text = read_text(path)
    try:
        value = json.loads(text)
    except ValueError as error:
        raise ValueError(f"{path} is no JSON, or was cut off: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path} should be a JSON object, {{...}}, not {type(value).__name__}")
    return value


def read_numbers(path: Path, needed: Iterable[str] = ()) -> list[dict[str, float]]:
    """The rows of a CSV file of numbers; NaN for what is empty. `needed`: columns. Raises ValueError, FileNotFoundError."""
    text = read_text(path)
    if text and not text.endswith("\n"):
        raise ValueError(f"{path} was cut off: its last line does not end")
    reader = csv.reader(text.splitlines())
    header = next(reader, [])
    if missing := [name for name in needed if name not in header]:
        raise ValueError(f"{path} should have the columns {', '.join(needed)} in its first line, and lacks {', '.join(missing)}")
    rows = []
    for number, cells in enumerate(reader, 2):
        try:
            rows.append({name: float(cell) if cell else math.nan for name, cell in zip(header, cells, strict=True)})
        except ValueError as error:
            raise ValueError(f"{path}, line {number} should be {len(header)} numbers, not {','.join(cells)!r}") from error
    return rows


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to, whose file takes the place of `path` at the end: that appears whole or not at all. Raises OSError."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def digest(path: Path) -> str:
    """SHA-256 of a file. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder and those in it, by its name from there on. Raises OSError."""
    return {path.relative_to(folder).as_posix(): digest(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def check_digests(folder: Path, files: Mapping[str, str], source: Path) -> None:
    """Whether the files that `source` names are those that it was written with. Raises ValueError, FileNotFoundError."""
    for name, expected in files.items():
        path = folder / name
        try:
            same = digest(path) == expected
        except OSError as error:
            raise FileNotFoundError(f"{folder} should have {name}, which {source} was written with: {describe(error)}") from error
        if not same:
            raise ValueError(f"{path} is not the file that {source} was written with: it was cut or changed, or is of another training")
