"""Machine code on disk: the cache folder of this version, and in it a folder for every kernel.

Its files are read only if they are those that were written.

numba writes these files and reads them without a check. One that was cut (a full disk, a power
failure) ends in a traceback at every start; of one with other bytes LLVM ends the process, or runs
what they happen to mean. Digests lie beside each folder therefore, and are compared before numba
reads.
"""

import contextlib
import functools
import hashlib
import json
import os
import re
import shutil
import stat
from pathlib import Path
from typing import Any

import numba
from numba import config

from soft_tendon_env.tools.files import (
    PACKAGE,
    check_digests,
    data_folders,
    digests,
    make_writable,
    new_data_folder,
    read_json,
    replacing,
    sources_digest,
)
from soft_tendon_env.tools.messages import say

KERNEL_SOURCES = ("compiler/*.py", "mechanics/**/*.py", "effects/**/*.py", "envs/kernels.py")
"""Files of the package that machine code is made from."""
FOLDERS_KEPT = 3
"""Versions of the machine code that stay in the user's cache."""
OWNERS = stat.S_IRWXU
"""Permissions of folders that the user alone reads and writes."""


def is_of_package(named: Any) -> bool:
    """Tells whether a function or class is the package's own and no local one.

    Every process then finds it by its name.
    """
    package = (named.__module__ or "").partition(".")[0]
    return package == PACKAGE.name and "<locals>" not in named.__qualname__


class KernelLocator:
    """Tells numba where the machine code of one kernel lies: in the folder that it is given.

    numba's own locators add a folder for the path of the source file, so that every clone and every
    virtual environment would compile the same sources anew. numba asks for these methods.
    """

    def __init__(self, folder: Path, line: int) -> None:
        self._folder = folder
        self._line = line

    @classmethod
    def from_function(cls, function: Any, file: str) -> "KernelLocator | None":
        """Locator for a function with the folder in numba's `CACHE_DIR`.

        None: that cannot be written.
        """
        locator = cls(Path(config.CACHE_DIR), function.__code__.co_firstlineno)
        try:
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator

    def ensure_cache_path(self) -> None:
        """Creates the folder when missing.

        Raises OSError where it cannot be written.
        """
        make_writable(self._folder)

    def get_cache_path(self) -> str:
        """Folder of numba's files."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Version of the sources, which is the same for every file of a folder."""
        return self._folder.parent.name

    def get_disambiguator(self) -> str:
        """Part of a file's name for functions of one name: the line."""
        return str(self._line)


@functools.cache
def cache_folder() -> Path | None:
    """Folder of this version's machine code, created when missing; None: there is none.

    It is `<user's cache>/soft_tendon_env/<digest>`.
    """
    made_from = sources_digest(*KERNEL_SOURCES), numba.__version__, config.OPT, config.BOUNDSCHECK
    name = hashlib.sha256(repr(made_from).encode()).hexdigest()[:16]
    known = data_folders(name)
    try:
        folder = new_data_folder(name)
        os.utime(folder)
    except OSError as error:
        say(f"{error.strerror}: every process compiles again")
        return None
    if folder not in known and known and not os.access(known[0], os.W_OK):
        # numba loads from folders alone that it can write
        _copy_read_only(known[0], folder)
    _remove_outdated(folder.parent)
    return folder


def _copy_read_only(source: Path, folder: Path) -> None:
    """Copies machine code that cannot be written where it is; what cannot be copied is compiled."""
    with contextlib.suppress(OSError):
        shutil.copytree(source, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    # each folder has the permissions of its source, in which nothing could be written
    with contextlib.suppress(OSError):
        folder.chmod(OWNERS)
        for path in folder.rglob("*"):
            if path.is_dir():
                path.chmod(OWNERS)


def _remove_outdated(parent: Path) -> None:
    """Removes all versions but the newest."""
    ages = {}
    for path in parent.iterdir():
        if re.fullmatch("[0-9a-f]{16}", path.name):
            # Another process may remove it at the same time.
            with contextlib.suppress(OSError):
                ages[path] = path.stat().st_mtime
    newest_first = sorted(ages, key=ages.__getitem__, reverse=True)
    for outdated in newest_first[FOLDERS_KEPT:]:
        shutil.rmtree(outdated, ignore_errors=True)


class KeptCode:
    """The files of one kernel: a folder, in which numba keeps what it likes, and their digests."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._digests = folder.with_name(f"{folder.name}.json")

    def is_whole(self) -> bool:
        """Whether every file is as it was when `seal` was called; also where there is none."""
        try:
            expected = read_json(self._digests) if self._digests.exists() else {}
            if not expected:
                return not self._has_files()
            check_digests(self.folder, expected, self._digests)
        except (OSError, ValueError, RecursionError):
            return False
        return True

    def seal(self) -> None:
        """Writes the digests of the files.

        Raises OSError.
        """
        with replacing(self._digests) as path:
            path.write_text(json.dumps(digests(self.folder)), encoding="utf-8")

    def remove(self) -> None:
        """Removes the files, and what stands where the folder should be.

        Raises OSError.
        """
        self._digests.unlink(missing_ok=True)
        if self.folder.is_dir():
            shutil.rmtree(self.folder)
        else:
            self.folder.unlink(missing_ok=True)

    def _has_files(self) -> bool:
        """Whether there is a file in the folder, or in its place."""
        if not self.folder.is_dir():
            return self.folder.exists()
        return any(not path.is_dir() for path in self.folder.rglob("*"))
