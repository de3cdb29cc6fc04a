"""Threads of NumPy's linear algebra (BLAS), as many as the machine has cores unless it is told."""

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import LibController, ThreadpoolController

from soft_tendon_env.tools.forks import hold_over_forks

_lock = threading.RLock()
hold_over_forks(_lock)


@functools.cache
def _libraries() -> list[LibController]:
    """Libraries of linear algebra that this process has loaded and whose threads can be set."""
    # looking for them takes some 10 ms
    controller = ThreadpoolController().select(user_api="blas")
    return [library for library in controller.lib_controllers if library.get_num_threads()]


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which products of matrices have one thread, in all threads of this process.

    Products that take microseconds wait for their threads on a machine with other work, and their
    sums have other digits with each number of them. Entering and leaving costs some 10 us, an
    eighth of `threadpoolctl.threadpool_limits`, which asks libraries for more. Of several threads
    that are in it, the first sets the number and restores it when it leaves.
    """
    if not _lock.acquire(blocking=False):
        yield  # another thread has set it
        return
    try:
        libraries = _libraries()
        counts = [library.get_num_threads() for library in libraries]
        for library in libraries:
            library.set_num_threads(1)
        try:
            yield
        finally:
            for library, count in zip(libraries, counts, strict=True):
                library.set_num_threads(count)
    finally:
        _lock.release()
