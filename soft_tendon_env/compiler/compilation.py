"""How the package compiles its kernels: two decorators over `numba.njit`, and calls from one kernel to another by address.

numba links a copy of a callee into its caller and optimises the two together, so that what stands at the end of a chain of calls is
compiled once per link of the chain: two thirds of the time that the package would take to compile. Kernels of the package are therefore
compiled by themselves. A call reads the callee's address in a word of the caller's machine code; while that is empty, as in machine code
that comes from the cache, `_find` loads or compiles the callee first.
"""

import contextlib
import ctypes
import functools
import inspect
import pickle
import threading
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import binding, ir
from numba import config, types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

from soft_tendon_env.compiler.kernel_cache import cache_folder, compiling
from soft_tendon_env.tools.files import PACKAGE

OPTIONS = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True, "boundscheck": None, "no_cfunc_wrapper": True}
"""Of `numba.njit`; "contract" lets LLVM fuse multiply and add, and nothing that would hide a nan or reorder a sum."""
FIND = f"{PACKAGE.name}.find_kernel"
_WORD = ir.IntType(64)
_setting = threading.Lock()
_errors: list[BaseException] = []
"""Why kernels could not be compiled when machine code called them, for the kernel that Python has called to raise."""


def kernel(function: Any = None, *, inline: bool = False, counted: bool | None = None) -> Any:
    """Compile a function of arrays and scalars on its first call: `@kernel`, or `@kernel(inline=True)`.

    inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a sweep. Other kernels are called.
    counted: count references to arrays, without which numba refuses what makes arrays or returns parts of them, and with which there is
    a third more to compile; by default not in this package.
    Machine code of the package is kept. Kernels of other files are compiled by every process: numba would not notice that something they
    use from a third file has changed. With NUMBA_DISABLE_JIT=1 the function comes back as it is.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, counted=counted)
    if config.DISABLE_JIT:
        return function
    own = is_of_package(function)
    options = {**OPTIONS, "forceinline": inline, "_nrt": not own if counted is None else counted}
    return Kernel(function, options) if own else numba.njit(**options)(function)


def phase(function: Any) -> Any:
    """A kernel that returns nothing and that not every arm needs: compiled when it is first called, not with its callers."""
    return function if config.DISABLE_JIT else Kernel(function, {**OPTIONS, "_nrt": False}, is_phase=True)


def is_of_package(named: Any) -> bool:
    """Whether a function or class is the package's own and no local one, so that every process finds it by its name."""
    return (named.__module__ or "").partition(".")[0] == PACKAGE.name and "<locals>" not in named.__qualname__


class NotCompiledError(RuntimeError):
    """Raised by machine code that calls a kernel which cannot be compiled."""


class Kernel:
    """A kernel of the package: as Python calls it, and as other kernels do."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], is_phase: bool = False, keep: bool = True) -> None:
        """keep: whether its machine code is kept for later processes."""
        functools.update_wrapper(self, function)
        self.py_func, self._options, self._is_phase, self._keep = function, options, is_phase, keep
        type_callable(self)(self._typer)
        lower_builtin(self, types.VarArg(types.Any))(self._emit)

    def __call__(self, *arguments: Any) -> Any:
        try:
            return self.from_python(*arguments)
        except NotCompiledError:
            raise _errors.pop() from None

    def __reduce__(self) -> str:
        return self.py_func.__qualname__

    @functools.cached_property
    def from_python(self) -> Any:
        """numba's function that Python calls."""
        return self._jitted("from_python")

    @functools.cached_property
    def from_kernels(self) -> Any:
        """The same without a way in from Python, which is a fifth of a compilation."""
        return self._jitted("from_kernels", no_cpython_wrapper=True)

    def _jitted(self, below: str, **options: bool) -> Any:
        """numba's function, whose machine code numba keeps in a folder below the cache folder, if there is one."""
        folder = cache_folder() if self._keep else None
        with _setting, contextlib.ExitStack() as after:
            after.callback(setattr, config, "CACHE_DIR", config.CACHE_DIR)
            config.CACHE_DIR = str(folder / below) if folder else ""
            dispatcher = numba.njit(**self._options, **options, cache=folder is not None)(self.py_func)
        compile = dispatcher.compile

        def compile_alone(kinds: tuple[types.Type, ...]) -> Any:
            with compiling():
                entry_point = compile(kinds)
            if kinds not in dispatcher.overloads:
                raise RuntimeError(f"machine code in {folder} is not what its name says: delete that folder")
            return entry_point

        dispatcher.compile = compile_alone
        return dispatcher

    def compiled(self, kinds: tuple[types.Type, ...]) -> Any:
        """The compiled function for arguments of these types, as kernels call it."""
        if kinds not in self.from_kernels.overloads:
            self.from_kernels.compile(kinds)
        return self.from_kernels.overloads[kinds]

    def _with_defaults(self, kinds: tuple[types.Type, ...]) -> tuple[types.Type, ...]:
        left_out = [*inspect.signature(self.py_func).parameters.values()][len(kinds) :]
        return *kinds, *(types.Omitted(parameter.default) for parameter in left_out)

    def _typer(self, context: Any) -> Callable[..., types.Type]:
        signature = inspect.signature(self.py_func)

        def returned(*kinds: types.Type, **named: types.Type) -> types.Type:
            given = signature.bind(*kinds, **named).args
            return types.none if self._is_phase else self.compiled(self._with_defaults(given)).signature.return_type

        returned.__signature__ = signature  # type: ignore[attr-defined]
        return returned

    def _emit(self, context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
        """Code of a call from a kernel: of a copy that is inlined, or at the address, which is found at the first call."""
        kinds = self._with_defaults(signature.args)
        given = [*given, *[context.get_dummy_value()] * (len(kinds) - len(given))]
        if self._options.get("forceinline"):
            compiled = self.compiled(kinds)
            context.add_linking_libs([compiled.library])
            return context.call_internal(builder, compiled.fndesc, compiled.signature, given)
        text, void_pointer = pickle.dumps((self, kinds)), cgutils.voidptr_t
        word = cgutils.add_global_variable(builder.module, _WORD, "address")
        word.linkage, word.initializer = "internal", ir.Constant(_WORD, 0)
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(word))):
            find_type = ir.FunctionType(ir.VoidType(), [void_pointer, void_pointer, _WORD])
            find = cgutils.get_or_insert_function(builder.module, find_type, FIND)
            callee = cgutils.global_constant(builder, "callee", cgutils.make_bytearray(text))
            builder.call(find, [builder.bitcast(word, void_pointer), builder.bitcast(callee, void_pointer), _WORD(len(text))])
            with cgutils.if_unlikely(builder, cgutils.is_null(builder, builder.load(word))):
                context.call_conv.return_user_exc(builder, NotCompiledError, (f"{self.py_func.__name__} cannot be compiled",))
        return emit_call_at(context, builder, builder.load(word), signature.return_type, kinds, given)


@ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
def _find(word: int, callee: int, size: int) -> None:
    """Write the address of a kernel into a caller's word, or keep the error: the caller finds the word empty."""
    try:
        called, kinds = pickle.loads(ctypes.string_at(callee, size))
        ctypes.c_int64.from_address(word).value = address_of(called.compiled(kinds))
    except BaseException as error:  # an interrupt too
        _errors.append(error)


def emit_call_at(context: Any, builder: ir.IRBuilder, address: ir.Value, returned: types.Type, kinds: Any, given: Any) -> Any:
    """Call the compiled function at an address, with arguments of these types; its errors are the caller's."""
    pointer = builder.inttoptr(address, context.call_conv.get_function_type(returned, kinds).as_pointer())
    status, result = context.call_conv.call_function(builder, pointer, returned, kinds, given)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return result


def address_of(compiled: Any) -> int:
    """Address of the machine code of a compiled function."""
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


if not config.DISABLE_JIT:
    binding.add_symbol(FIND, ctypes.cast(_find, ctypes.c_void_p).value)
