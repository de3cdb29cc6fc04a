"""Cache folder of the compiled kernels: one per version of their sources, since a kernel is made of other files than its own.

numba's own cache compares only the file that a function stands in, so that it keeps a stale kernel when a kernel in *another* file changes
(numba issue 1833). The folder is therefore named after a digest of all sources that kernels of the package come from.
"""

import errno
import functools
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

import llvmlite
import numba
from numba import config

from soft_tendon_env.tools import STARTED_IN
from soft_tendon_env.tools.messages import say, say_once

PACKAGE = Path(__file__).parents[1]
KERNEL_SOURCES = ("compiler/*.py", "mechanics/**/*.py", "effects/**/*.py", "envs/kernels.py")
FOLDERS_KEPT = 3
WRITABLE = "set NUMBA_CACHE_DIR to a folder that can be written"


@functools.cache
def cache_folder() -> Path | None:
    """The folder of this version's machine code: `<user's cache>/soft_tendon_env/<digest>`, created when missing; None: there is none."""
    compiler = numba.__version__, llvmlite.__version__, config.OPT, config.BOUNDSCHECK
    digest = files_digest(files_of_package(*KERNEL_SOURCES), *compiler)
    known = data_folders(digest)
    try:
        folder = new_data_folder(digest)
    except OSError as error:
        say(f"{error.strerror}: every process compiles again")
        return None
    for read_only in known[: 0 if folder in known else 1]:
        shutil.copytree(read_only, folder, dirs_exist_ok=True)  # numba loads from folders alone that it can write
    os.utime(folder)
    versions = [path for path in folder.parent.iterdir() if re.fullmatch("[0-9a-f]{16}", path.name)]
    for outdated in sorted(versions, key=os.path.getmtime, reverse=True)[FOLDERS_KEPT:]:
        shutil.rmtree(outdated, ignore_errors=True)
    return folder


def cache_parents() -> list[Path]:
    """Candidate parents of the cache folder, best first: what the user has chosen, then the usual places."""
    user = getattr(os, "getuid", int)()
    temporary = Path(tempfile.gettempdir(), f"soft_tendon_env-{user}")
    named = config.CACHE_DIR, os.environ.get("XDG_CACHE_HOME"), os.path.expanduser("~/.cache")
    parents = [(STARTED_IN / folder).absolute() for folder in named if folder and not folder.startswith("~")]
    is_own = not temporary.exists() or temporary.stat().st_uid == user  # else somebody has put it there, with code that numba would run
    return [*parents, temporary] if is_own else parents


def data_folders(name: str) -> list[Path]:
    """The folders `<user's cache>/soft_tendon_env/<name>` that exist, best first, see `cache_parents`."""
    return [folder for parent in cache_parents() if os.path.isdir(folder := parent / "soft_tendon_env" / name)]


def new_data_folder(name: str) -> Path:
    """The first of these folders that can be written, created when missing. Raises OSError where there is none."""
    refused = []
    for parent in cache_parents():
        folder = parent / "soft_tendon_env" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()  # a folder can exist and yet not be writable
        except OSError as error:
            refused.append(f"{parent} cannot be used ({error.strerror})")
            continue
        if refused:
            say_once(f"{', '.join(refused)}: what is kept is in {folder.parent}; {WRITABLE}")
        return folder
    raise OSError(errno.EROFS, f"{', '.join(refused)}; {WRITABLE}")


def files_of_package(*patterns: str) -> list[Path]:
    """The files of the package that match one of the patterns."""
    return sorted(file for pattern in patterns for file in PACKAGE.glob(pattern))


def files_digest(files: Iterable[Path], *switches: object) -> str:
    """16 hex digits of the names and the content of files, and of `switches`."""
    digest = hashlib.sha256(repr(switches).encode())
    for file in files:
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]
