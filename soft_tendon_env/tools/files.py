"""Reading of files, one function per kind: text, JSON, CSV and arrays; a file that is missing, cut or of something else is an error that
names it. Files are replaced whole, and checked by their digests."""

import contextlib
import errno
import hashlib
import io
import json
import math
import os
import zipfile
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.tools.messages import describe

PACKAGE = Path(__file__).parents[1]
UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, MemoryError, OSError, TypeError, ValueError, LookupError)
"""Errors of NumPy and zipfile for files that are empty, cut, altered or no archives at all."""


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """All of a regular file: what is read from a device, a pipe or a socket may never end. Raises OSError."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError(errno.EINVAL, "it should be a regular file", os.fspath(path))
    return Path(path).read_bytes()


def read_text(path: Path, errors: str = "strict") -> str:
    """The text of a file in UTF-8; errors: what becomes of other bytes, see `bytes.decode`. Raises ValueError, FileNotFoundError."""
    try:
        return read_bytes(path).decode("utf-8-sig", errors).replace("\r\n", "\n")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as text: {describe(error)}") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises ValueError, FileNotFoundError."""
    try:
        value = json.loads(text := read_text(path))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is no JSON, or was cut off: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f"{path} should be a JSON object, {{...}}, not {text[:80]}")
    return value


def read_numbers(path: Path, needed: Iterable[str] = ()) -> list[dict[str, float]]:
    """The rows of a CSV file of numbers; NaN for what is empty. `needed`: columns. Raises ValueError, FileNotFoundError."""
    text = read_text(path)
    if text and not text.endswith("\n"):
        raise ValueError(f"{path} was cut off: its last line does not end")
    header, *rows = [line.split(",") for line in text.splitlines()] or [[]]
    if missing := [name for name in needed if name not in header]:
        raise ValueError(f"{path} should have the columns {', '.join(needed)} in its first line, and lacks {', '.join(missing)}")
    found = []
    for number, cells in enumerate(rows, 2):
        try:
            found.append({name: float(cell) if cell else math.nan for name, cell in zip(header, cells, strict=True)})
        except ValueError as error:
            raise ValueError(f"{path}, line {number} should be {len(header)} numbers, not {','.join(cells)[:80]!r}") from error
    return found


def read_arrays(path: str | Path, names: Collection[str], what: str) -> dict[str, NDArray[Any]]:
    """The arrays of these names in an .npz file; `what` it should hold goes into the error. Raises TypeError, OSError or ValueError."""
    content = read_bytes(path)
    try:
        saved = arrays_in(content)
        return {name: saved[name] for name in names}
    except UNREADABLE as error:
        raise ValueError(f"{path} holds no {what}: {error}") from error


def arrays_in(content: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in an .npz file's content, none of them unpickled. Raises what is in UNREADABLE."""
    with zipfile.ZipFile(io.BytesIO(content)), np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


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
    return hashlib.sha256(read_bytes(path)).hexdigest()


def sources_digest(*patterns: str) -> str:
    """16 hex digits that change with the files of the package that match one of the patterns. Raises OSError."""
    files = sorted(file for pattern in patterns for file in PACKAGE.glob(pattern))
    return hashlib.sha256("".join(f"{file.relative_to(PACKAGE)} {digest(file)}\n" for file in files).encode()).hexdigest()[:16]


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder and those in it, by its name from there on. Raises OSError."""
    return {path.relative_to(folder).as_posix(): digest(path) for path in sorted(folder.rglob("*")) if path.is_file()}


def check_digests(folder: Path, files: Mapping[str, str], source: Path) -> None:
    """Whether the files that `source` names are those that it was written with. Raises ValueError, FileNotFoundError."""
    for path, expected in ((folder / name, expected) for name, expected in files.items()):
        if not path.is_file():
            raise FileNotFoundError(f"{folder} should have {path.name}, which {source} was written with")
        if digest(path) != expected:
            raise ValueError(f"{path} is not the file that {source} was written with: it was cut or changed, or is of another training")


def configs_folder() -> Path:
    """Folder of the configurations that ship."""
    return shipped_folder("learning/configs", "configs")


def shipped_folder(inside: str, beside: str) -> Path:
    """Folder of files that ship: `inside` the package in a wheel (force-include in pyproject.toml), `beside` it in a clone."""
    return PACKAGE / inside if (PACKAGE / inside).is_dir() else PACKAGE.parent / beside
