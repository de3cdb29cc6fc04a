"""Digest of the code that a kernel is compiled from, as far as it is not of the sources that name the cache's folder (cache_folder.py).

The folder is named after the package's mechanics. Whatever else is compiled into machine code, an effect of the package or of a user's
own file with the functions and constants that it uses, is followed from the function itself: bytecode, source files, closures and globals.
"""

import functools
import hashlib
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import types

from soft_tendon_env.compiler.cache_folder import PACKAGE, kernel_sources

WITH_OWN_CODE = ("math", "cmath", "numpy", "numba")
"""Packages whose functions numba compiles from code of its own, so that theirs need not be followed."""

_FUNCTIONS: dict[type, dict[str, Callable[..., Any]]] = {}


def selects_code(parameters_class: type, purpose: str, function: Callable[..., Any]) -> None:
    """Registers a function as code that arguments of this class select, alone or within named tuples, so that it is part of the cache key.

    numba's `overload` chooses code by types, of which a kernel's own source tells nothing. A later call with the same purpose replaces the
    function.
    """
    _FUNCTIONS.setdefault(parameters_class, {})[purpose] = function


def selecting_classes(signature: Iterable[Any]) -> Iterator[type]:
    """The classes of `selects_code` among numba's types of arguments, within tuples too."""
    for kind in signature:
        own = getattr(kind, "instance_class", None)
        if own in _FUNCTIONS:
            yield own
        if isinstance(kind, types.BaseTuple):
            yield from selecting_classes(kind.types)


def selected_code(signature: Iterable[Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Code that the types of a signature compile in: the place of each function, that of one of the package within it, and its digest.

    Symbols are named after places, and machine code that calls by them serves every copy of the package.
    """
    classes = selecting_classes(signature)
    chosen: list[tuple[type, Any]] = [(own, function) for own in classes for function in (own, *_FUNCTIONS[own].values())]
    places = (f"{class_name(own)} {_place(_file(_python(function)))}" for own, function in chosen)
    return tuple(places), tuple(code_digest(function) for _, function in chosen)


def class_name(cls: type) -> str | None:
    """The name by which `class_of_name` finds a class of `selects_code`; None for other classes."""
    return f"{cls.__module__}:{cls.__qualname__}" if cls in _FUNCTIONS else None


def class_of_name(name: str) -> type:
    """The class of `selects_code`, the last where several had the name. Raises LookupError where there is none."""
    return {class_name(cls): cls for cls in _FUNCTIONS}[name]


def code_digest(function: Callable[..., Any]) -> str:
    """Digest of a function, compiled or not, and of all that it refers to, but for what stands in the package's kernel sources."""
    digest, seen, waiting = hashlib.sha256(), set(), [function]
    while waiting:
        value = _python(waiting.pop())
        if not isinstance(value, FunctionType | ModuleType | type):
            digest.update(repr(_constant(value)).encode())
        elif id(value) not in seen:
            seen.add(id(value))
            file = _file(value)
            described = getattr(value, "__module__", ""), value.__name__, getattr(value, "__annotations__", "") if file is None else ""
            digest.update(f"{described} {_file_digest(file)}\n".encode())
            if isinstance(value, FunctionType) and file not in _covered() and (value.__module__ or "").split(".")[0] not in WITH_OWN_CODE:
                digest.update(code_text(value.__code__).encode())
                waiting += _referred(value)
    return digest.hexdigest()


def code_text(code: CodeType) -> str:
    """Bytecode with names and constants as text: two lambdas in one line have all else in common."""
    constants = [code_text(constant) if isinstance(constant, CodeType) else constant for constant in code.co_consts]
    return repr((code.co_code, code.co_names, constants))


def _referred(function: FunctionType) -> list[Any]:
    """The values of closure, defaults and globals, and of modules among them the attributes, that a function can use by their names."""
    names = sorted({name for code in _nested(function.__code__) for name in code.co_names})
    values = [function.__globals__[name] for name in names if name in function.__globals__]
    attributes = [getattr(value, name) for value in values if isinstance(value, ModuleType) for name in names if hasattr(value, name)]
    return [*values, *attributes, *(cell.cell_contents for cell in function.__closure__ or ()), *(function.__defaults__ or ())]


def _nested(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _nested(constant)


def _constant(value: Any) -> Any:
    """A constant as its text tells it apart: arrays whole, of other objects their type and what they say, less addresses."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return type(value).__name__, [_constant(own) for own in value]
    return type(value).__name__, re.sub(" at 0x[0-9a-f]+", "", repr(value))


def _python(function: Any) -> Any:
    """The Python function that a dispatcher of numba compiles; anything else as it is."""
    return getattr(function, "py_func", function)


def _file(value: Any) -> Path | None:
    """The file in which a function, class or module is written; None where it is typed in, or comes with the interpreter."""
    module = value if isinstance(value, ModuleType) else sys.modules.get(value.__module__ or "")
    named = value.__code__.co_filename if isinstance(value, FunctionType) else getattr(module, "__file__", None)
    return Path(named).absolute() if named and Path(named).is_file() else None


def _place(file: Path | None) -> str:
    """A file of the package as it stands in it, others by their whole path."""
    if file is None:
        return "interactive"
    return str(file.relative_to(PACKAGE) if file.is_relative_to(PACKAGE) else file)


@functools.cache
def _covered() -> frozenset[Path]:
    return frozenset(kernel_sources(PACKAGE))


def _file_digest(file: Path | None) -> str:
    return "" if file is None else "covered" if file in _covered() else file_digest(file)


@functools.cache
def file_digest(file: Path) -> str:
    """Digest of a file as it was at the first call."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


@functools.cache
def sources_digest(*patterns: str) -> str:
    """Digest of the files of the package that match one of the patterns, with their names."""
    files = sorted(file for pattern in patterns for file in PACKAGE.glob(pattern))
    return hashlib.sha256("".join(f"{file.relative_to(PACKAGE)} {file_digest(file)}\n" for file in files).encode()).hexdigest()


def source_of(function: FunctionType) -> str:
    """Digest of the source of a function by itself. Raises OSError where there is none."""
    file = _file(function)
    return file_digest(file) if file is not None else hashlib.sha256(inspect.getsource(function).encode()).hexdigest()
