"""Cache of compiled kernels: a file per kernel and signature, read where it was made for the same code, types and processor."""

import contextlib
import gc
import hashlib
import inspect
import io
import pickle
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

from numba.core.errors import NumbaWarning

from soft_tendon_env.compiler.cache_folder import PACKAGE
from soft_tendon_env.compiler.code_digest import class_name, class_of_name, code_digest, selected_code, source_of
from soft_tendon_env.compiler.kernel_folder import KernelFolder, kernel_folder
from soft_tendon_env.compiler.linking import is_of_package, link
from soft_tendon_env.compiler.numba_internals import SYMBOLS, NumbaPickler, dumps, initialize, keep_in, rebuilt, reduced, target_of

UNREADABLE = (pickle.UnpicklingError, EOFError, ImportError, AttributeError, LookupError, TypeError)
"""Raised by unpickling where a class has moved or become another one."""


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

    @contextlib.contextmanager
    def compiling(self) -> Iterator[None]:
        """Context in which the function is compiled or loaded, with those that it calls."""
        outer = self.inside
        with self._folder.compiling(), collector_paused():
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
            self._folder.lock()
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
    """Gives a numba dispatcher a `KernelCache`.

    A kernel of the package is called by a symbol from others, see linking, unless it is to be inlined; what only others call gets no way
    in from Python, which takes a fifth of a first compilation, until Python calls it.
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


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
