"""Calls from kernel to kernel by symbols: each is compiled once, where numba would copy its code into every function that calls it.

numba links a copy of a callee into its caller and optimises the two together, so that what stands at the end of a chain of calls is
compiled once per link of the chain: half of the time that the package took to compile. Called by a symbol it costs no measurable time
more, since what a sweep calls for every point is inlined. Machine code that comes from the cache has the symbols that it needs defined
first, by numba's own hook for what must be there before code is loaded.
"""

import copy
import functools
import importlib
from collections.abc import Callable
from typing import Any, NamedTuple, cast

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.callconv import RETCODE_OK

PACKAGE = __name__.partition(".")[0]


class Definition(NamedTuple):
    """Defines the symbol of a kernel for arguments of these types; goes into the cache with the machine code of its callers.

    Raises LookupError where the kernel has another symbol by now: what calls by this one would jump to nowhere.
    """

    module: str
    kernel: str
    arguments: tuple[Any, ...]
    symbol: str

    def __call__(self) -> None:
        dispatcher = getattr(importlib.import_module(self.module), self.kernel)
        if self.arguments not in dispatcher.overloads:
            dispatcher.compile(self.arguments)
        if not binding.address_of_symbol(self.symbol):
            raise LookupError(f"it calls {self.symbol}, which is not there")


class Elsewhere:
    """What numba links a caller with, in place of the kernel's code library: no code, but the definition of its symbol."""

    def __init__(self, definition: Definition) -> None:
        self._reload_init = {definition}

    def _ensure_finalized(self) -> None:
        """Nothing is left to do."""

    def _get_module_for_linking(self) -> binding.ModuleRef:
        return _no_code()


@functools.cache
def _no_code() -> binding.ModuleRef:
    return binding.parse_assembly("")


def is_of_package(function: Callable[..., Any]) -> bool:
    """Whether a function is the package's own and no closure, so that every process finds it by its name."""
    return (getattr(function, "__module__", None) or "").partition(".")[0] == PACKAGE and "<locals>" not in function.__qualname__


def call_by_symbol(dispatcher: Any, compiled: Any, symbol: str) -> None:
    """Let functions that are compiled from here on call what a dispatcher has just compiled by this symbol."""
    function, described = dispatcher.py_func, copy.copy(compiled.fndesc)
    binding.add_symbol(symbol, compiled.library.get_pointer_to_function(described.llvm_func_name))
    described.mangled_name = symbol
    definition = Definition(function.__module__, function.__qualname__, compiled.signature.args, symbol)
    call_directly(dispatcher, compiled, described, Elsewhere(definition))


def call_directly(dispatcher: Any, compiled: Any, described: Any, library: Any) -> None:
    """Let functions that are compiled from here on call what a dispatcher has just compiled as a function that is described so."""

    def emit(context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
        function = context.declare_function(builder.module, described)
        return emit_call(context, builder, function, described.restype, described.argtypes, given)

    if isinstance(described.restype, types.Optional):
        return  # whether there is a number or None is told by the same code as errors
    context, call = dispatcher.targetctx, cast(Any, emit)
    call.signature, call.libs = described.argtypes, (library,)
    context.remove_user_function(compiled.entry_point)
    context._defns[compiled.entry_point].append(call, call.signature)


def emit_call(context: Any, builder: ir.IRBuilder, function: ir.Value, returned: Any, kinds: Any, given: Any) -> Any:
    """Call a compiled function with arguments of these types, and take its errors for the caller's own: numba has every caller find out of
    what kind they are, which is more to compile than most calls."""
    result, error = cgutils.alloca_once(builder, context.call_conv.get_return_type(returned).pointee), builder.function.args[1]
    arguments = context.get_arg_packer(kinds).as_arguments(builder, given)
    code = builder.call(function, [result, error, *arguments])
    with cgutils.if_unlikely(builder, builder.icmp_signed("!=", code, RETCODE_OK)):
        builder.ret(code)
    return context.get_returned_value(builder, returned, builder.load(result))


def emit_call_at(context: Any, builder: ir.IRBuilder, address: ir.Value, kinds: Any, given: Any) -> Any:
    """The same of the function at an address, which returns nothing."""
    pointer = builder.inttoptr(address, context.call_conv.get_function_type(types.none, kinds).as_pointer())
    return emit_call(context, builder, pointer, types.none, kinds, given)


def without_code_to_link(library: tuple[str, str, tuple[bytes, bytes]], functions: tuple[str, ...]) -> tuple[str, str, tuple[bytes, bytes]]:
    """A library as numba serialises it, of which nothing but the names of the functions is left to be linked with callers.

    To read and list the rest of it takes longer than to load the machine code.
    """
    name, kind, (machine_code, _) = library
    names = binding.parse_assembly("\n".join(f'define void @"{function}"() {{ ret void }}' for function in functions))
    return name, kind, (machine_code, names.as_bitcode())
