"""All that the package uses of numba and llvmlite beyond their public interfaces, and the versions that it was tested with.

Public are `numba`, `numba.types`, `numba.extending` with `cgutils` and the context and builder that it hands to code generators,
`numba.core`'s `config` and `errors`, and llvmlite's `ir` and `binding`. What is not may change with any release: on a version that was not
tested kernels are compiled by `numba.njit` alone (compilation.py), which takes longer and computes the same up to round-off, and
only the names above "Tested versions only" are used.

Calls by symbols: numba links a copy of a callee into its caller and optimises the two together, so that what stands at the end of a chain
of calls is compiled once per link of the chain: half of the time that the package took to compile. Called by a symbol it costs no
measurable time more, since what a sweep calls for every point is inlined. Machine code that comes from the cache has the symbols that it
needs defined first, by numba's own hook for what must be there before code is loaded.
"""

import copy
import functools
import inspect
import os
import re
from collections.abc import Callable
from typing import Any, cast

import numba
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate as AttributeTemplate
from numba.core.typing.templates import ConcreteTemplate as ConcreteTemplate
from numba.core.typing.templates import infer_global as infer_global

from soft_tendon_env.tools.versions import fits

TESTED = ">=0.63.1,<0.69"
"""Versions of numba whose internals are known to be as this module needs them; each brings its own version of llvmlite."""
PLAIN = "SOFT_TENDON_ENV_PLAIN_NUMBA"
"""Environment variable: 1 has a tested version treated as one that is not."""

IS_TESTED = fits(numba.__version__, TESTED) and os.environ.get(PLAIN, "0") in ("", "0")


def emit_call_at(context: Any, builder: ir.IRBuilder, address: ir.Value, kinds: Any, given: Any) -> Any:
    """Call the compiled function at an address, with arguments of these types; it returns nothing, and its errors are the caller's."""
    pointer = builder.inttoptr(address, context.call_conv.get_function_type(types.none, kinds).as_pointer())
    if IS_TESTED:
        return emit_call(context, builder, pointer, types.none, kinds, given)
    status, _ = context.call_conv.call_function(builder, pointer, types.none, kinds, given)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return context.get_dummy_value()


def address_of(compiled: Any) -> int:
    """Address of the machine code of a compiled function."""
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


# Tested versions only

if IS_TESTED:
    from numba.core import event as event
    from numba.core.callconv import RETCODE_OK
    from numba.core.compiler import CompileResult
    from numba.core.compiler_lock import global_compiler_lock as global_compiler_lock
    from numba.core.runtime import rtsys
    from numba.core.serialize import NumbaPickler as NumbaPickler
    from numba.core.serialize import dumps as dumps
    from numba.core.sigutils import normalize_signature

SYMBOLS = __name__.partition(".")[0] + "/"
"""Prefix of the symbols of kernels."""
_SYMBOL = re.compile(rb"\b" + SYMBOLS.encode() + rb"[\w./-]+?\.[0-9a-f]{16}\.nbc")

Definition = Callable[[], None]
"""Called before machine code is loaded, to define a symbol that it calls; LookupError: it cannot be used any more."""
Reduced = tuple[Any, ...]
"""A compiled function as numba serialises it: its library, then what describes it."""


def quick_options(counted: bool) -> dict[str, bool]:
    """Options of `numba.njit` for kernels: no way in from C, and references to arrays are counted only if asked for."""
    return {"no_cfunc_wrapper": True, "_nrt": counted}


class SymbolLibrary:
    """Stand-in for numba's code library: no code, but what has to be called before machine code that was linked with it is loaded."""

    def __init__(self, *definitions: Definition) -> None:
        self._reload_init = set(definitions)

    def _ensure_finalized(self) -> None:
        """Nothing is left to do."""

    def _get_module_for_linking(self) -> binding.ModuleRef:
        return _no_code()


@functools.cache
def _no_code() -> binding.ModuleRef:
    return binding.parse_assembly("")


def needs(compiled: Any, definition: Definition) -> None:
    """Have `definition` called wherever a function that links a copy of the compiled one is loaded later."""
    compiled.library._reload_init.add(definition)


def call_by_symbol(dispatcher: Any, compiled: Any, symbol: str, definition: Definition) -> None:
    """Let functions that are compiled from here on call what a dispatcher has just compiled by this symbol."""
    binding.add_symbol(symbol, address_of(compiled))
    described = copy.copy(compiled.fndesc)
    described.mangled_name = symbol
    _call(dispatcher, compiled, described, SymbolLibrary(definition))


def call_copy(dispatcher: Any, compiled: Any) -> None:
    """Let functions that are compiled from here on link a copy of what a dispatcher has just compiled, to be inlined."""
    _call(dispatcher, compiled, compiled.fndesc, compiled.library)


def _call(dispatcher: Any, compiled: Any, described: Any, library: Any) -> None:
    def emit(context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
        function = context.declare_function(builder.module, described)
        return emit_call(context, builder, function, described.restype, described.argtypes, given)

    if isinstance(described.restype, types.Optional):
        return  # whether there is a number or None is told by the same code as errors: numba links a copy
    context, call = dispatcher.targetctx, cast(Any, emit)
    call.signature, call.libs = described.argtypes, (library,)
    context.remove_user_function(compiled.entry_point)
    context._defns[compiled.entry_point].append(call, call.signature)


def emit_call(context: Any, builder: ir.IRBuilder, function: ir.Value, returned: Any, kinds: Any, given: Any) -> Any:
    """Call a compiled function with arguments of these types, and take its errors for the caller's own: numba has every caller find out of
    what kind they are, which is more to compile than most calls."""
    result, error = cgutils.alloca_once(builder, context.get_return_type(returned)), builder.function.args[1]
    arguments = context.get_arg_packer(kinds).as_arguments(builder, given)
    code = builder.call(function, [result, error, *arguments])
    with cgutils.if_unlikely(builder, builder.icmp_signed("!=", code, RETCODE_OK)):
        builder.ret(code)
    return context.get_returned_value(builder, returned, builder.load(result))


def keep_in(dispatcher: Any, cache: Any, is_done: Callable[[Any, Any], None]) -> None:
    """Give a dispatcher a `KernelCache`. What was compiled without a way in from Python is compiled again when Python calls it.

    is_done: called with the signature and the compiled function, once that is compiled or loaded.
    """
    compile, add_overload = dispatcher.compile, dispatcher.add_overload
    replaced: list[Any] = []  # machine code that others may still call

    @functools.wraps(compile)
    def compile_alone(sig: Any) -> Any:
        arguments = tuple(normalize_signature(sig)[0])
        with global_compiler_lock, cache.compiling():  # numba saves at the very end
            dispatcher.targetoptions["no_cpython_wrapper"] = cache.inside
            known = dispatcher.overloads.get(arguments)
            if known is not None and not cache.inside and is_inside(known):
                replaced.append(dispatcher.overloads.pop(arguments))
                known = None
            entry_point = compile(sig)
            if known is None:
                is_done(sig, dispatcher.overloads[arguments])
            return entry_point

    def add(compiled: Any) -> None:
        if cache.inside:
            dispatcher.overloads[tuple(compiled.signature.args)] = compiled  # and not where calls from Python find it
        else:
            add_overload(compiled)

    dispatcher._cache, dispatcher.compile, dispatcher.add_overload = cache, compile_alone, add


def cache_of(dispatcher: Any) -> Any:
    """The cache of a dispatcher's machine code."""
    return getattr(dispatcher, "_cache", None)


def is_inside(compiled: Any) -> bool:
    """Whether a compiled function has no way in from Python."""
    return not compiled.library.get_pointer_to_function(compiled.fndesc.llvm_cpython_wrapper_name)


def target_of(context: Any) -> tuple[Any, ...]:
    """Processor, its features and the platform that machine code is made for."""
    return tuple(context.codegen().magic_tuple())


def initialize(context: Any) -> None:
    """Bring in what loaded machine code needs: numba's allocator alone, where to compile needs much more."""
    rtsys.initialize(context)


def reduced(compiled: Any, has_symbol: bool) -> Reduced | None:
    """A compiled function to be pickled; None where its machine code holds addresses of this process.

    has_symbol: leave out what callers would link and inline, but for the functions' names: to read and list it takes longer than to load
    the machine code.
    """
    if compiled.library.has_dynamic_globals:
        return None
    library, *rest = compiled._reduce()
    if has_symbol:
        own, (name, kind, (machine_code, _)) = compiled.fndesc, library
        functions = (own.llvm_func_name, *(() if is_inside(compiled) else (own.llvm_cpython_wrapper_name,)))
        names = binding.parse_assembly("\n".join(f'define void @"{function}"() {{ ret void }}' for function in functions))
        library = name, kind, (machine_code, names.as_bitcode())
    return library, *rest


def rebuilt(context: Any, *reduced: Any) -> Any:
    """The compiled function that `reduced` was made of, after its definitions have been called.

    They stay with its library: numba forgets them there, so that a function that is compiled later with a copy of this one's code would be
    cached without the definitions of the symbols that the copy calls. The process after that would jump to nowhere, or LLVM end it.
    Raises LookupError where a definition does, or where a symbol is not defined all the same, as in what was cached by an older version.
    """
    given = _PARAMETERS.bind(context, *reduced)
    definitions, library = given.arguments["reload_init"] or (), given.arguments["libdata"]
    for define in definitions:
        define()
    for symbol in set(_SYMBOL.findall(library[2][0])):
        if not binding.address_of_symbol(symbol.decode()):
            raise LookupError(f"it calls {symbol.decode()}, which nothing defines")
    given.arguments["reload_init"] = ()
    compiled = _REBUILD(*given.args)
    compiled.library._reload_init.update(definitions)
    return compiled


def _rebuilt_or_none(cls: Any, *given: Any) -> Any:
    try:
        return rebuilt(*given)
    except LookupError:
        return None  # to numba's cache, it is not there


if IS_TESTED:
    _REBUILD = CompileResult._rebuild
    _PARAMETERS = inspect.signature(_REBUILD)
    CompileResult._rebuild = classmethod(_rebuilt_or_none)
