"""Reading of files, one function per kind.

A file that is missing, cut or of something else is an error that names it. Files are replaced
whole, and checked by their digests. Files that are made once are kept in folders of the user's
cache.
"""

import codecs
import contextlib
import errno
import hashlib
import io
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.tools.messages import describe, first_line

PACKAGE = Path(__file__).parents[1]


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """All of a regular file: what is read from a device, a pipe or a socket may never end.

    Raises OSError.
    """
    exists = os.path.exists(path)
    is_readable = os.path.isfile(path) or os.path.isdir(path)
    if exists and not is_readable:
        raise OSError(errno.EINVAL, "it should be a regular file", os.fspath(path))
    return Path(path).read_bytes()


def read_text(path: Path, errors: str = "strict") -> str:
    """The text of a file in UTF-8; errors: what becomes of other bytes, see `bytes.decode`.

    Raises ValueError, FileNotFoundError.
    """
    try:
        content = read_bytes(path)
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            errors = "strict"
        return content.decode("utf-8-sig", errors).replace("\r\n", "\n")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as text in UTF-8: {describe(error)}") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object.

    Raises ValueError, FileNotFoundError.
    """
    try:
        value = json.loads(text := read_text(path))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is no JSON, or was cut off: {error}") from error
    except RecursionError:
        raise ValueError(f"{path} nests lists or tables too deep to be read") from None
    if not isinstance(value, dict):
        raise ValueError(f"{path} should be a JSON object, {{...}}, not {text[:80]}")
    return value


def read_arrays(path: str | Path, what: str) -> dict[str, NDArray[Any]]:
    """Arrays of an .npz file, none of them unpickled.

    `what` it should hold goes into the error. Raises OSError or ValueError.
    """
    content = read_bytes(path)
    try:
        with (
            zipfile.ZipFile(io.BytesIO(content)),
            np.load(io.BytesIO(content), allow_pickle=False) as file,
        ):
            return {name: file[name] for name in file.files}
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        RuntimeError,
        MemoryError,
        OSError,
        TypeError,
        ValueError,
        LookupError,
    ) as error:
        raise ValueError(f"{path} holds no {what}, or was damaged: {first_line(error)}") from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Path to write to, whose file takes the place of `path` at the end.

    That appears whole or not at all. Raises OSError.
    """
    name = f".{path.name}.{os.getpid()}.tmp"
    temporary = path.with_name(name)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises OSError.
    """
    return hashlib.sha256(read_bytes(path)).hexdigest()


def sources_digest(*patterns: str) -> str:
    """16 hex digits that change with the files of the package that match one of the patterns.

    Raises OSError.
    """
    files = sorted(file for pattern in patterns for file in PACKAGE.glob(pattern))
    return hashlib.sha256(
        "".join(f"{file.relative_to(PACKAGE)} {digest(file)}\n" for file in files).encode()
    ).hexdigest()[:16]


def digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder and those in it, by its name from there on.

    Raises OSError.
    """
    return {
        path.relative_to(folder).as_posix(): digest(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def check_digests(folder: Path, files: Mapping[str, str], source: Path) -> None:
    """Whether the files that `source` names are those that it was written with.

    Raises ValueError, FileNotFoundError.
    """
    paths = ((folder / name, expected) for name, expected in files.items())
    for path, expected in paths:
        if not path.is_file():
            raise FileNotFoundError(
                f"{folder} should have {path.name}, which {source} was written with"
            )
        if digest(path) != expected:
            raise ValueError(
                f"{path} is not the file that {source} was written with: it was cut or changed, or"
                " is of another training"
            )


def shipped_folder(inside: str, beside: str) -> Path:
    """Folder of files that ship, in a wheel or in a clone.

    It is `inside` the package in a wheel (force-include in pyproject.toml), `beside` it in a clone.
    """
    if (PACKAGE / inside).is_dir():
        return PACKAGE / inside
    return PACKAGE.parent / beside


CONFIGS = shipped_folder("learning/configs", "configs")  # the configurations that ship


def cache_parents() -> list[Path]:
    """Candidate parents of the cache folder, best first.

    They are what the user has chosen, then the usual places.
    """
    user = getattr(os, "getuid", int)()
    temporary = Path(tempfile.gettempdir(), f"soft_tendon_env-{user}")
    named = (
        os.environ.get("NUMBA_CACHE_DIR"),
        os.environ.get("XDG_CACHE_HOME"),
        os.path.expanduser("~/.cache"),
    )
    is_own = (
        not temporary.exists() or temporary.stat().st_uid == user
    )  # else somebody has put it there, with code that numba would run
    folders = [Path(folder).absolute() for folder in named if folder]
    return folders + [temporary] * is_own


def data_folders(name: str) -> list[Path]:
    """Folders `<user's cache>/soft_tendon_env/<name>` that exist, best first.

    See `cache_parents`.
    """
    return [
        folder
        for parent in cache_parents()
        if os.path.isdir(folder := parent / "soft_tendon_env" / name)
    ]


def new_data_folder(name: str) -> Path:
    """The first of these folders that can be written, created when missing.

    Raises OSError where there is none.
    """
    refused = ""
    for parent in cache_parents():
        try:
            return make_writable(parent / "soft_tendon_env" / name)
        except OSError as error:
            refused += f"{parent} cannot be used ({error.strerror}); "
    raise OSError(errno.EROFS, f"{refused}set NUMBA_CACHE_DIR to a folder that can be written")


def make_writable(folder: Path) -> Path:
    """The folder, created when missing.

    Raises OSError where no file can be written in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()  # a folder can exist and yet not be writable
    return folder
