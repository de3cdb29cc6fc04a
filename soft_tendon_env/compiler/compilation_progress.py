"""Progress of compilations on stderr, and no fork of the process meanwhile."""

import os
import time

from soft_tendon_env.compiler.kernel_cache import KernelCache
from soft_tendon_env.compiler.kernel_folder import kernel_folder
from soft_tendon_env.compiler.numba_internals import cache_of, event, global_compiler_lock
from soft_tendon_env.tools.messages import say_unless_quiet

SECONDS_BETWEEN_LINES = 5.0
NOTICEABLE = 1.0  # [s]; compilations shorter than this get no line of their own


class CompilationProgress(event.Listener):
    """Says on stderr that the package's kernels are being compiled, since that takes seconds; silent when they come from the cache.

    numba serialises compilation by a lock, so its events arrive nested: a kernel's compilation encloses its helpers'.
    Functions are counted one by one, seconds at the outermost only.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.functions = 0
        self.seconds = 0.0  # of the outermost compilations that have ended
        self.started = 0.0  # when the latest outermost one began, by `clock`
        self.spoke: float | None = None  # when the last line was printed

    def on_start(self, compilation: event.Event) -> None:
        if not is_ours(compilation):
            return
        if self.depth == 0:
            self.started = clock()
        self.depth += 1
        if self.spoke is None:
            folder = kernel_folder().path
            self.say(f"compiling for first use ({'not cached' if folder is None else f'cached in {folder}; once per version'})")

    def on_end(self, compilation: event.Event) -> None:
        if not is_ours(compilation):
            return
        self.depth -= 1
        self.functions += 1
        elapsed = clock() - self.started
        is_outermost = self.depth == 0
        if is_outermost and elapsed > NOTICEABLE or self.spoke is not None and time.monotonic() - self.spoke > SECONDS_BETWEEN_LINES:
            self.say(f"compiled {self.functions} functions, {self.seconds + elapsed:.1f} s")
        if is_outermost:
            self.seconds += elapsed

    def say(self, line: str) -> None:
        say_unless_quiet(line)
        self.spoke = time.monotonic()


def clock() -> float:
    """Seconds of this process that were not spent waiting for another one's compilation."""
    return time.monotonic() - kernel_folder().waited


def is_ours(compilation: event.Event) -> bool:
    """Whether a `numba:compile` event is about one of our kernels."""
    return isinstance(cache_of(compilation.data["dispatcher"]), KernelCache)


def show_progress() -> None:
    """From here on, say what is compiled, and have forks wait for it."""
    event.register("numba:compile", CompilationProgress())
    if hasattr(os, "register_at_fork"):
        # A child has none of the other threads: it would wait forever for one that compiled when it was forked. So fork before or after.
        # filelock, which is imported by now, has handlers too: those that were registered last are called first, before it locks anything.
        lock = global_compiler_lock
        os.register_at_fork(before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release)
