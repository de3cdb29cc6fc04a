"""First use of kernels: one process at a time compiles, says so on stderr, and is not forked meanwhile."""

import contextlib
import os
import threading
import time
from typing import Any

from filelock import FileLock, Timeout
from numba.core import event

from soft_tendon_env.compiler.cache_folder import cache_folder
from soft_tendon_env.tools.messages import QUIET, say_once, say_unless_quiet

PATIENCE = 600.0  # [s] for another process; who compiles for longer has been stopped
NOTICEABLE = 1.0  # [s]


class FirstUse(event.Listener):
    """Told by numba when it compiles, not when it loads; a kernel's compilation encloses those of what it calls."""

    def __init__(self) -> None:
        self.busy = threading.RLock()  # held while this process compiles
        self.depth, self.started, self.others = 0, 0.0, contextlib.ExitStack()

    def on_start(self, event: Any) -> None:
        """Wait for other processes at the outermost one; who has waited finds what it calls in the cache."""
        self.busy.acquire()
        self.depth += 1
        if self.depth > 1:
            return
        folder = cache_folder()
        if not QUIET:
            say_once(f"compiling for first use ({'not cached' if folder is None else f'cached in {folder}; once per version'})")
        with contextlib.suppress(Timeout, OSError, NotImplementedError):  # it was stopped, or the file system has no locks
            if folder is not None:
                self.others.enter_context(FileLock(folder / "compiling.lock", timeout=PATIENCE, thread_local=False))
        self.started = time.monotonic()

    def on_end(self, event: Any) -> None:
        """Let others compile, and say how long it took."""
        self.depth -= 1
        if self.depth == 0:
            self.others.close()
            if (taken := time.monotonic() - self.started) > NOTICEABLE:
                say_unless_quiet(f"compiled in {taken:.1f} s")
        self.busy.release()


def watch_compilations() -> None:
    """Have a `FirstUse` told from here on. A child that is forked while a thread compiles would wait for it forever."""
    watcher = FirstUse()
    event.register("numba:compile", watcher)
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=watcher.busy.acquire, after_in_parent=watcher.busy.release, after_in_child=watcher.busy.release)
