"""Calls from kernel to kernel: by symbols, or of copies that are to be inlined; and what tells later processes whether they still fit."""

import functools
import hashlib
import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

from llvmlite import binding

from soft_tendon_env.compiler.cache_folder import PACKAGE, own_digest
from soft_tendon_env.compiler.code_digest import code_digest
from soft_tendon_env.compiler.numba_internals import call_by_symbol, call_copy, needs


class Definition(NamedTuple):
    """Defines the symbol of a kernel for arguments of these types, or none where callers have a copy of its code.

    Goes into the cache with the machine code of its callers, that of a user's own `numba.njit(cache=True)` too, under this name.
    Raises LookupError where that machine code was made for another version of the kernel, or would jump to nowhere.
    """

    module: str
    kernel: str
    arguments: tuple[Any, ...]
    symbol: str
    made_for: str = ""  # digest of the kernel's code

    def __call__(self) -> None:
        if self.made_for != kernel_digest(self.module, self.kernel):
            raise LookupError(f"it calls another version of {self.kernel} in {self.module}")
        if not self.symbol:
            return
        dispatcher = getattr(importlib.import_module(self.module), self.kernel)
        if self.arguments not in dispatcher.overloads:
            dispatcher.compile(self.arguments)
        if not binding.address_of_symbol(self.symbol):
            raise LookupError(f"it calls {self.symbol}, which is not there")


@functools.cache
def kernel_digest(module: str, kernel: str) -> str:
    """Digest of all that a kernel is compiled from, and of the compiler. Raises LookupError where there is no such kernel."""
    try:
        function = getattr(importlib.import_module(module), kernel)
    except (ImportError, AttributeError) as error:
        raise LookupError(f"it calls {kernel} in {module}, which is not there") from error
    return hashlib.sha256(f"{own_digest()} {code_digest(function)}".encode()).hexdigest()[:16]


def is_of_package(function: Callable[..., Any]) -> bool:
    """Whether a function is the package's own and no closure, so that every process finds it by its name."""
    return (getattr(function, "__module__", None) or "").partition(".")[0] == PACKAGE.name and "<locals>" not in function.__qualname__


def link(dispatcher: Any, compiled: Any, symbol: str, inline: bool) -> None:
    """Have functions that are compiled from here on call what a kernel has just compiled: one of the package by its symbol, or as a copy
    that they inline; one from elsewhere as numba does it."""
    own = dispatcher.py_func
    try:
        made_for = kernel_digest(own.__module__, own.__qualname__)
    except LookupError:
        return  # a closure, or one that has another name than its own: nobody finds it later
    definition: Any = Definition(own.__module__, own.__qualname__, tuple(compiled.signature.args) if symbol else (), symbol, made_for)
    needs(compiled, definition)
    if symbol:
        call_by_symbol(dispatcher, compiled, symbol, definition)
    elif inline and is_of_package(own):
        call_copy(dispatcher, compiled)
