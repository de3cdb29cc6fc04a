"""Independent runs side by side, by joblib: in processes of this machine, or on a Ray cluster.

Cells of an experiment, trainings of a sweep, trials of a search and motions of a calibration all go through `run_all`.
"""

import contextlib
import functools
import os
import runpy
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from soft_tendon_env.tools.extensions import extensions, import_extensions
from soft_tendon_env.tools.messages import QUIET, first_line

Run = TypeVar("Run")
Result = TypeVar("Result")
CONNECTING = 10.0
"""Time [s] in which a cluster should answer."""


def run_all(
    call: Callable[[Run], Result],
    runs: Sequence[Run],
    workers: int,
    label: str,
    *,
    unit: str = "run",
    cluster: str | None = None,
    threads: bool = False,
    done: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """Results of `call` for every run, in their order.

    Args:
        call: a function of a module, as other processes have to find it, of values that can be pickled.
        workers: processes of one thread each; 1: this process alone.
        label, unit: of the progress bar, which SOFT_TENDON_ENV_QUIET=1 leaves out.
        cluster: address of a Ray cluster, or "auto" for the one that this machine belongs to; None: this machine alone.
        threads: threads of this process in place of processes of this machine, for calls that spend their time in kernels or wait.
        done: is told in this process of every result as soon as it is there, with its run's place.

    Raises what `call` raises, and stops the other runs then, as on Ctrl-C; ValueError where a cluster cannot be reached.
    """
    import joblib
    from tqdm import tqdm  # not for everyone who imports an environment

    placed, results = _Placed(call), dict[int, Result]()
    progress = tqdm(total=len(runs), desc=label, unit=unit, leave=False, disable=QUIET)
    with progress as bar, _backend(min(workers, len(runs)), cluster, threads):
        found = joblib.Parallel(batch_size=1, return_as="generator_unordered")(joblib.delayed(placed)(*item) for item in enumerate(runs))
        with contextlib.closing(found):
            for place, result in found:
                results[place] = result
                if done is not None:
                    done(place, result)
                bar.update()
    return [results[place] for place in range(len(runs))]


class _Placed(Generic[Run, Result]):
    """A call that says which run its result is of. In another process what --import names and the script that was started come first, as
    multiprocessing's spawn has it, so that what they register is there: a script should have an `if __name__ == "__main__"`."""

    def __init__(self, call: Callable[[Run], Result]) -> None:
        main = sys.modules["__main__"]
        is_script = getattr(main, "__spec__", None) is None and hasattr(main, "__file__")
        self._call, self._process, self._names = call, os.getpid(), extensions()
        self._script = os.path.abspath(str(main.__file__)) if is_script else ""

    def __call__(self, place: int, run: Run) -> tuple[int, Result]:
        """The run's place, and its result."""
        if os.getpid() != self._process:
            _prepare(self._script, *self._names)
        return place, self._call(run)


@functools.cache
def _prepare(script: str, *names: str) -> None:
    """Run a script and import modules, once in this process."""
    import_extensions(names)
    if os.path.isfile(script):
        runpy.run_path(script, run_name="__mp_main__")


@contextmanager
def _backend(workers: int, cluster: str | None, threads: bool) -> Iterator[None]:
    """joblib's backend while runs go on."""
    import joblib

    with contextlib.ExitStack() as stack:
        kind, options = ("threading", {}) if workers <= 1 or threads else ("loky", {"inner_max_num_threads": 1})
        if cluster is not None:
            stack.enter_context(ray_cluster(cluster, workers, "runs side by side"))
            from ray.util.joblib.ray_backend import RayBackend

            class Backend(RayBackend):  # type: ignore[misc, unused-ignore] # Any without Ray
                supports_return_generator = True  # Ray's results come one by one; joblib's own processes rule that out

            joblib.register_parallel_backend("ray", Backend)
            kind, options = "ray", {}
        stack.enter_context(joblib.parallel_config(kind, n_jobs=max(workers, 1), **options))
        yield


@contextmanager
def ray_cluster(address: str | None, processors: int, what: str) -> Iterator[None]:
    """Ray while it is used: the cluster at an address, "auto" for this machine's, or one of this process's own, which ends with it.

    processors: that are needed by `what`, which errors name. Raises ValueError where there is no Ray, or too little room.
    """
    try:
        import ray
    except ImportError as error:
        raise ValueError('needs Ray: pip install "soft_tendon_env[rllib]"') from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    own: dict[str, Any] = {} if address else {"num_cpus": max(processors, os.cpu_count() or 1), "include_dashboard": False}
    on_kill = signal.getsignal(signal.SIGTERM)
    try:
        if address is not None and ":" in address:  # Ray itself tries for minutes
            host, _, port = address.removeprefix("ray://").rpartition(":")
            socket.create_connection((host, int(port)), timeout=CONNECTING).close()
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ValueError(f"Ray cannot be reached at {address or 'this machine'}: {first_line(error)}") from error
    try:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, on_kill)  # which Ray has made its own
        if (there := int(ray.cluster_resources().get("CPU", 0))) < processors:
            raise ValueError(f"{what} need {processors} processors, the cluster has {there}")
        yield
    finally:
        ray.shutdown()


def check_cluster(address: str | None) -> None:
    """Raises ValueError unless a cluster can be reached; None: there is none to reach."""
    if address is not None:
        with ray_cluster(address, 1, "runs side by side"):
            pass


def processors() -> int:
    """Number of threads that this process may run at a time."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
