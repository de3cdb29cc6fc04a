"""First use of a kernel in a process: its machine code is loaded, or compiled and kept.

One thread of one process does so at a time.

Machine code that is damaged, or that numba cannot read, is removed and compiled anew; where none
can be kept, every process compiles.
"""

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from filelock import FileLock, Timeout
from llvmlite import binding
from numba import config, types
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

from soft_tendon_env.compiler.kept_code import KeptCode, KernelLocator, is_of_package
from soft_tendon_env.tools.forks import hold_over_forks
from soft_tendon_env.tools.messages import describe, say_once, warn_once

PATIENCE = 600.0
"""Time [s] to wait for another process; who compiles for longer has been stopped."""

_thread = threading.local()


class KeptKernel:
    """A function of the package whose machine code is kept: numba's function, `dispatcher`."""

    def __init__(
        self, function: Callable[..., Any], options: dict[str, Any], kept: KeptCode
    ) -> None:
        """Raises OSError where nothing can be kept."""
        self._function = function
        self._options = options
        self._kept = kept
        self._cache = kept.folder.parent
        try:
            self.dispatcher = self._cached_by_numba()
        except OSError:
            # Perhaps there is a file where numba makes a folder.
            if kept.is_whole():
                raise
            with global_compiler_lock, first_use(self._cache):
                self._may_be_read()
            self.dispatcher = self._cached_by_numba()
        self._compile_by_numba = self.dispatcher.compile
        self.dispatcher.compile = self._compile

    def _cached_by_numba(self) -> Any:
        """Dispatcher of numba with the kept files as its cache.

        Raises OSError where it can have none.
        """
        with global_compiler_lock, contextlib.ExitStack() as after:
            for name in ("CACHE_DIR", "CACHE_LOCATOR_CLASSES"):
                after.callback(setattr, config, name, getattr(config, name))
            config.CACHE_DIR = str(self._kept.folder)
            # Or numba would go on to folders of its own, where code outlives its version.
            config.CACHE_LOCATOR_CLASSES = f"{KernelLocator.__module__}.{KernelLocator.__name__}"
            try:
                return numba.njit(**self._options, cache=True)(self._function)
            except RuntimeError as error:
                raise OSError("it cannot be written") from error

    def _compile(self, kinds: tuple[types.Type, ...]) -> Any:
        """Loads or compiles the function for arguments of these types, in place of numba's.

        It is the address for calls from Python.
        """
        overloads = self.dispatcher.overloads
        if kinds not in overloads:
            # Every thread takes the compiler's lock first, then that of the folder.
            with global_compiler_lock, first_use(self._cache):
                # In the next process classes of users may have other kernels, or not be there.
                can_be_kept = all(map(has_no_class_of_users, kinds))
                if not (can_be_kept and self._may_be_read() and self._is_kept(kinds)):
                    unkept = numba.njit(**self._options)(self._function)
                    unkept.compile(kinds)
                    self.dispatcher.add_overload(unkept.overloads[kinds])
        return overloads[kinds].entry_point

    def _may_be_read(self) -> bool:
        """Whether the kept files are whole, or were damaged and have been removed."""
        if self._kept.is_whole():
            return True
        # Another process may be about to replace them.
        wait_for_other_processes()
        return self._kept.is_whole() or self._is_removed()

    def _is_removed(self) -> bool:
        """Whether files that cannot be used could be removed."""
        warn_once(f"machine code in {self._cache} is damaged: compiling it anew")
        try:
            self._kept.remove()
        except OSError as error:
            warn_that_nothing_is_kept(error, self._cache)
            return False
        return True

    def _is_kept(self, kinds: tuple[types.Type, ...]) -> bool:
        """Whether the function could be loaded, or compiled and kept."""
        if self._is_loaded_or_compiled(kinds):
            return True
        # Another process may be about to replace them.
        wait_for_other_processes()
        if self._is_loaded_or_compiled(kinds):
            return True
        return self._is_removed() and self._is_loaded_or_compiled(kinds)

    def _is_loaded_or_compiled(self, kinds: tuple[types.Type, ...]) -> bool:
        """Whether the function is there; False: numba cannot read its files.

        Errors of the compilation are raised.
        """
        overloads = self.dispatcher.overloads
        try:
            self._compile_by_numba(kinds)
            if kinds in self.dispatcher.stats.cache_misses:
                self._kept.seal()
        except Exception as error:
            if kinds not in self.dispatcher.stats.cache_misses:
                # Made with another version of a library, say, of which a name is missing.
                return False
            if not isinstance(error, OSError) or kinds not in overloads:
                raise
            # It was compiled and could not be written. What was is incomplete.
            warn_that_nothing_is_kept(error, self._cache)
            with contextlib.suppress(OSError):
                self._kept.remove()
        # Where folders have no locks, two processes can have exchanged their files.
        return kinds in overloads


def has_no_class_of_users(kind: types.Type) -> bool:
    """Whether no class in a type is a user's own."""
    named = getattr(kind, "instance_class", None)
    is_known = named is None or is_of_package(named)
    return is_known and all(map(has_no_class_of_users, getattr(kind, "types", ())))


def warn_that_nothing_is_kept(error: OSError, folder: Path) -> None:
    """Says once why machine code cannot be kept in a folder."""
    # without the name of the file: there would be a line for each kernel
    reason = error.strerror or describe(error)
    warn_once(f"machine code is not kept in {folder} ({reason}): every process compiles again")


@contextlib.contextmanager
def first_use(folder: Path) -> Iterator[None]:
    """Context in which a kernel is loaded, or compiled and kept in a folder.

    Kernels that it calls are within; `wait_for_other_processes` holds until the outermost ends.
    """
    if hasattr(_thread, "outermost"):
        yield
        return
    _thread.folder = folder
    with contextlib.ExitStack() as _thread.outermost:
        try:
            yield
        finally:
            del _thread.outermost


def wait_for_other_processes() -> None:
    """Waits until no other process compiles, and has them wait, once in a first use.

    Who has waited finds in the cache what the others compiled.
    """
    outermost = getattr(_thread, "outermost", None)
    if outermost is None:
        return
    _thread.outermost = None
    lock = FileLock(_thread.folder / "compiling.lock", timeout=PATIENCE, thread_local=False)
    # The other process was stopped, or the file system has no locks.
    with contextlib.suppress(Timeout, OSError, NotImplementedError):
        outermost.enter_context(lock)


class FirstUse(event.Listener):
    """First use of functions that numba's cache does not have.

    numba tells it of them: it says so on stderr, and has other processes wait.
    """

    def on_start(self, event: Any) -> None:
        """Say once, and wait once, in each first use."""
        if getattr(_thread, "outermost", None) is not None:
            say_once(f"compiling for first use (cached in {_thread.folder}; once per version)")
            wait_for_other_processes()

    def on_end(self, event: Any) -> None:
        """Hold the lock still: the machine code is yet to be saved."""


if not config.DISABLE_JIT:
    event.register("numba:compile", FirstUse())
    # numba compiles and loads under the first lock, and calls LLVM under the second. It has no
    # other name for either: without them a child waits for a thread that it does not have.
    hold_over_forks(global_compiler_lock)
    hold_over_forks(binding.ffi.lib._lock)
