"""Files of machine code on disk, shared by processes: written whole or not at all, read only where nobody else can have written them, and
compiled by one process at a time, for whose end the others wait to load what it has made.

A file begins with a digest of the rest: what was cut or damaged is deleted and compiled again. What cannot be written is said once; the
program goes on with what it has compiled. numba's own cache raises in both cases, and the functions' signatures share an index there that
two processes can overwrite for one another.
"""

import contextlib
import functools
import hashlib
import os
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from soft_tendon_env.compiler.cache_folder import UnsafeError, cache_folder, check_folder, check_status, own_folder
from soft_tendon_env.tools.messages import say, say_unless_quiet

LOCK = "compiling.lock"
SECONDS_BEFORE_LINE = 1.0  # of waiting for another process
PATIENCE = 600.0  # [s]; whoever compiles for longer has been stopped, not killed


class KernelFolder:
    """Files of machine code, named by their paths within a folder that processes share. `path` None: nothing is kept.

    Used under numba's lock on compilation, by one thread at a time.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.waited = 0.0  # [s] for other processes, in total
        self.depth = 0  # of compilations: 1 what Python calls, more what that calls
        self._lock: Any = None  # while this process compiles
        self._is_writable = True
        self._is_patient = True  # False once another process was waited for in vain
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
            own_folder(self.path, *file.relative_to(self.path).parts[:-1])  # another version may have dropped it meanwhile
            part.touch(mode=0o600)
            part.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(part, file)
            self._is_writable = True
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink()
            self._is_writable = False
            self._release()  # nobody need wait for what will not be there
            if isinstance(error, UnsafeError):
                return self._say_unsafe(error)
            self._say_once(
                "unwritable",
                f"machine code cannot be kept in {self.path} ({error.strerror or error}): this program goes on, the next one compiles "
                "again; make room there, or set NUMBA_CACHE_DIR to a folder that can be written",
            )

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """Context in which something is compiled or loaded; at the end of the outermost other processes may compile."""
        self.depth += 1
        try:
            yield
        finally:
            self.depth -= 1
            if self.depth == 0:
                self._release()

    def lock(self) -> None:
        """Has this process compile alone from here on, in `compiling`; returns then, or when it should go on beside others."""
        if self.path is None or self._lock is not None or not (self._is_writable and self._is_patient):
            return
        started = time.monotonic()
        try:
            lock = FileLock(own_folder(self.path) / LOCK, thread_local=False)
            try:
                lock.acquire(timeout=SECONDS_BEFORE_LINE)
            except Timeout:
                say_unless_quiet("waiting for another process, which compiles")
                lock.acquire(timeout=PATIENCE)
            self._lock = lock
        except Timeout:
            say(f"another process has compiled for {time.monotonic() - started:.0f} s: compiling here too")
            self._is_patient = False
        except (OSError, NotImplementedError):
            pass  # the folder cannot be written, of which `write` will tell, or its file system has no locks
        finally:
            self.waited += time.monotonic() - started

    def _release(self) -> None:
        if self._lock is not None:
            with contextlib.suppress(OSError):
                self._lock.release()
            self._lock = None

    def _say_unsafe(self, error: UnsafeError) -> None:
        self._say_once("unsafe", f"machine code is compiled again, not loaded: {error.strerror}")

    def _say_once(self, kind: str, line: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            say(line)


@functools.cache
def kernel_folder() -> KernelFolder:
    """The `KernelFolder` of this version of the sources."""
    return KernelFolder(cache_folder())
