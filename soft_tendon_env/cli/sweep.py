"""`soft-tendon sweep`: trainings with several seeds, and their learning curves put together."""

import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from pydantic import Field
from tyro.conf import Positional

from soft_tendon_env.cli.errors import mistakes, require, writable_folder
from soft_tendon_env.learning import sweep
from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.parallel import run_all


class Sweep(Configuration):
    """Train every configuration with several seeds, and draw and print their learning curves.

    Runs that are done are not repeated.

    Attributes:
        configs: names of trainings that ship, or paths of TOML files.
        seeds: number of seeds of each configuration, from 0 on.
        workers: runs side by side.
        cluster: address of a Ray cluster that runs them, or "auto" for the one of this machine,
            whose machines all see the folder.
        set: overrides the files in all runs, dotted keys with values as in TOML, as for train.
        only_plot: train nothing, show all seeds that are there.
        out: folder of the runs, OUT/CONFIG/seed_N; OUT/CONFIG is a policy for compare.
    """

    configs: Positional[tuple[str, ...]] = Field(min_length=1)
    seeds: int = Field(default=5, ge=1, le=1000)
    workers: int = Field(default=2, ge=1)
    cluster: str | None = None
    set: tuple[str, ...] = ()
    only_plot: bool = False
    out: str = "out/runs"

    @property
    def folders(self) -> list[Path]:
        """Folders of the configurations' runs.

        Raises ConfigurationError where two would share one.
        """
        out = Path(self.out).absolute()
        folders = [out / Path(config).stem for config in self.configs]
        for folder in folders:
            if folders.count(folder) > 1:
                text = f"has two files {folder.name}.toml, whose runs would share a folder"
                raise ConfigurationError([Problem(("configs",), text)])
        return folders

    def jobs(self) -> list[sweep.Job]:
        """Returns the runs, seed by seed, so that all have come equally far.

        Returns:
            Runs with their folders.

        Raises:
            ConfigurationError: where one cannot be trained.
        """
        folders = self.folders
        files = [find_config(config) for config in self.configs]
        jobs = []
        for seed in range(self.seeds):
            for file, folder in zip(files, folders, strict=True):
                training = read_training(file, self.set, seed=seed)
                job = sweep.Job(training, folder / f"seed_{seed}")
                jobs.append(job)
        return jobs


def run(settings: Sweep) -> None:
    """Train, print and draw. Exit status 1 where a run failed."""
    with mistakes():
        extras = ["agents", "pictures"]
        if settings.cluster:
            extras.append("rllib")
        require(*extras)
        if settings.only_plot:
            jobs = []
        else:
            jobs = settings.jobs()
        writable_folder(Path(settings.out))
        from soft_tendon_env.learning.curves import show_curves

        errors = []
        if jobs:  # without any, no cluster is needed
            with killed_as_interrupted():
                errors = run_all(
                    sweep.run_job, jobs, settings.workers, "sweep", cluster=settings.cluster
                )
        is_shown = show_curves(settings.folders)
    has_failed = False
    for job, error in zip(jobs, errors, strict=True):
        if error is not None:
            has_failed = True
            print(f"\nfailed: {job.folder}\n{error}", file=sys.stderr)
    if has_failed or not is_shown:
        sys.exit(1)


@contextlib.contextmanager
def killed_as_interrupted() -> Iterator[None]:
    """Has `kill` raise KeyboardInterrupt, as Ctrl-C does, so that the runs are stopped too."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
