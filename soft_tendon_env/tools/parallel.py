"""Independent runs side by side: in processes of this machine, by joblib, or as tasks of a Ray
cluster.

Cells of an experiment, trainings of a sweep, trials of a search and motions of a reference all go
through `run_all`. In each process come first the user's own modules that register effects, tasks,
controllers, metrics.
"""

import contextlib
import importlib
import itertools
import os
import runpy
import socket
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from soft_tendon_env.tools.messages import QUIET, describe, first_line

Run = TypeVar("Run")
Result = TypeVar("Result")
CONNECTING = 10.0  # time [s] in which a cluster should answer
# names of the user's modules, with commas between: processes that are started inherit it
VARIABLE = "SOFT_TENDON_ENV_IMPORT"


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
    """Results of `call` for every run, in their order.

    Args:
        call: a function of a module, as other processes have to find it, of values that can be
            pickled.
        workers: processes of one thread each, which first import what --import names, and run the
            script that was started, for what it registers (but not below its
            `if __name__ == "__main__"`); 1: this process alone, with one thread too.
        label, unit: of the progress bar, which SOFT_TENDON_ENV_QUIET=1 leaves out, as does the
            label None.
        cluster: address of a Ray cluster, or "auto" for the one that this machine belongs to; None:
            this machine alone.
        threads: threads of this process in place of processes of this machine, for calls that spend
            their time in kernels or wait.
        done: is told in this process of every result as soon as it is there, with its run's place.

    Raises what `call` raises, and stops the other runs then, as on Ctrl-C; ValueError where a
    cluster cannot be reached.
    """
    from tqdm import tqdm  # not for everyone who imports an environment

    results, workers, main = (
        dict[int, Result](),
        max(min(workers, len(runs)), 1),
        sys.modules["__main__"],
    )
    script = (
        Path(str(main.__file__)).absolute()
        if getattr(main, "__spec__", None) is None and hasattr(main, "__file__")
        else None
    )
    origin = os.getpid(), os.environ.get(VARIABLE, ""), script
    jobs = [(call, origin, place, run) for place, run in enumerate(runs)]
    found = (
        _on_this_machine(jobs, workers, threads)
        if cluster is None
        else _on_cluster(jobs, workers, cluster)
    )
    is_hidden = QUIET or label is None
    with (
        tqdm(total=len(runs), desc=label, unit=unit, leave=False, disable=is_hidden) as bar,
        contextlib.closing(found),
    ):
        for place, result in found:
            results[place] = result
            if done is not None:
                done(place, result)
            bar.update()
    return [results[place] for place in range(len(runs))]


def _run(
    call: Callable[[Run], Result], origin: tuple[int, str, Path | None], place: int, run: Run
) -> tuple[int, Result]:
    """The run's place and its result, in a process that has what a user's own modules and script
    register."""
    process, names, script = origin
    if os.getpid() != process:
        import_extensions(names.split(","))
        if script is not None and script.is_file() and script not in _SCRIPTS:
            _SCRIPTS.add(script)
            runpy.run_path(str(script), run_name="__mp_main__")
    return place, call(run)


_SCRIPTS = set[Path]()  # that were run in this process


def _on_this_machine(
    jobs: Sequence[tuple[Any, ...]], workers: int, threads: bool
) -> Generator[tuple[int, Any], None, None]:
    """Results of `_run`, each with its place, as they come. Linear algebra has one thread, here
    too: sums of several have other digits."""
    import joblib
    from threadpoolctl import threadpool_limits

    kind, options = (
        ("threading", {}) if workers == 1 or threads else ("loky", {"inner_max_num_threads": 1})
    )
    with threadpool_limits(1), joblib.parallel_config(kind, n_jobs=workers, **options):
        yield from joblib.Parallel(batch_size=1, return_as="generator_unordered")(
            joblib.delayed(_run)(*job) for job in jobs
        )


def _on_cluster(
    jobs: Sequence[tuple[Any, ...]], workers: int, cluster: str
) -> Generator[tuple[int, Any], None, None]:
    """Results of `_run`, each with its place, as they come. The end of the connection to Ray stops
    those that still run."""
    with ray_cluster(cluster, workers, "runs side by side"):
        import ray

        task, waiting = ray.remote(num_cpus=1)(_run), iter(jobs)
        running = [task.remote(*job) for job in itertools.islice(waiting, workers)]
        while running:
            (ready,), running = ray.wait(running)
            running += [task.remote(*job) for job in itertools.islice(waiting, 1)]
            try:
                found = ray.get(ready)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            yield found


@contextlib.contextmanager
def ray_cluster(address: str | None, processors: int, what: str) -> Iterator[None]:
    """Ray while it is used: the cluster at an address, "auto" for this machine's, or one of this
    process's own, which ends with it.

    processors: that are needed by `what`, which errors name. Raises ValueError where there is no
    Ray, or too little room.
    """
    try:
        import ray
    except ImportError as error:
        raise ValueError('needs Ray: pip install "soft_tendon_env[rllib]"') from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would report to its makers
    own: dict[str, Any] = (
        {}
        if address
        else {"num_cpus": max(processors, os.cpu_count() or 1), "include_dashboard": False}
    )
    try:
        if address is not None and ":" in address:  # Ray itself tries for minutes
            host, _, port = address.removeprefix("ray://").rpartition(":")
            socket.create_connection((host, int(port)), timeout=CONNECTING).close()
        ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        raise ValueError(
            f"Ray cannot be reached at {address or 'this machine'}: {first_line(error)}"
        ) from error
    try:
        if (
            there := int(ray.cluster_resources().get("CPU", 0))
        ) < processors:  # runs would wait for ever
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


def import_extensions(names: Iterable[str] = ()) -> None:
    """Import modules of these names, and those that VARIABLE names; the current folder is looked in
    too. Raises ValueError."""
    every = [
        name for name in dict.fromkeys([*os.environ.get(VARIABLE, "").split(","), *names]) if name
    ]
    for name in every:
        look_in_this_folder()
        try:
            importlib.import_module(name)
        except ImportError as error:
            where = "it should be a module, in this folder or on PYTHONPATH"
            raise ValueError(f"--import names {name!r}: {where}; {describe(error)}") from error
    if every:
        os.environ[VARIABLE] = ",".join(every)


def look_in_this_folder() -> None:
    """Lets modules of the current folder be imported, after all others: scripts that pip installs
    do not see it."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
