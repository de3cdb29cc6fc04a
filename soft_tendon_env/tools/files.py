"""Reading of files, one function per kind: bytes, text, JSON, TOML, CSV and arrays. A file that is missing, cut, endless or of something
else is an error that names it. Files are replaced whole, and checked by their digests."""

import codecs
import contextlib
import errno
import hashlib
import io
import json
import math
import os
import re
import stat
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.tools.messages import describe

PACKAGE = Path(__file__).parents[1]
MOST_TEXT, MOST_BINARY = 1 << 24, 1 << 28
"""Bytes of a file that is read whole: of text; of arrays and weights, packed or unpacked."""
MOST_DEPTH, MOST_DIGITS = 64, 400
TOO_DEEP = f"it is nested more than {MOST_DEPTH} deep"
LONG_KEY = re.compile(rf"""(?m)(?:^|[{{,\[])[ \t]*(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{MOST_DEPTH}}}""")
"""A dotted key of TOML, of which tomllib takes a time that grows with the square of its parts."""
UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, MemoryError, OSError, TypeError, ValueError, LookupError)
"""Errors of NumPy and zipfile for files that are empty, cut, altered or no archives at all."""


def open_file(path: str | os.PathLike[str]) -> io.BufferedReader:
    """A regular file, open for reading: what is read from a device, a pipe or a socket may never end. Raises OSError."""
    try:
        file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0)))
    except ValueError as error:  # a null in the name
        raise OSError(errno.EINVAL, str(error), repr(path)) from error
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is a device, a pipe or a socket, and should be a regular file", os.fspath(path))
    return file


def read_bytes(path: str | os.PathLike[str], most: int = MOST_BINARY) -> bytes:
    """All of a regular file of at most `most` bytes. Raises OSError."""
    with open_file(path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise OSError(errno.EFBIG, f"it has more than {most >> 20} MiB", os.fspath(path))
        return file.read(most)


def text_of(path: str | os.PathLike[str], most: int = MOST_TEXT, errors: str = "strict") -> str:
    """The text of a file in UTF-8, or UTF-16 with its mark, lines ending with a newline alone; errors: what becomes of other bytes, see
    `bytes.decode`. Raises OSError, UnicodeDecodeError."""
    content = read_bytes(path, most)
    encoding = "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    return io.TextIOWrapper(io.BytesIO(content), encoding, errors).read()


def read_text(path: Path, most: int = MOST_TEXT, errors: str = "strict") -> str:
    """The text of a file, see `text_of`. Raises ValueError, FileNotFoundError."""
    try:
        return text_of(path, most, errors)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as text: {describe(error)}") from error


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError."""
    if LONG_KEY.search(text):
        raise ValueError(TOO_DEEP)
    return dict(_parsed(tomllib.loads, text))


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError."""
    return _parsed(json.loads, text)


def _parsed(parse: Callable[[Any], Any], text: str | bytes) -> Any:
    try:
        value = parse(text)
    except RecursionError:
        raise ValueError(TOO_DEEP) from None
    level = [value]
    for _ in range(MOST_DEPTH):
        level = [own for table in level if isinstance(table, dict | list) for own in (table.values() if isinstance(table, dict) else table)]
    if any(isinstance(own, dict | list) for own in level):
        raise ValueError(TOO_DEEP)
    return value


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises ValueError, FileNotFoundError."""
    text = read_text(path)
    try:
        value = parse_json(text)
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
    header, *rows = [line.split(",") for line in text.splitlines()] or [[]]
    if missing := [name for name in needed if name not in header]:
        raise ValueError(f"{path} should have the columns {', '.join(needed)} in its first line, and lacks {', '.join(missing)}")
    found = []
    for number, cells in enumerate(rows, 2):
        try:
            found.append({name: float(cell) if cell else math.nan for name, cell in zip(header, cells, strict=True)})
            if max(map(len, cells)) > MOST_DIGITS:
                raise ValueError("these are no numbers")
        except ValueError as error:
            raise ValueError(f"{path}, line {number} should be {len(header)} numbers, not {','.join(cells)[:80]!r}") from error
    return found


def read_arrays(path: str | Path, names: Collection[str], what: str) -> dict[str, NDArray[Any]]:
    """The arrays of these names in an .npz file; `what` it should hold goes into the error.

    Raises TypeError, OSError or ValueError.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"path should be a str or a path, not {type(path).__name__}")
    content = read_bytes(path)
    try:
        saved = arrays_in(content)
        if missing := [name for name in names if name not in saved]:
            raise ValueError(f"{', '.join(missing)} missing")
        return {name: saved[name] for name in names}
    except UNREADABLE as error:
        raise ValueError(f"{path} holds no {what}: {error}") from error


def arrays_in(content: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in an .npz file's content, none of them unpickled. Raises what is in UNREADABLE."""
    archive(content).close()
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def archive(content: bytes) -> zipfile.ZipFile:
    """The zip archive of this content, of at most MOST_BINARY bytes when it is unpacked. Raises BadZipFile, ValueError."""
    found = zipfile.ZipFile(io.BytesIO(content))
    if sum(member.file_size for member in found.infolist()) > MOST_BINARY:
        raise ValueError(f"it has more than {MOST_BINARY >> 20} MiB when it is unpacked")
    return found


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
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sources_digest(*patterns: str) -> str:
    """16 hex digits that change with the files of the package that match one of the patterns. Raises OSError."""
    files = sorted(file for pattern in patterns for file in PACKAGE.glob(pattern))
    return hashlib.sha256("".join(f"{file.relative_to(PACKAGE)} {digest(file)}\n" for file in files).encode()).hexdigest()[:16]


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


def configs_folder() -> Path:
    """Folder of the configurations that ship."""
    return shipped_folder("learning/configs", "configs")


def shipped_folder(inside: str, beside: str) -> Path:
    """Folder of files that ship: `inside` the package in a wheel (force-include in pyproject.toml), `beside` it in a clone."""
    return PACKAGE / inside if (PACKAGE / inside).is_dir() else PACKAGE.parent / beside
