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
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

from llvmlite import binding
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import NumbaWarning
from numba.core.runtime import rtsys
from numba.core.serialize import NumbaPickler, dumps
from numba.core.sigutils import normalize_signature

from soft_tendon_env.tools.cache_folder import PACKAGE, cache_folder
from soft_tendon_env.tools.code_digest import class_name, class_of_name, code_digest, selected_code, source_of
from soft_tendon_env.tools.file_lock import try_lock, unlock
from soft_tendon_env.tools.linking import call_by_symbol, call_directly, is_of_package, without_code_to_link
from soft_tendon_env.tools.messages import say, say_unless_quiet

SYMBOL = re.compile(rb"\b" + PACKAGE.name.encode() + rb"/[\w./-]+?\.[0-9a-f]{16}\.nbc")
"""The symbol of a kernel, in the machine code of those that call it."""
RELOAD_INIT = 7  # where CompileResult keeps what is to be called before machine code is loaded
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
        self._said: set[str] = set()

    def read(self, name: str) -> bytes | None:
        """Content of a file; None where there is none, or a broken one, which is deleted."""
        if self.path is None:
            return None
        try:
            content = (self.path / name).read_bytes()
        except OSError:
            return None
        if content[:32] == hashlib.sha256(content[32:]).digest():
            return content[32:]
        self.discard(name, f"{len(content)} bytes that are not what was written")
        return None

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
            file.parent.mkdir(parents=True, exist_ok=True)  # another version may have dropped the folder meanwhile
            part.write_bytes(hashlib.sha256(content).digest() + content)
            os.replace(part, file)
            self._writable = True
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink()
            self._writable = False
            self.release()  # nobody need wait for what will not be there
            self._say_once(
                "unwritable",
                f"machine code cannot be kept in {self.path} ({error.strerror or error}): this program goes on, the next one compiles "
                "again; make room there, or set NUMBA_CACHE_DIR to a folder that can be written",
            )

    def claim(self, name: str, what: str) -> None:
        """Locks the file of a kernel that this process is to compile; returns with the lock, or when it should go on without it.

        Callers are locked before the functions that they call, so that no two processes wait for each other.
        """
        if self.path is None or not self._writable:
            return
        lock, started, pause = (self.path / name).with_suffix(".lock"), time.monotonic(), 0.01
        mine = f"process {os.getpid()} on {platform.node()}"
        try:
            lock.parent.mkdir(parents=True, exist_ok=True)
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

    def _say_once(self, kind: str, line: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            say(line)


def _holder(lock: Path) -> str:
    try:
        return lock.read_text() or "another process"
    except OSError:
        return "another process"


class KernelCache(NullCache):
    """Numba's cache interface for one function, on files of a `KernelFolder`."""

    def __init__(self, function: FunctionType, folder: KernelFolder) -> None:
        """Raises OSError where there is no source to tell versions of the function apart."""
        file, place = Path(inspect.getfile(function)), "interactive"
        self._source = source_of(function)
        if file.is_file():
            parent = file.absolute().parent
            place = str(parent.relative_to(PACKAGE)) if parent.is_relative_to(PACKAGE) else f"{parent.name}_{_digest(str(parent))[:16]}"
        self._function, self._folder = function, folder
        self.name = f"{file.stem}.{re.sub('[<>]', '', function.__qualname__)}"
        self._stem = f"{place}/{self.name}-{function.__code__.co_firstlineno}.{sys.implementation.cache_tag}"
        self._stale = False
        self.inside = False  # whether it is now about machine code without a way in from Python
        self.has_symbol = False  # by which others call it

    @property
    def cache_path(self) -> str | None:
        return None if self._folder.path is None else str((self._folder.path / self._stem).parent)

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """The compiled function of a signature; None, once this process may compile it.

        All that numba can compile is imported when it compiles; what comes from here needs its allocator alone.
        """
        rtsys.initialize(target_context)
        key, name = self._entry(sig, target_context.codegen(), self.inside)
        found = self._load(key, name, target_context)
        if found is None:
            self._folder.claim(name, self.name)
            found = self._load(key, name, target_context)
        return found

    def save_overload(self, sig: Any, data: CompileResult) -> None:
        """Writes the machine code of a compiled function."""
        if data.library.has_dynamic_globals:
            warnings.warn(NumbaWarning(f"{self.name} holds addresses or large arrays: its machine code is not kept"), stacklevel=2)
            return
        key, name = self._entry(sig, data.codegen, self.inside)
        library, *rest = data._reduce()
        if self.has_symbol:
            own = data.fndesc
            library = without_code_to_link(library, (own.llvm_func_name, *(() if is_inside(data) else (own.llvm_cpython_wrapper_name,))))
        self._folder.write(name, _pickled((key, (library, *rest))))

    def symbol(self, sig: Any, codegen: Any) -> str:
        """The name of the compiled function of a signature, the same in every process."""
        return f"{PACKAGE.name}/{self._entry(sig, codegen, inside=False)[1]}"

    def flush(self) -> None:
        """Ignores the files of this function from here on, so that it is compiled anew."""
        self._stale = True

    def _load(self, key: tuple[Any, ...], name: str, target_context: Any) -> CompileResult | None:
        content = None if self._stale else self._folder.read(name)
        if content is None:
            return None
        try:
            written_for, reduced = _Unpickler(io.BytesIO(content)).load()
            if written_for != key:
                return None
            definitions = reduced[RELOAD_INIT] or ()
            _define_symbols(content, definitions)
            compiled = CompileResult._rebuild(target_context, *reduced)
            compiled.library._reload_init.update(definitions)  # numba forgets them; a caller that inlines this code needs them in turn
            return compiled
        except Exception as error:  # classes may have moved, and whatever else numba finds in machine code of another make
            self._folder.discard(name, f"{type(error).__name__}: {error}")
            return None

    def _entry(self, sig: Any, codegen: Any, inside: bool) -> tuple[tuple[Any, ...], str]:
        """What machine code is for, and its file. A new version of the function's source, or of what it is compiled with, overwrites the
        old one's file."""
        closure = tuple(cell.cell_contents for cell in self._function.__closure__ or ())
        target, (places, digests) = codegen.magic_tuple(), selected_code(getattr(sig, "args", sig))
        own = _digest(re.sub(" at 0x[0-9a-f]+", "", repr((sig, target, closure, places, *("inside",) * inside))))[:16]
        return (self._source, code_digest(self._function), digests, sig, target, dumps(closure)), f"{self._stem}.{own}.nbc"


def _define_symbols(content: bytes, definitions: Iterable[Callable[[], None]]) -> None:
    """Define the symbols that machine code calls, see linking. Raises LookupError where one is left, which LLVM would abort at."""
    for define in definitions:
        define()
    for symbol in set(SYMBOL.findall(content)):
        if not binding.address_of_symbol(symbol.decode()):
            raise LookupError(f"it calls {symbol.decode()}, which nothing defines")


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
    folder = kernel_folder()
    try:
        cache = dispatcher._cache = KernelCache(dispatcher.py_func, folder)
    except OSError:
        return  # typed into an interpreter that forgets it: compiled, but not kept
    compile, add_overload, is_own = dispatcher.compile, dispatcher.add_overload, is_of_package(dispatcher.py_func)
    cache.has_symbol = is_own and not inline
    replaced: list[Any] = []  # machine code that others may still call

    @functools.wraps(compile)
    def compile_alone(sig: Any) -> Any:
        arguments = tuple(normalize_signature(sig)[0])
        with global_compiler_lock, folder.claims_released(), collector_paused():  # numba saves at the very end
            outer, cache.inside = cache.inside, is_own and folder.depth > 1
            dispatcher.targetoptions["no_cpython_wrapper"] = cache.inside
            known = dispatcher.overloads.get(arguments)
            if known is not None and not cache.inside and is_inside(known):
                replaced.append(dispatcher.overloads.pop(arguments))
                known = None
            try:
                entry_point = compile(sig)
                if is_own and known is None:
                    compiled = dispatcher.overloads[arguments]
                    if inline:
                        call_directly(dispatcher, compiled, compiled.fndesc, compiled.library)
                    else:
                        call_by_symbol(dispatcher, compiled, cache.symbol(sig, compiled.library.codegen))
                return entry_point
            finally:
                cache.inside = outer

    def add(compiled: CompileResult) -> None:
        if cache.inside:
            dispatcher.overloads[tuple(compiled.signature.args)] = compiled  # and not where calls from Python find it
        else:
            add_overload(compiled)

    dispatcher.compile, dispatcher.add_overload = compile_alone, add


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


def is_inside(compiled: CompileResult) -> bool:
    """Whether a compiled function has no way in from Python."""
    return not compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cpython_wrapper_name)


@functools.cache
def kernel_folder() -> KernelFolder:
    """The `KernelFolder` of this version of the sources."""
    return KernelFolder(cache_folder())


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
