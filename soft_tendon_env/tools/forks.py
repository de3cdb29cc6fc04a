"""Forks of a process that has other threads.

They wait until no other thread holds a lock that the child needs.

A child has the thread that forked, alone. What another thread had locked at that moment stays
locked in the child, which then waits forever, without a word. Of the locks that somebody who loads
an environment takes, Python mends none: those of modules that are being imported, those that are
registered with `hold_over_forks`, and those of cached properties.
"""

# These two, and logging with them, have handlers of forks of their own. Those that are registered
# before ours lock nothing while a fork waits for imports. Of those that are registered during that
# wait Python would call the second half alone.
import concurrent.futures.thread  # noqa: F401
import contextlib
import functools
import importlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

import filelock  # noqa: F401

LIBRARIES = (
    "soft_tendon_env",
    "annotated_types",
    "cloudpickle",
    "farama_notifications",
    "gymnasium",
    "joblib",
    "llvmlite",
    "numba",
    "numpy",
    "pydantic",
    "pydantic_core",
    "scipy",
    "threadpoolctl",
    "tqdm",
    "typing_extensions",
    "typing_inspection",
)
"""Packages whose imports end soon, as those of the standard library do. Others are not waited for:
the body of a user's module may be a whole training, which forks."""
PATIENCE = 60.0
"""Time [s] that a fork waits for imports: one that takes longer waits itself, perhaps for the
thread that forks."""
PAUSE = 0.005
"""Time [s] between two looks at the imports."""

Value = TypeVar("Value")


def cached_property(function: Callable[[Any], Value]) -> functools.cached_property[Value]:
    """Cached property without a lock: `functools.cached_property` of Python 3.12 on.

    A thread would hold the lock of Python 3.11 while it builds a model.
    """
    attribute = functools.cached_property(function)
    attribute.lock = contextlib.nullcontext()  # type: ignore[attr-defined, unused-ignore]
    return attribute


_locks: list[contextlib.AbstractContextManager[Any]] = []
_thread = threading.local()


def hold_over_forks(lock: contextlib.AbstractContextManager[Any]) -> None:
    """Registers a reentrant lock that a thread takes before it forks.

    Parent and child release it after. Locks are taken in the order in which they were registered.
    """
    _locks.append(lock)


def _imports_elsewhere() -> bool:
    """Whether another thread imports a module of one of the libraries."""
    # Python has no public list of them; a lock is in this table while its module is imported.
    references = dict(getattr(importlib._bootstrap, "_module_locks", {}))
    for name, reference in references.items():
        lock = reference()
        package = name.partition(".")[0]
        ends_soon = package in LIBRARIES or package in sys.stdlib_module_names
        if lock is None or not ends_soon:
            continue
        # The forking thread may import too, for which it never waits.
        if lock.owner != threading.get_ident():
            return True
    return False


def _take_locks() -> None:
    """Waits until the locks are this thread's and no other thread imports.

    An import may compile: while one goes on elsewhere, none of the locks is kept.
    """
    # The first call in a process holds a lock of its own; afterwards there is nothing to lock.
    with contextlib.suppress(OSError):
        tempfile.gettempdir()
    _thread.held = contextlib.ExitStack()
    deadline = time.monotonic() + PATIENCE
    while True:
        for lock in _locks:
            _thread.held.enter_context(lock)
        if not _imports_elsewhere() or time.monotonic() > deadline:
            return
        _thread.held.close()
        time.sleep(PAUSE)


def _release_locks() -> None:
    """Releases the locks, in the parent and in the child, whose thread owns them too."""
    _thread.held.close()


def register_fork_handlers() -> None:
    """Has this process fork between imports and compilations, where the system has forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(
            before=_take_locks, after_in_parent=_release_locks, after_in_child=_release_locks
        )
