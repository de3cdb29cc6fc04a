"""Independent runs side by side, by joblib: in processes of this machine, or on a Ray cluster.

Cells of an experiment, trainings of a sweep, trials of a search and motions of a calibration all go through `run_all`.
"""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from tqdm import tqdm

from soft_tendon_env.tools.messages import QUIET, first_line

Run = TypeVar("Run")
Result = TypeVar("Result")


def run_all(
    call: Callable[[Run], Result],
    runs: Sequence[Run],
    workers: int,
    label: str,
    *,
    unit: str = "run",
    cluster: str | None = None,
    threads: bool = False,
) -> list[Result]:
    """Results of `call` for every run, in their order.

    Args:
        call: a function of a module, as other processes have to find it, of values that can be pickled.
        workers: processes of one thread each; 1: this process alone.
        label, unit: of the progress bar, which SOFT_TENDON_ENV_QUIET=1 leaves out.
        cluster: address of a Ray cluster, or "auto" for the one that this machine belongs to; None: this machine alone.
        threads: threads of this process in place of processes of this machine, for calls that spend their time in kernels or wait.

    Raises what `call` raises, and stops the other runs then, as on Ctrl-C; ValueError where a cluster cannot be reached.
    """
    import joblib

    class Parallel(joblib.Parallel):
        """joblib's own with a progress bar: Ray's backend has no results one by one."""

        def print_progress(self) -> None:
            bar.update(self.n_completed_tasks - bar.n)

    progress = tqdm(total=len(runs), desc=label, unit=unit, leave=False, disable=QUIET)
    with progress as bar, _backend(min(workers, len(runs)), cluster, threads):
        return list(Parallel(batch_size=1)(joblib.delayed(call)(run) for run in runs))


@contextmanager
def _backend(workers: int, cluster: str | None, threads: bool) -> Iterator[None]:
    """joblib's backend while runs go on."""
    import joblib

    if cluster is not None:
        with ray_cluster(cluster, workers, "runs side by side"):
            from ray.util.joblib import register_ray

            register_ray()
            with joblib.parallel_config("ray", n_jobs=max(workers, 1)):
                yield
    elif workers <= 1 or threads:
        with joblib.parallel_config("threading", n_jobs=max(workers, 1)):
            yield
    else:
        with joblib.parallel_config("loky", n_jobs=workers, inner_max_num_threads=1):
            yield


@contextmanager
def ray_cluster(address: str | None, processors: int, what: str) -> Iterator[None]:
    """Ray while it is used: a cluster that is there, or one of this process's own, which ends with it.

    Args:
        address: of a cluster, "auto" for the one that this machine belongs to; None: one of its own, on this machine.
        processors: that are needed.
        what: takes them, named in errors.

    Raises ValueError where there is no Ray, or too little room.
    """
    try:
        import ray
    except ImportError as error:
        raise ValueError('needs Ray: pip install "soft_tendon_env[rllib]"') from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    logging.getLogger("ray").setLevel(logging.ERROR)
    own: dict[str, Any] = {} if address else {"num_cpus": max(processors, os.cpu_count() or 1), "include_dashboard": False}
    on_kill = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ValueError(f"Ray cannot be reached at {address or 'this machine'}: {first_line(error)}") from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_kill)  # which Ray has made its own
    try:
        if (there := int(ray.cluster_resources().get("CPU", 0))) < processors:
            raise ValueError(f"{what} need {processors} processors, the cluster has {there}")
        yield
    finally:
        ray.shutdown()


def processors() -> int:
    """Number of threads that this process may run at a time."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
