"""How the package compiles its kernels: two decorators over `numba.njit`, calls from kernel to
kernel by address, and numba's own cache.

numba links a copy of a callee into its caller and optimises the two together, so that what stands
at the end of a chain of calls is compiled once per link of the chain: two thirds of the time that
the package would take to compile. Kernels of the package are therefore compiled by themselves. A
call reads the callee's address in a word of the caller's machine code; while that is empty, as in
machine code that comes from the cache, `_find` loads or compiles the callee first.

numba's cache compares only the file that a function stands in, so that it keeps a stale kernel when
a kernel in *another* file changes (numba issue 1833): the package has a folder of it for every
version of the kernels' sources. And of two processes that save machine code for different arguments
of a function at once, it can keep the one's for the other's: one process at a time compiles.
"""

import contextlib
import ctypes
import functools
import hashlib
import inspect
import os
import pickle
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from filelock import FileLock, Timeout
from llvmlite import binding, ir
from numba import config, types
from numba.core import cgutils, event
from numba.extending import lower_builtin, type_callable

from soft_tendon_env.tools.files import PACKAGE, data_folders, new_data_folder, sources_digest
from soft_tendon_env.tools.messages import QUIET, say, say_once

OPTIONS = {
    "error_model": "numpy",
    "fastmath": {"contract"},
    "nogil": True,
    "boundscheck": None,
    "no_cfunc_wrapper": True,
}
"""Options of `numba.njit`; "contract" lets LLVM fuse multiply and add, and nothing that would hide
a nan or reorder a sum."""
KERNEL_SOURCES = ("compiler/*.py", "mechanics/**/*.py", "effects/**/*.py", "envs/kernels.py")
FOLDERS_KEPT = 3
PATIENCE = 600.0  # [s] for another process; who compiles for longer has been stopped
FIND = f"{PACKAGE.name}.find_kernel"
_WORD, _ADDRESS = ir.IntType(64), ir.IntType(8).as_pointer()

_setting, _compiling, _thread = threading.Lock(), threading.RLock(), threading.local()
_errors: list[
    BaseException
    # why kernels could not be compiled that machine code called, for the one that Python called to
    # raise
] = []


def kernel(function: Any = None, *, inline: bool = False, refcount: bool | None = None) -> Any:
    """Compile a function of arrays and scalars on its first call: `@kernel`, or
    `@kernel(inline=True)`.

    inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a sweep.
    Other kernels are called. refcount: count references to arrays, without which numba refuses what
    makes arrays or returns parts of them, and with which there is a third more to compile; by
    default not in this package. Machine code of the package is kept. Kernels of other files are
    compiled by every process: numba would not notice that something they use from a third file has
    changed. With NUMBA_DISABLE_JIT=1 the function comes back as it is.
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
    """A kernel that returns nothing and that not every arm needs: compiled when it is first called,
    not with its callers."""
    return (
        function
        if config.DISABLE_JIT
        else Kernel(function, {**OPTIONS, "_nrt": False}, is_phase=True).call
    )


def is_of_package(named: Any) -> bool:
    """Whether a function or class is the package's own and no local one, so that every process
    finds it by its name."""
    return (named.__module__ or "").partition(".")[
        0
    ] == PACKAGE.name and "<locals>" not in named.__qualname__


def _has_no_class_of_users(kind: types.Type) -> bool:
    """Whether no class in a type is a user's own."""
    return is_of_package(getattr(kind, "instance_class", Kernel)) and all(
        map(_has_no_class_of_users, getattr(kind, "types", ()))
    )


class NotCompiledError(RuntimeError):
    """Raised by machine code that calls a kernel which cannot be compiled."""


class Kernel:
    """A kernel of the package, `call`: as Python calls it, and as kernels do. keep: its machine
    code, for later processes."""

    def __init__(
        self,
        function: Callable[..., Any],
        options: dict[str, Any],
        is_phase: bool = False,
        keep: bool = True,
    ) -> None:
        self._function, self._options, self._is_phase, self._keep = (
            function,
            options,
            is_phase,
            keep,
        )
        run: Any = None

        @functools.wraps(function)
        def call(
            *arguments: Any,
        ) -> Any:  # a method takes as long again as numba's function does to begin
            nonlocal run
            run = run or self._jitted("from_python")
            try:
                return run(*arguments)
            except NotCompiledError:
                raise _errors.pop() from None

        call.kernel, call.py_func, self.call = self, function, call  # type: ignore[attr-defined]
        type_callable(call)(self._typer)
        lower_builtin(call, types.VarArg(types.Any))(self._emit)

    @functools.cached_property
    def from_kernels(self) -> Any:
        """numba's function without a way in from Python, which is a fifth of a compilation."""
        return self._jitted("from_kernels", no_cpython_wrapper=True)

    def _jitted(self, below: str | None, **options: bool) -> Any:
        """numba's function, whose machine code numba keeps in a folder below the cache folder, if
        there is one. That for arguments of users' classes is not kept: in the next process these
        may have other kernels, or not be there."""
        folder = cache_folder() if self._keep and below else None
        with _setting, contextlib.ExitStack() as after:
            after.callback(setattr, config, "CACHE_DIR", config.CACHE_DIR)
            config.CACHE_DIR = str(folder / below) if folder and below else ""
            dispatcher = numba.njit(**self._options, **options, cache=folder is not None)(
                self._function
            )
        compile = dispatcher.compile

        def compile_alone(kinds: tuple[types.Type, ...]) -> Any:
            if (
                folder
                and kinds not in dispatcher.overloads
                and not all(map(_has_no_class_of_users, kinds))
            ):
                of_user = self._jitted(None, **options)
                of_user.compile(kinds)
                dispatcher.add_overload(of_user.overloads[kinds])
            with _first_use() if folder else contextlib.nullcontext():
                entry_point = compile(kinds)
            if kinds not in dispatcher.overloads:
                raise RuntimeError(
                    f"machine code in {folder} is not what its name says: delete that folder"
                )
            return entry_point

        dispatcher.compile = compile_alone
        return dispatcher

    def compiled(self, kinds: tuple[types.Type, ...]) -> Any:
        """The compiled function for arguments of these types, as kernels call it."""
        if kinds not in self.from_kernels.overloads:
            self.from_kernels.compile(kinds)
        return self.from_kernels.overloads[kinds]

    def _typer(self, context: Any) -> Callable[..., types.Type]:
        def returned(*kinds: types.Type) -> types.Type:
            return types.none if self._is_phase else self.compiled(kinds).signature.return_type

        returned.__signature__ = inspect.signature(self._function)  # type: ignore[attr-defined]
        return returned

    def _emit(self, context: Any, builder: ir.IRBuilder, signature: Any, given: Any) -> Any:
        """Code of a call from a kernel: of a copy that is inlined, or at the address, which is
        found at the first call."""
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
    """Write the address of a kernel into a caller's word, or keep the error: the caller finds the
    word empty."""
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
    """Call the compiled function at an address, with arguments of these types; its errors are the
    caller's."""
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


@functools.cache
def cache_folder() -> Path | None:
    """The folder of this version's machine code: `<user's cache>/soft_tendon_env/<digest>`, created
    when missing; None: there is none."""
    made_from = sources_digest(*KERNEL_SOURCES), numba.__version__, config.OPT, config.BOUNDSCHECK
    name = hashlib.sha256(repr(made_from).encode()).hexdigest()[:16]
    known = data_folders(name)
    try:
        folder = new_data_folder(name)
    except OSError as error:
        say(f"{error.strerror}: every process compiles again")
        return None
    if folder not in known and known and not os.access(known[0], os.W_OK):
        shutil.copytree(
            known[0], folder, dirs_exist_ok=True
        )  # numba loads from folders alone that it can write
    os.utime(folder)
    versions = [path for path in folder.parent.iterdir() if re.fullmatch("[0-9a-f]{16}", path.name)]
    for outdated in sorted(versions, key=os.path.getmtime, reverse=True)[FOLDERS_KEPT:]:
        shutil.rmtree(outdated, ignore_errors=True)
    return folder


@contextlib.contextmanager
def _first_use() -> Iterator[None]:
    """Context in which a kernel is loaded, or compiled and saved; `_thread.outermost` ends with the
    outermost of a thread."""
    if hasattr(_thread, "outermost"):
        yield
        return
    with contextlib.ExitStack() as _thread.outermost:
        try:
            yield
        finally:
            del _thread.outermost


class FirstUse(event.Listener):
    """Told by numba where its cache does not have a function: has other processes and forks wait,
    and says so on stderr."""

    def on_start(self, event: Any) -> None:
        """Wait for other processes, once; who has waited finds in the cache what the function
        calls."""
        outermost = getattr(_thread, "outermost", None)
        if outermost is None:
            return
        _thread.outermost, folder = None, cache_folder()
        outermost.enter_context(_compiling)
        if not QUIET:
            say_once(f"compiling for first use (cached in {folder}; once per version)")
        if folder is not None:
            with contextlib.suppress(
                Timeout, OSError, NotImplementedError
            ):  # it was stopped, or the file system has no locks
                outermost.enter_context(
                    FileLock(folder / "compiling.lock", timeout=PATIENCE, thread_local=False)
                )

    def on_end(self, event: Any) -> None:
        """Hold the lock still: the machine code is yet to be saved."""


if not config.DISABLE_JIT:
    binding.add_symbol(FIND, ctypes.cast(_find, ctypes.c_void_p).value)
    event.register("numba:compile", FirstUse())
    if hasattr(
        os, "register_at_fork"
    ):  # a child would wait forever for a thread that compiled when it was forked
        os.register_at_fork(
            before=_compiling.acquire,
            after_in_parent=_compiling.release,
            after_in_child=_compiling.release,
        )
