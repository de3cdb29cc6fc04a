"""Independent runs side by side: in processes of this machine, or on a Ray cluster.

joblib starts the processes.

Cells of an experiment, trainings of a sweep, trials of a search and motions of a reference all go
through `run_all`. In each process come first the user's own modules that register effects, tasks,
controllers, metrics.
"""

import contextlib
import itertools
import os
import runpy
import socket
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from soft_tendon_env.tools.extensions import import_modules, imported_modules
from soft_tendon_env.tools.messages import first_line

Run = TypeVar("Run")
Result = TypeVar("Result")
CONNECTING = 10.0
"""Time [s] in which a cluster should answer."""


def run_all(
    call: Callable[[Run], Result],
    runs: Sequence[Run],
    workers: int,
    label: str | None,
    *,
    unit: str = "run",
    cluster: str | None = None,
    threads: bool = False,
    done: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """Runs a function side by side and returns its results in the order of the runs.

    Args:
        call: a function of a module, as other processes have to find it, of values that can be
            pickled.
        runs: arguments of the function, one for each run.
        workers: processes of one thread each, which first import what --import names, and run the
            script that was started, for what it registers (but not below its `if __name__ ==
            "__main__"`); 1: this process alone, with one thread too.
        label: of the progress bar, which SOFT_TENDON_ENV_QUIET=1 leaves out, as does the label
            None.
        unit: name of a run in the progress bar.
        cluster: address of a Ray cluster, or "auto" for the one that this machine belongs to; None:
            this machine alone.
        threads: threads of this process in place of processes of this machine, for calls that spend
            their time in kernels or wait.
        done: is told in this process of every result as soon as it is there, with its run's place.

    Returns:
        The results.

    Raises:
        ValueError: where a cluster cannot be reached. What `call` raises stops the other runs, as
            does Ctrl-C, and goes on to the caller.
    """
    # tqdm is not for everyone who imports an environment
    from soft_tendon_env.tools.progress import progress_bar

    workers = max(min(workers, len(runs)), 1)
    origin = os.getpid(), imported_modules(), _script()
    jobs = [(call, origin, place, run) for place, run in enumerate(runs)]
    if cluster is None:
        places_and_results = _on_this_machine(jobs, workers, threads)
    else:
        places_and_results = _on_cluster(jobs, workers, cluster)

    results = dict[int, Result]()
    with (
        progress_bar(len(runs), label, unit) as bar,
        # Also where `done` raises: what still runs ends with the generator.
        contextlib.closing(places_and_results),
    ):
        for place, result in places_and_results:
            results[place] = result
            if done is not None:
                done(place, result)
            bar.update()
    return [results[place] for place in range(len(runs))]


def _script() -> Path | None:
    """The script that this process was started with; None: a module (`python -m`), or no file."""
    main = sys.modules["__main__"]
    has_spec = getattr(main, "__spec__", None) is not None
    if has_spec or not hasattr(main, "__file__"):
        return None
    return Path(str(main.__file__)).absolute()


def _run(
    call: Callable[[Run], Result],
    origin: tuple[int, tuple[str, ...], Path | None],
    place: int,
    run: Run,
) -> tuple[int, Result]:
    """Place and result of a run.

    Its process has what a user's own modules and script register.
    """
    process, names, script = origin
    if os.getpid() != process:
        import_modules(names)
        # A worker takes many runs: the script registers what it has once.
        if script is not None and script.is_file() and script not in _SCRIPTS:
            _SCRIPTS.add(script)
            # Under the name that multiprocessing gives to it, so that it starts no runs itself.
            runpy.run_path(str(script), run_name="__mp_main__")
    return place, call(run)


_SCRIPTS = set[Path]()
"""Scripts that were run in this process."""


def _on_this_machine(
    jobs: Sequence[tuple[Any, ...]], workers: int, threads: bool
) -> Generator[tuple[int, Any], None, None]:
    """Results of `_run`, each with its place, as they come.

    Linear algebra has one thread, here too: sums of several have other digits.
    """
    import joblib
    from threadpoolctl import threadpool_limits

    options: dict[str, Any] = {"backend": "threading", "n_jobs": workers}
    if workers > 1 and not threads:
        options |= {"backend": "loky", "inner_max_num_threads": 1}
    tasks = [joblib.delayed(_run)(*job) for job in jobs]
    with threadpool_limits(1), joblib.parallel_config(**options):
        # Runs differ in length, so a worker takes one at a time.
        parallel = joblib.Parallel(batch_size=1, return_as="generator_unordered")
        yield from parallel(tasks)


def _on_cluster(
    jobs: Sequence[tuple[Any, ...]], workers: int, cluster: str
) -> Generator[tuple[int, Any], None, None]:
    """Results of `_run`, each with its place, as they come.

    The end of the connection to Ray stops those that still run.
    """
    with ray_cluster(cluster, workers, "runs side by side"):
        import ray

        task = ray.remote(num_cpus=1)(_run)
        waiting = iter(jobs)
        first = itertools.islice(waiting, workers)
        running = [task.remote(*job) for job in first]
        while running:
            # One ends, the next begins: as many run as there are workers.
            (ready,), running = ray.wait(running)
            next_jobs = itertools.islice(waiting, 1)
            running += [task.remote(*job) for job in next_jobs]
            try:
                place_and_result = ray.get(ready)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            yield place_and_result


@contextlib.contextmanager
def ray_cluster(address: str | None, processors: int, what: str) -> Iterator[None]:
    """Ray while it is used: the cluster at an address, or one of this process's own.

    The address "auto" is this machine's; a cluster of its own ends with it.

    processors: that are needed by `what`, which errors name. Raises ValueError where there is no
    Ray, or too little room.
    """
    try:
        import ray
    except ImportError as error:
        raise ValueError('needs Ray: pip install "soft_tendon_env[rllib]"') from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if not address:
        cores = max(processors, os.cpu_count() or 1)
        options |= {"num_cpus": cores, "include_dashboard": False}
    try:
        if address is not None and ":" in address:  # Ray itself tries for minutes
            host, _, port = address.removeprefix("ray://").rpartition(":")
            connection = socket.create_connection((host, int(port)), timeout=CONNECTING)
            connection.close()
        ray.init(address or "local", **options)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ValueError(
            f"Ray cannot be reached at {address or 'this machine'}: {first_line(error)}"
        ) from error
    try:
        available = int(ray.cluster_resources().get("CPU", 0))
        if available < processors:  # runs would wait for ever
            raise ValueError(f"{what} need {processors} processors, the cluster has {available}")
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
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
