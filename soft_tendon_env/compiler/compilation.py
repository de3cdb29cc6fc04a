"""How the package compiles its kernels: one decorator.

Machine code is linked and kept by `linking` and `kernel_cache`, on versions of numba that they were tested with. On others kernels are
compiled by `numba.njit` alone, which takes longer, and numba's own cache keeps those whose code is in the cache's digest.
"""

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import config

from soft_tendon_env.compiler.cache_folder import PACKAGE, cache_folder, kernel_sources
from soft_tendon_env.compiler.numba_internals import IS_TESTED, TESTED
from soft_tendon_env.tools.messages import say_unless_quiet

if IS_TESTED:
    from soft_tendon_env.compiler.compilation_progress import show_progress
    from soft_tendon_env.compiler.kernel_cache import keep_machine_code
    from soft_tendon_env.compiler.linking import is_of_package
    from soft_tendon_env.compiler.numba_internals import quick_options

Function = TypeVar("Function", bound=Callable[..., Any])


@overload
def kernel(function: Function) -> Function: ...
@overload
def kernel(*, inline: bool = False, counted: bool | None = None, by_type: bool = False) -> Callable[[Function], Function]: ...
def kernel(
    function: Callable[..., Any] | None = None, *, inline: bool = False, counted: bool | None = None, by_type: bool = False
) -> Any:
    """Compile a function of arrays and scalars on its first call: `@kernel`, or `@kernel(inline=True)`.

    inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a sweep. Other kernels are called, see linking.
    counted: count references to arrays, without which numba refuses what makes arrays or returns parts of them, and with which there is
    a third more to compile; by default not in this package.
    by_type: what it does depends on classes among its arguments, see `selects_code`; numba's own cache would not notice their changes.
    With NUMBA_DISABLE_JIT=1 the function comes back as it is.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, counted=counted, by_type=by_type)
    if config.DISABLE_JIT:
        return function
    # "contract" lets LLVM fuse multiply and add, and nothing that would hide a nan or reorder a sum.
    options: dict[str, Any] = dict(error_model="numpy", fastmath={"contract"}, nogil=True, boundscheck=None, forceinline=inline)
    if not IS_TESTED:
        with _numba_cache() as is_there:
            return numba.njit(**options, cache=is_there and not by_type and _is_in_digest(function))(function)
    dispatcher = numba.njit(**options, **quick_options(not is_of_package(function) if counted is None else counted))(function)
    keep_machine_code(dispatcher, inline)
    return dispatcher


@contextlib.contextmanager
def _numba_cache() -> Iterator[bool]:
    """Context in which numba keeps machine code in the folder of this version of the sources; whether there is one."""
    folder, before = cache_folder(), config.CACHE_DIR
    config.CACHE_DIR = str(folder or before)
    try:
        yield folder is not None
    finally:
        config.CACHE_DIR = before


def _is_in_digest(function: Callable[..., Any]) -> bool:
    """Whether the cache folder changes with a function and all that it calls: what is of the mechanics."""
    return Path(inspect.getfile(function)) in _digested()


@functools.cache
def _digested() -> frozenset[Path]:
    return frozenset(kernel_sources(PACKAGE))


if config.DISABLE_JIT:
    pass
elif IS_TESTED:
    show_progress()
else:
    say_unless_quiet(
        f"numba {numba.__version__} is used without what was tested with numba {TESTED} alone: kernels take several times as long to "
        "compile, and compute the same up to round-off"
    )
