"""How the package compiles its kernels: one decorator, and what is said on stderr meanwhile. Machine code is kept by `kernel_cache`."""

import functools
import os
import time
from collections.abc import Callable
from typing import Any, TypeVar, overload

import numba
from numba.core import config
from numba.core import event as events
from numba.core.compiler_lock import global_compiler_lock

from soft_tendon_env.tools.kernel_cache import KernelCache, keep_machine_code, kernel_folder
from soft_tendon_env.tools.linking import is_of_package
from soft_tendon_env.tools.messages import say_unless_quiet

Function = TypeVar("Function", bound=Callable[..., Any])

SECONDS_BETWEEN_LINES = 5.0
NOTICEABLE = 1.0  # [s]; compilations shorter than this get no line of their own


@overload
def kernel(function: Function) -> Function: ...
@overload
def kernel(*, inline: bool = False, counted: bool | None = None) -> Callable[[Function], Function]: ...
def kernel(function: Callable[..., Any] | None = None, *, inline: bool = False, counted: bool | None = None) -> Any:
    """Compile a function of arrays and scalars on its first call: `@kernel`, or `@kernel(inline=True)`.

    inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a sweep. Other kernels are called, see linking.
    counted: count references to arrays, without which numba refuses what makes arrays or returns parts of them, and with which there is
    a third more to compile; by default not in this package.
    With NUMBA_DISABLE_JIT=1 the function comes back as it is.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, counted=counted)
    if config.DISABLE_JIT:
        return function
    # "contract" lets LLVM fuse multiply and add, and nothing that would hide a nan or reorder a sum.
    options = dict(error_model="numpy", fastmath={"contract"}, nogil=True, boundscheck=None, no_cfunc_wrapper=True)
    options["_nrt"] = not is_of_package(function) if counted is None else counted
    dispatcher = numba.njit(**options, forceinline=inline)(function)
    keep_machine_code(dispatcher, inline)
    return dispatcher


class CompilationProgress(events.Listener):
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

    def on_start(self, event: events.Event) -> None:
        if not is_ours(event):
            return
        if self.depth == 0:
            self.started = clock()
        self.depth += 1
        if self.spoke is None:
            folder = kernel_folder().path
            self.say(f"compiling for first use ({'not cached' if folder is None else f'cached in {folder}; once per version'})")

    def on_end(self, event: events.Event) -> None:
        if not is_ours(event):
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


def is_ours(compilation: events.Event) -> bool:
    """Whether a `numba:compile` event is about one of our kernels."""
    return isinstance(getattr(compilation.data["dispatcher"], "_cache", None), KernelCache)


if not config.DISABLE_JIT:
    events.register("numba:compile", CompilationProgress())
    if hasattr(os, "register_at_fork"):
        # A child has none of the other threads: it would wait forever for one that compiled when it was forked. So fork before or after.
        lock = global_compiler_lock
        os.register_at_fork(before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release)
