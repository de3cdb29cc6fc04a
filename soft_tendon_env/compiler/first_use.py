"""First use of a kernel: one process at a time compiles and saves it, says so on stderr, and is not forked meanwhile.

Of two processes that save machine code for different arguments of a function at once, numba can keep the one's under the other's name.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator
from typing import Any

from filelock import FileLock, Timeout
from numba.core import event

from soft_tendon_env.compiler.cache_folder import cache_folder
from soft_tendon_env.tools.messages import QUIET, say_once, say_unless_quiet

PATIENCE = 600.0  # [s] for another process; who compiles for longer has been stopped
NOTICEABLE = 1.0  # [s]

_thread = threading.local()
"""`outermost`: what ends with the outermost compilation of a thread; None once that has been prepared for."""
_compiling = threading.RLock()


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
    """Told by numba where the cache does not have a function."""

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
        outermost.callback(say_time, time.monotonic())

    def on_end(self, event: Any) -> None:
        """What was compiled is still to be saved."""


def say_time(started: float) -> None:
    """Says how long a compilation took, unless it was short."""
    if (seconds := time.monotonic() - started) > NOTICEABLE:
        say_unless_quiet(f"compiled in {seconds:.1f} s")


def watch_compilations() -> None:
    """Have compilations of kernels watched from here on. A child that is forked while a thread compiles would wait for it forever."""
    event.register("numba:compile", FirstUse())
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=_compiling.acquire, after_in_parent=_compiling.release, after_in_child=_compiling.release)
