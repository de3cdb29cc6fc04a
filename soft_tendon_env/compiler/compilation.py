"""Compilation of the package's kernels: two decorators over `numba.njit`.

Kernels call each other by address. The cache is numba's own, whose files are compared with their
digests.

numba links a copy of a callee into its caller and optimises the two together, so that what stands
at the end of a chain of calls is compiled once per link of the chain: two thirds of the time that
the package would take to compile. Kernels of the package are therefore compiled by themselves. A
call reads the callee's address in a word of the caller's machine code; while that is empty, as in
machine code that comes from the cache, `_find` loads or compiles the callee first.

numba's cache compares only the file that a function stands in, so that it keeps a stale kernel when
a kernel in *another* file changes (numba issue 1833): the package has a folder of it for every
version of the kernels' sources. And of two processes that save machine code for different arguments
of a function at once, it can keep the one's for the other's: one process at a time compiles, and
one thread of it.
"""

import ctypes
import functools
import inspect
import pickle
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import binding, ir
from numba import config, types
from numba.core import cgutils
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import lower_builtin, type_callable

from soft_tendon_env.compiler.first_use import KeptKernel, warn_that_nothing_is_kept
from soft_tendon_env.compiler.kept_code import KeptCode, cache_folder, is_of_package
from soft_tendon_env.tools.files import PACKAGE

OPTIONS = {
    "error_model": "numpy",
    "fastmath": {"contract"},
    "nogil": True,
    "boundscheck": None,
    "no_cfunc_wrapper": True,
}
"""Options of `numba.njit`; "contract" lets LLVM fuse multiply and add, and nothing that would hide
a nan or reorder a sum."""
FIND = f"{PACKAGE.name}.find_kernel"
"""Symbol of `_find` in machine code."""
_WORD = ir.IntType(64)
"""Type of an address in machine code as a number."""
_ADDRESS = ir.IntType(8).as_pointer()
"""Type of an address in machine code as LLVM wants it."""

_errors: list[BaseException] = []
"""Why kernels could not be compiled that machine code called, for the one that Python called to
raise."""


def kernel(function: Any = None, *, inline: bool = False, refcount: bool | None = None) -> Any:
    """Compiles a function of arrays and scalars on its first call.

    It is a decorator: `@kernel`, or `@kernel(inline=True)`. Machine code of the package is kept.
    Kernels of other files are compiled by every process: numba would not notice that something they
    use from a third file has changed. With NUMBA_DISABLE_JIT=1 the function comes back as it is.

    Args:
        function: to compile; None returns the decorator.
        inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a
            sweep. Other kernels are called.
        refcount: count references to arrays, without which numba refuses what makes arrays or
            returns parts of them, and with which there is a third more to compile; by default not
            in this package.

    Returns:
        The compiled function.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, refcount=refcount)
    if config.DISABLE_JIT:
        return function
    is_ours = is_of_package(function)
    options = {
        **OPTIONS,
        "forceinline": inline,
        "_nrt": not is_ours if refcount is None else refcount,
    }
    return Kernel(function, options).call if is_ours else numba.njit(**options)(function)


def phase(function: Any) -> Any:
    """Makes a kernel that returns nothing and that not every arm needs: a decorator.

    It is compiled when it is first called, not with its callers.
    """
    return (
        function
        if config.DISABLE_JIT
        else Kernel(function, {**OPTIONS, "_nrt": False}, is_phase=True).call
    )


class NotCompiledError(RuntimeError):
    """Raised by machine code that calls a kernel which cannot be compiled."""


class Kernel:
    """A kernel of the package, `call`: as Python calls it, and as kernels do.

    keep: its machine code, for later processes.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        options: dict[str, Any],
        is_phase: bool = False,
        keep: bool = True,
    ) -> None:
        self._function = function
        self._options = options
        self._is_phase = is_phase
        self._keep = keep
        self._from_kernels: Any = None  # numba's function, when a kernel first calls it
        run: Any = None

        # A method takes as long again as numba's function does to begin.
        @functools.wraps(function)
        def call(*arguments: Any) -> Any:
            nonlocal run
            run = run or self._jitted("from_python")
            try:
                return run(*arguments)
            except NotCompiledError:
                raise _errors.pop() from None

        call.kernel, call.py_func, self.call = self, function, call  # type: ignore[attr-defined]
        type_callable(call)(self._typer)
        lower_builtin(call, types.VarArg(types.Any))(self._emit)

    def _jitted(self, way: str, **options: bool) -> Any:
        """Function of numba for this way in.

        Its machine code is kept if there is a cache folder.
        """
        options = {**self._options, **options}
        cache = cache_folder() if self._keep else None
        if cache is None:
            return numba.njit(**options)(self._function)
        module, name = self._function.__module__, self._function.__qualname__
        kept = KeptCode(cache / f"{module}.{name}.{way}")
        try:
            return KeptKernel(self._function, options, kept).dispatcher
        except OSError as error:
            warn_that_nothing_is_kept(error, cache)
            return numba.njit(**options)(self._function)

    def compiled(self, kinds: tuple[types.Type, ...]) -> Any:
        """The compiled function for arguments of these types, as kernels call it."""
        with global_compiler_lock:
            if self._from_kernels is None:
                # A way in from Python would be a fifth of a compilation.
                self._from_kernels = self._jitted("from_kernels", no_cpython_wrapper=True)
            if kinds not in self._from_kernels.overloads:
                self._from_kernels.compile(kinds)
            return self._from_kernels.overloads[kinds]

    def _typer(self, context: Any) -> Callable[..., types.Type]:
        def returned(*kinds: types.Type) -> types.Type:
            return types.none if self._is_phase else self.compiled(kinds).signature.return_type

        returned.__signature__ = inspect.signature(self._function)  # type: ignore[attr-defined]
        return returned

    def _emit(self, context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
        """Emits a call from a kernel: of a copy that is inlined, or at the address.

        The address is found at the first call.
        """
        kinds = signature.args
        if self._options.get("forceinline"):
            compiled = self.compiled(kinds)
            context.add_linking_libs([compiled.library])
            return context.call_internal(builder, compiled.fndesc, compiled.signature, given)
        word = cgutils.add_global_variable(builder.module, _WORD, "address")
        word.linkage, word.initializer = "internal", _WORD(0)
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(word))):
            find = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(ir.VoidType(), [_ADDRESS, _ADDRESS, _WORD]), FIND
            )
            callee = cgutils.make_bytearray(pickle.dumps((self.call, kinds)))
            places = (word, cgutils.global_constant(builder, "callee", callee))
            builder.call(
                find,
                [*(builder.bitcast(place, _ADDRESS) for place in places), _WORD(callee.type.count)],
            )
            with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(word))):
                context.call_conv.return_user_exc(
                    builder, NotCompiledError, (f"{self._function.__name__} cannot be compiled",)
                )
        return emit_call_at(
            context, builder, builder.load(word), signature.return_type, kinds, given
        )


@ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
def _find(word: int, callee: int, size: int) -> None:
    """Writes the address of a kernel into a caller's word, or keeps the error.

    The caller then finds the word empty.
    """
    try:
        called, kinds = pickle.loads(ctypes.string_at(callee, size))
        ctypes.c_int64.from_address(word).value = address_of(called.kernel.compiled(kinds))
    except BaseException as error:  # an interrupt too
        _errors.append(error)


def emit_call_at(
    context: Any,
    builder: ir.IRBuilder,
    address: ir.Value,
    returned: types.Type,
    kinds: Any,
    given: Any,
) -> Any:
    """Emits a call of the compiled function at an address.

    It has arguments of these types; its errors are the caller's.
    """
    pointer = builder.inttoptr(
        address, context.call_conv.get_function_type(returned, kinds).as_pointer()
    )
    status, result = context.call_conv.call_function(builder, pointer, returned, kinds, given)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return result


def address_of(compiled: Any) -> int:
    """Address of the machine code of a compiled function."""
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


if not config.DISABLE_JIT:
    binding.add_symbol(FIND, ctypes.cast(_find, ctypes.c_void_p).value)
