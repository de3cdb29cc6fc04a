"""Cache folder of the compiled kernels: one per version of their sources, since a kernel is made of other files than its own.

numba's own cache compares only the file that a function stands in, so that it keeps a stale kernel when a kernel in *another* file changes
(numba issue 1833). The folder is therefore named after a digest of all sources that kernels come from, and of everything else that
decides which machine code is right.
"""

import contextlib
import errno
import functools
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import llvmlite
import llvmlite.binding
import numba
from numba.core import config

from soft_tendon_env.tools import STARTED_IN
from soft_tendon_env.tools.messages import say, say_once

PACKAGE = Path(__file__).parents[1]
KERNEL_SOURCES = ("compiler/compilation.py", "compiler/linking.py", "compiler/numba_internals.py", "mechanics/**/*.py", "envs/kernels.py")
"""All that a kernel of the mechanics is made from, but for effects: code_digest.py follows those one by one."""
FOLDERS_KEPT = 3


@functools.cache
def cache_folder() -> Path | None:
    """The folder of this version's machine code: `<user's cache>/soft_tendon_env/<digest>`, created when missing; None: there is none."""
    digest, refused = own_digest(), []
    for name, parent in cache_parents():
        root = None
        try:
            root = parent() / "soft_tendon_env"
            folder = open_folder(root, digest)
        except OSError as error:
            refused.append(f"{name} cannot be used ({error.strerror or error})")
            if root is not None and not isinstance(error, UnsafeError) and _is_filled(root / digest):
                return root / digest  # read only: what is there need not be compiled
            continue
        if refused:
            say(f"{', '.join(refused)}: machine code is kept in {folder}; set NUMBA_CACHE_DIR to a folder that can be written")
        return folder
    say(f"{', '.join(refused)}: every process compiles again; set NUMBA_CACHE_DIR to a folder that can be written")
    return None


def cache_parents() -> list[tuple[str, Callable[[], Path]]]:
    """Candidate parents of the cache folder, best first, with names for messages: the user's choices, then the usual places."""
    chosen = {"NUMBA_CACHE_DIR": config.CACHE_DIR, "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME")}
    named = [(f"{variable}={folder}", (STARTED_IN / folder).absolute) for variable, folder in chosen.items() if folder]
    return [*named, ("~/.cache", _home_parent), ("the folder for temporary files", _temporary_parent)]


def data_folders(name: str) -> list[Path]:
    """The folders `<user's cache>/soft_tendon_env/<name>` that exist, best first, see `cache_parents`; one that is not safe is named."""
    folders = []
    for _, parent in cache_parents():
        try:
            root = parent() / "soft_tendon_env"
            if (root / name).is_dir():
                check_folder(root)
                check_folder(root / name)
                folders.append(root / name)
        except UnsafeError as error:
            say_once(f"{error.strerror}: what is in it is not used")
        except OSError:
            pass
    return folders


def new_data_folder(name: str) -> Path:
    """The first of these folders that can be written, created when missing. Raises OSError where there is none."""
    refused: OSError | None = None
    for _, parent in cache_parents():
        try:
            folder = own_folder(parent() / "soft_tendon_env", name)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
        except OSError as error:
            refused = refused or error
    raise refused or FileNotFoundError(errno.ENOENT, "there is no cache folder")


class UnsafeError(PermissionError):
    """Somebody else could have put what is in a file or folder there; `strerror` says why, and what to do."""

    def __init__(self, reason: str) -> None:
        super().__init__(errno.EPERM, reason)


def own_folder(root: Path, *below: str) -> Path:
    """Create `root/below/..` where missing, for this user alone. Raises UnsafeError where one is there that is not safe, OSError.

    The folders above `root` may be anybody's: who can put another root there cannot make it, or files in it, this user's.
    """
    for count in range(len(below) + 1):
        folder = root.joinpath(*below[:count])
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        check_folder(folder)
    return folder


def check_folder(folder: Path) -> None:
    """Raises UnsafeError where somebody else can put files into a folder, or could have put the folder or the link to it there."""
    if folder.is_symlink():
        check_status(f"{folder}, a link,", folder.lstat(), writable=True)  # a link's mode says nothing
    check_status(str(folder), folder.stat())


def check_status(name: str, status: os.stat_result, writable: bool = False) -> None:
    """Raises UnsafeError where a file or folder is not this user's or root's, or others can write it, unless that does not matter."""
    if not hasattr(os, "getuid"):
        return
    if status.st_uid not in (os.getuid(), 0):
        raise UnsafeError(f"{name} belongs to another user, {status.st_uid}: delete it or choose another folder")
    if status.st_mode & 0o022 and not writable:
        raise UnsafeError(f"others can write {name}: delete it, or take their permission if you know all that is in it")


def _home_parent() -> Path:
    folder = os.path.expanduser("~/.cache")
    if folder.startswith("~"):
        raise FileNotFoundError(errno.ENOENT, "there is no home folder")
    return Path(folder).absolute()


def _temporary_parent() -> Path:
    """A folder of this user's own among the temporary files."""
    own = f"soft_tendon_env-{os.getuid()}" if hasattr(os, "getuid") else "soft_tendon_env"
    return own_folder(Path(tempfile.gettempdir()).absolute() / own)


def _is_filled(folder: Path) -> bool:
    try:
        return any(folder.glob("*/*.nbc"))
    except OSError:
        return False


def open_folder(root: Path, digest: str) -> Path:
    """Create `root/digest` or mark it as used; on creation, drop all but the `FOLDERS_KEPT` used last. OSError: not writable."""
    is_new = not (root / digest).exists()
    folder = own_folder(root, digest)
    tempfile.TemporaryFile(dir=folder).close()  # a folder can exist and yet not be writable
    os.utime(folder)
    if is_new:
        with contextlib.suppress(OSError):  # another process may be dropping the same folders
            versions = [path for path in root.iterdir() if re.fullmatch("[0-9a-f]{16}", path.name)]
            for outdated in sorted(versions, key=lambda path: path.stat().st_mtime, reverse=True)[FOLDERS_KEPT:]:
                shutil.rmtree(outdated)
    return folder


@functools.cache
def own_digest() -> str:
    """`source_digest` of this package, as it was at the first call."""
    return source_digest(PACKAGE)


def source_digest(package: Path) -> str:
    """16 hex digits that change with any of KERNEL_SOURCES in the package, with the compiler, its switches and the processor."""
    compiler = (numba.__version__, llvmlite.__version__, llvmlite.binding.get_host_cpu_name(), config.OPT, config.BOUNDSCHECK)
    digest = hashlib.sha256(repr(compiler).encode())
    for source in kernel_sources(package):
        content = source.read_bytes()
        digest.update(f"{source.relative_to(package)} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def kernel_sources(package: Path) -> list[Path]:
    """The files of KERNEL_SOURCES in the package."""
    return sorted(source for pattern in KERNEL_SOURCES for source in package.glob(pattern))
