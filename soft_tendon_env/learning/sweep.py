"""Sweeps: trainings of every configuration with several seeds, side by side.

They are in processes, or on a Ray cluster.

Every run has its folder OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are
done are not repeated, and interrupted ones go on. A run that fails stops no other.
"""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from pydantic import Field

from soft_tendon_env.learning.config import Training, find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem


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

    configs: tuple[str, ...] = Field(min_length=1)
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

    def jobs(self) -> list["Job"]:
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
                jobs.append(Job(training, folder / f"seed_{seed}"))
        return jobs


class Job(NamedTuple):
    """One run: a training, and its folder."""

    training: Training
    folder: Path


@contextmanager
def into_log(path: Path) -> Iterator[None]:
    """Append what is printed meanwhile to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "a") as log, redirect_stdout(log), redirect_stderr(log):
        yield


def run_job(job: Job) -> str | None:
    """Error of a run that has failed, once it has ended."""
    from soft_tendon_env.learning import train

    with into_log(job.folder / "train.log"):
        try:
            checkpoint = train.checkpoint_to_resume(job.folder, job.training, resume=True)
            train.train(job.training, job.folder, checkpoint)
        except Exception:
            return traceback.format_exc()
    return None
