"""How the package compiles its kernels: one decorator, one cache, one line on stderr.

numba's on-disk cache compares only the file that a function stands in, so it keeps a stale kernel when a kernel in
*another* file changes (numba issue 1833). The cache folder is therefore named after a digest of all sources that kernels
come from, and of everything else that decides which machine code is right.
"""

import atexit
import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, overload

import llvmlite
import llvmlite.binding
import numba
from numba.core import config
from numba.core import event as events
from numba.core.dispatcher import Dispatcher

Function = TypeVar("Function", bound=Callable[..., Any])

PACKAGE = Path(__file__).parent
KERNEL_SOURCES = ("compilation.py", "mechanics/**/*.py", "effects/**/*.py")  # all that a kernel of the package is made from
FOLDERS_KEPT = 3
SECONDS_BETWEEN_LINES = 5.0
NOTICEABLE = 1.0  # [s]; compilations shorter than this get no line of their own


@overload
def kernel(function: Function) -> Function: ...
@overload
def kernel(*, inline: bool = False) -> Callable[[Function], Function]: ...
def kernel(function: Callable[..., Any] | None = None, *, inline: bool = False) -> Any:
    """Compile a function of arrays and scalars on its first call: `@kernel`, or `@kernel(inline=True)`.

    inline: have LLVM inline it wherever it is called; for helpers of a few lines inside a sweep.
    With NUMBA_DISABLE_JIT=1 the function comes back as it is.
    """
    if function is None:
        return functools.partial(kernel, inline=inline)
    if config.DISABLE_JIT:
        return function
    # "contract" lets LLVM fuse multiply and add, and nothing that would hide a nan or reorder a sum.
    decorate = numba.njit(cache=True, error_model="numpy", fastmath={"contract"}, nogil=True, boundscheck=None, forceinline=inline)
    # numba reads CACHE_DIR here, when caching is enabled, and nowhere later: other packages' caches stay where they were.
    users_choice = config.CACHE_DIR
    config.CACHE_DIR = str(cache_folder())
    try:
        return decorate(function)
    finally:
        config.CACHE_DIR = users_choice


@functools.cache
def cache_folder() -> Path:
    """The folder of this version's machine code: `<user's cache>/soft_tendon_env/<digest>`, created when missing."""
    digest = source_digest(PACKAGE)
    for parent in cache_parents():
        try:
            return open_cache(parent / "soft_tendon_env", digest)
        except OSError:
            continue
    warnings.warn("no cache folder is writable, every process will compile again; set NUMBA_CACHE_DIR to a writable folder", stacklevel=2)
    folder = Path(tempfile.mkdtemp(prefix="soft_tendon_env-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def cache_parents() -> list[Path]:
    """Where the cache may lie, best first: what the user chose for numba, for all programs, or the usual place."""
    chosen = [config.CACHE_DIR, os.environ.get("XDG_CACHE_HOME"), os.path.expanduser("~/.cache")]
    return [Path(folder) for folder in chosen if folder]


def source_digest(package: Path) -> str:
    """16 hex digits that change with any of KERNEL_SOURCES in the package, with the compiler, its switches and the processor."""
    compiler = (numba.__version__, llvmlite.__version__, llvmlite.binding.get_host_cpu_name(), config.OPT, config.BOUNDSCHECK)
    digest = hashlib.sha256(repr(compiler).encode())
    for source in sorted(source for pattern in KERNEL_SOURCES for source in package.glob(pattern)):
        content = source.read_bytes()
        digest.update(f"{source.relative_to(package)} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


def open_cache(root: Path, digest: str) -> Path:
    """Create `root/digest` or mark it as used; on creation, drop all but the `FOLDERS_KEPT` used last. OSError: not writable."""
    folder = root / digest
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()  # a folder can exist and yet not be writable
    os.utime(folder)
    if is_new:
        with contextlib.suppress(OSError):  # another process may be dropping the same folders
            versions = [path for path in root.iterdir() if re.fullmatch("[0-9a-f]{16}", path.name)]
            for outdated in sorted(versions, key=lambda path: path.stat().st_mtime, reverse=True)[FOLDERS_KEPT:]:
                shutil.rmtree(outdated)
    return folder


class CompilationProgress(events.Listener):
    """Says on stderr that the package's kernels are being compiled, since that takes seconds; silent when they come from the cache.

    numba serialises compilation by a lock, so its events arrive nested: a kernel's compilation encloses its helpers'.
    Functions are counted one by one, seconds at the outermost only.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.functions = 0
        self.seconds = 0.0  # of the outermost compilations that have ended
        self.started = 0.0  # when the latest outermost one began
        self.spoke: float | None = None  # when the last line was printed

    def on_start(self, event: events.Event) -> None:
        if not is_ours(event):
            return
        if self.depth == 0:
            self.started = time.monotonic()
        self.depth += 1
        if self.spoke is None:
            self.say(f"compiling for first use (cached in {cache_folder()}; once per version)")

    def on_end(self, event: events.Event) -> None:
        if not is_ours(event):
            return
        self.depth -= 1
        self.functions += 1
        elapsed = time.monotonic() - self.started
        is_outermost = self.depth == 0
        if is_outermost and elapsed > NOTICEABLE or self.spoke is not None and time.monotonic() - self.spoke > SECONDS_BETWEEN_LINES:
            self.say(f"compiled {self.functions} functions, {self.seconds + elapsed:.1f} s")
        if is_outermost:
            self.seconds += elapsed

    def say(self, line: str) -> None:
        print(f"soft_tendon_env: {line}", file=sys.stderr, flush=True)
        self.spoke = time.monotonic()


def is_ours(compilation: events.Event) -> bool:
    """Whether a `numba:compile` event is about one of our kernels: its machine code goes to our folder."""
    dispatcher = compilation.data["dispatcher"]
    path = dispatcher.stats.cache_path if isinstance(dispatcher, Dispatcher) else None
    return path is not None and Path(path).is_relative_to(cache_folder())


if not config.DISABLE_JIT and os.environ.get("SOFT_TENDON_ENV_QUIET", "0") in ("", "0"):
    events.register("numba:compile", CompilationProgress())
