"""On-disk cache of compiled kernels: one file per kernel and signature, compiled by one process while the others wait for it.

A file is written whole or not at all, and begins with a digest of the rest: what was cut or damaged is deleted and compiled again. What
cannot be written is said once; the program goes on with what it has compiled. numba's own cache raises in both cases, and the functions'
signatures share an index there that two processes can overwrite for one another.
"""

import contextlib
import functools
import gc
import hashlib
import inspect
import io
import os
import pickle
import platform
import re
import sys
import time
import uuid
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

from numba.core.errors import NumbaWarning

from soft_tendon_env.compiler.cache_folder import PACKAGE, UnsafeError, cache_folder, check_folder, check_status, own_folder
from soft_tendon_env.compiler.code_digest import class_name, class_of_name, code_digest, selected_code, source_of
from soft_tendon_env.compiler.file_lock import try_lock, unlock
from soft_tendon_env.compiler.linking import is_of_package, link
from soft_tendon_env.compiler.numba_internals import SYMBOLS, NumbaPickler, dumps, initialize, keep_in, rebuilt, reduced, target_of
from soft_tendon_env.tools.messages import say, say_unless_quiet

UNREADABLE = (pickle.UnpicklingError, EOFError, ImportError, AttributeError, LookupError, TypeError)
"""What unpickling raises where a class has moved or become another one."""
SECONDS_BETWEEN_LOOKS = 0.25  # at a lock
SECONDS_BEFORE_LINE = 1.0  # of waiting
SECONDS_BETWEEN_LINES = 10.0
PATIENCE = 600.0  # [s] for one kernel; whoever holds its lock for longer has been stopped, not killed


class KernelFolder:
    """Files of machine code, named by their paths within a folder that processes share. `path` None: nothing is kept.

    Used under numba's lock on compilation, by one thread at a time.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.waited = 0.0  # [s] for other processes, in total
        self._next_line = SECONDS_BEFORE_LINE  # of `waited`
        self._claims: list[tuple[Path, int]] = []
        self.depth = 0  # of compilations: 1 what Python calls, more what that calls
        self._writable = True
        self._safe: set[Path] = set()  # folders within `path`
        self._said: set[str] = set()

    def read(self, name: str) -> bytes | None:
        """Content of a file; None where there is none, one that somebody else may have written, or a broken one, which is deleted."""
        if self.path is None:
            return None
        try:
            content = self._read_own(self.path, name)
        except UnsafeError as error:
            self._say_unsafe(error)
            return None
        except OSError:
            return None
        if content[:32] == hashlib.sha256(content[32:]).digest():
            return content[32:]
        self.discard(name, f"{len(content)} bytes that are not what was written")
        return None

    def _read_own(self, path: Path, name: str) -> bytes:
        """Content of a file that nobody else can have written, with the folders that lead to it. Raises UnsafeError, OSError."""
        file = path / name
        for folder in file.parents[: len(file.relative_to(path).parts) - 1]:
            if folder not in self._safe:
                check_folder(folder)
                self._safe.add(folder)
        with file.open("rb") as opened:
            check_status(str(file), os.fstat(opened.fileno()))
            return opened.read()

    def discard(self, name: str, reason: str) -> None:
        """Deletes a file that cannot be used, and says so."""
        if self.path is not None:
            file = self.path / name
            self._say_once("broken", f"broken machine code in {file} ({reason}): it is deleted and compiled again")
            with contextlib.suppress(OSError):
                file.unlink()

    def write(self, name: str, content: bytes) -> None:
        """Writes the file whole or not at all; says so where it cannot be written."""
        if self.path is None:
            return
        file = self.path / name
        part = file.with_suffix(f".{uuid.uuid4().hex[:16]}")
        try:
            self._own_folder_of(file)
            part.touch(mode=0o600)
            part.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(part, file)
            self._writable = True
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink()
            self._writable = False
            self.release()  # nobody need wait for what will not be there
            if isinstance(error, UnsafeError):
                return self._say_unsafe(error)
            self._say_once(
                "unwritable",
                f"machine code cannot be kept in {self.path} ({error.strerror or error}): this program goes on, the next one compiles "
                "again; make room there, or set NUMBA_CACHE_DIR to a folder that can be written",
            )

    def _own_folder_of(self, file: Path) -> None:
        if self.path is not None:  # another version may have dropped the folder meanwhile
            own_folder(self.path, *file.relative_to(self.path).parts[:-1])

    def claim(self, name: str, what: str) -> None:
        """Locks the file of a kernel that this process is to compile; returns with the lock, or when it should go on without it.

        Callers are locked before the functions that they call, so that no two processes wait for each other.
        """
        if self.path is None or not self._writable:
            return
        lock, started, pause = (self.path / name).with_suffix(".lock"), time.monotonic(), 0.01
        mine = f"process {os.getpid()} on {platform.node()}"
        try:
            self._own_folder_of(lock)
            while (descriptor := try_lock(lock, mine)) is None:
                seconds = time.monotonic() - started
                if seconds > PATIENCE:
                    say(f"{_holder(lock)} has not compiled {what} in {seconds:.0f} s: compiling it here")
                    return
                self._tell(f"waiting for {_holder(lock)}, which compiles {what}", self.waited + seconds)
                time.sleep(pause)
                pause = min(1.5 * pause, SECONDS_BETWEEN_LOOKS)
            self._claims.append((lock, descriptor))
        except OSError:
            return  # the folder cannot be written, of which `write` will tell, or its file system has no locks
        finally:
            self.waited += time.monotonic() - started

    def _tell(self, line: str, waited: float) -> None:
        if waited > self._next_line:
            say_unless_quiet(f"{line}: {waited:.0f} s so far")
            self._next_line = 2.0 * waited + SECONDS_BETWEEN_LINES  # ever fewer, since many may wait

    @contextlib.contextmanager
    def claims_released(self) -> Iterator[None]:
        """Context in which claims are made; releases them at its end."""
        before = len(self._claims)
        self.depth += 1
        try:
            yield
        finally:
            self.depth -= 1
            self.release(before)

    def release(self, kept: int = 0) -> None:
        """Releases all claims but the first `kept`."""
        while len(self._claims) > kept:
            unlock(*self._claims.pop())

    def _say_unsafe(self, error: UnsafeError) -> None:
        self._say_once("unsafe", f"machine code is compiled again, not loaded: {error.strerror}")

    def _say_once(self, kind: str, line: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            say(line)


def _holder(lock: Path) -> str:
    try:
        return lock.read_text() or "another process"
    except OSError:
        return "another process"


class KernelCache:
    """Numba's cache interface for one function, on files of a `KernelFolder`.

    A file begins with a digest of what its machine code is for: what is for something else, an older version of the function as a rule, is
    never unpickled.
    """

    def __init__(self, function: FunctionType, folder: KernelFolder, has_symbol: bool) -> None:
        """has_symbol: others call the function by its symbol. Raises OSError where there is no source to tell versions of it apart."""
        file, place = Path(inspect.getfile(function)), "interactive"
        self._source = source_of(function)
        if file.is_file():
            parent = file.absolute().parent
            place = str(parent.relative_to(PACKAGE)) if parent.is_relative_to(PACKAGE) else f"{parent.name}_{_digest(str(parent))[:16]}"
        self._function, self._folder, self._has_symbol = function, folder, has_symbol
        self.name = f"{file.stem}.{re.sub('[<>]', '', function.__qualname__)}"
        self._stem = f"{place}/{self.name}-{function.__code__.co_firstlineno}.{sys.implementation.cache_tag}"
        self._is_stale = False
        self.inside = False  # whether it is now about machine code without a way in from Python

    @property
    def cache_path(self) -> str | None:
        return None if self._folder.path is None else str((self._folder.path / self._stem).parent)

    def called(self) -> contextlib.AbstractContextManager[None]:
        """Context in which the function is compiled for a caller."""
        return self._folder.claims_released()

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """Context in which the function is compiled or loaded, with those that it calls."""
        outer = self.inside
        with self._folder.claims_released(), collector_paused():
            self.inside = is_of_package(self._function) and self._folder.depth > 1
            try:
                yield
            finally:
                self.inside = outer

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of a signature; None, once this process may compile it."""
        initialize(target_context)
        key, name = self._entry(sig, target_context, self.inside)
        found = self._load(key, name, sig, target_context)
        if found is None:
            self._folder.claim(name, self.name)
            found = self._load(key, name, sig, target_context)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Writes the machine code of a compiled function."""
        parts = reduced(data, self._has_symbol)
        if parts is None:
            warnings.warn(NumbaWarning(f"{self.name} holds addresses or large arrays: its machine code is not kept"), stacklevel=2)
            return
        key, name = self._entry(sig, data.target_context, self.inside)
        self._folder.write(name, key + _pickled((sig, parts)))

    def symbol(self, sig: Any, target_context: Any) -> str:
        """The name of the compiled function of a signature, the same in every process; empty where it has none."""
        return f"{SYMBOLS}{self._entry(sig, target_context, inside=False)[1]}" if self._has_symbol else ""

    def flush(self) -> None:
        """Ignores the files of this function from here on, so that it is compiled anew."""
        self._is_stale = True

    def _load(self, key: bytes, name: str, sig: Any, target_context: Any) -> Any:
        content = None if self._is_stale else self._folder.read(name)
        if content is None or content[: len(key)] != key:
            return None
        try:
            written_for, parts = _Unpickler(io.BytesIO(content[len(key) :])).load()
        except UNREADABLE as error:
            self._folder.discard(name, f"{type(error).__name__}: {error}")
            return None
        if written_for != sig:
            return None
        try:
            return rebuilt(target_context, *parts)
        except LookupError as error:
            self._folder.discard(name, str(error))
            return None

    def _entry(self, sig: Any, target_context: Any, inside: bool) -> tuple[bytes, str]:
        """Digest of what machine code is for, and its file. A new version of the function's source, or of what it is compiled with,
        overwrites the old one's file."""
        closure = tuple(cell.cell_contents for cell in self._function.__closure__ or ())
        target, (places, digests) = target_of(target_context), selected_code(getattr(sig, "args", sig))
        named = re.sub(" at 0x[0-9a-f]+", "", repr((sig, target, closure, places, *("inside",) * inside)))
        key = hashlib.sha256(repr((named, self._source, code_digest(self._function), digests, dumps(closure))).encode()).digest()
        return key, f"{self._stem}.{_digest(named)[:16]}.nbc"


class _Pickler(NumbaPickler):
    """numba's, but for classes that select code: by their names, since those of a script would be copied, and a copy is another type."""

    def persistent_id(self, value: Any) -> str | None:
        return class_name(value) if isinstance(value, type) else None


class _Unpickler(pickle.Unpickler):
    def persistent_load(self, name: str) -> type:
        return class_of_name(name)


def _pickled(value: Any) -> bytes:
    file = io.BytesIO()
    _Pickler(file).dump(value)
    return file.getvalue()


def keep_machine_code(dispatcher: Any, inline: bool) -> None:
    """Gives a numba dispatcher a `KernelCache`, and locks so that no two processes compile the same at once.

    A kernel of the package is called by a symbol from others, see linking, unless it is to be inlined; what only others call gets no way
    in from Python, which takes long to compile, until Python calls it.
    """
    try:
        cache = KernelCache(dispatcher.py_func, kernel_folder(), is_of_package(dispatcher.py_func) and not inline)
    except OSError:
        return  # typed into an interpreter that forgets it: compiled, but not kept
    keep_in(dispatcher, cache, lambda sig, compiled: link(dispatcher, compiled, cache.symbol(sig, compiled.target_context), inline))


@contextlib.contextmanager
def collector_paused() -> Iterator[None]:
    """Context in which Python looks for no cyclic garbage: to go through all that numba makes takes a fifteenth of a compilation."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@functools.cache
def kernel_folder() -> KernelFolder:
    """The `KernelFolder` of this version of the sources."""
    return KernelFolder(cache_folder())


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
