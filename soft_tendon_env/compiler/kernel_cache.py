"""Cache of the compiled kernels: numba's own, in a folder per version of their sources, which one process at a time fills.

numba compares only the file that a function stands in, so that it keeps a stale kernel when a kernel in *another* file changes (numba issue
1833). And of two processes that save machine code for different arguments of a function at once, it can keep the one's for the other's.
"""

import contextlib
import functools
import hashlib
import os
import re
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
from filelock import FileLock, Timeout
from numba import config
from numba.core import event

from soft_tendon_env.tools.files import sources_digest
from soft_tendon_env.tools.messages import QUIET, say, say_once
from soft_tendon_env.tools.user_cache import data_folders, new_data_folder

KERNEL_SOURCES = ("compiler/*.py", "mechanics/**/*.py", "effects/**/*.py", "envs/kernels.py")
FOLDERS_KEPT = 3
PATIENCE = 600.0  # [s] for another process; who compiles for longer has been stopped

_thread = threading.local()
"""`outermost`: what ends with the outermost compilation of a thread; None once that is prepared for."""
_compiling = threading.RLock()


@functools.cache
def cache_folder() -> Path | None:
    """The folder of this version's machine code: `<user's cache>/soft_tendon_env/<digest>`, created when missing; None: there is none."""
    made_from = sources_digest(*KERNEL_SOURCES), numba.__version__, config.OPT, config.BOUNDSCHECK
    name = hashlib.sha256(repr(made_from).encode()).hexdigest()[:16]
    known = data_folders(name)
    try:
        folder = new_data_folder(name)
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


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Context in which a kernel is loaded, or compiled and saved."""
    if hasattr(_thread, "outermost"):
        yield
        return
    with contextlib.ExitStack() as _thread.outermost:
        try:
            yield
        finally:
            del _thread.outermost


class FirstUse(event.Listener):
    """Told by numba where the cache does not have a function: has other processes wait, and says so on stderr."""

    def on_start(self, event: Any) -> None:
        """Wait for other processes; who has waited finds in the cache what the function calls."""
        outermost = getattr(_thread, "outermost", None)
        if outermost is None:
            return
        _thread.outermost, folder = None, cache_folder()
        outermost.enter_context(_compiling)
        if not QUIET:
            say_once(f"compiling for first use ({'not cached' if folder is None else f'cached in {folder}; once per version'})")
        if folder is not None:
            with contextlib.suppress(Timeout, OSError, NotImplementedError):  # it was stopped, or the file system has no locks
                outermost.enter_context(FileLock(folder / "compiling.lock", timeout=PATIENCE, thread_local=False))

    def on_end(self, event: Any) -> None:
        """What was compiled is still to be saved."""


if not config.DISABLE_JIT:
    event.register("numba:compile", FirstUse())
    if hasattr(os, "register_at_fork"):  # a child would wait forever for a thread that compiled when it was forked
        os.register_at_fork(before=_compiling.acquire, after_in_parent=_compiling.release, after_in_child=_compiling.release)
