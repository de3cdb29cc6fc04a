"""Sweeps: trainings of every configuration with several seeds, side by side in processes, or on a Ray cluster.

Every run has its folder OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are done are not repeated, and interrupted
ones go on. A run that fails stops no other.
"""

import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from pydantic import Field, model_validator

from soft_tendon_env.learning.config import Training, find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, parsed_changes
from soft_tendon_env.tools.parallel import run_all


class Sweep(Configuration):
    """Trainings of a sweep: every configuration with every seed.

    Attributes:
        configs: names of trainings that ship, or paths of TOML files.
        seeds: number of seeds of each configuration.
        first_seed: first of these seeds, which the others follow.
        workers: runs side by side.
        cluster: address of a Ray cluster that runs them, or "auto" for the one of this machine, whose machines all see the folder.
        set: overrides the files in all runs, dotted keys with values as in TOML, as for train.
        only_plot: train nothing, show all seeds that are there.
    """

    configs: tuple[str, ...] = Field(min_length=1)
    seeds: int = Field(default=5, ge=1, le=1000)
    first_seed: int = Field(default=0, ge=0)
    workers: int = Field(default=2, ge=1)
    cluster: str | None = None
    set: tuple[str, ...] = ()
    only_plot: bool = False

    @model_validator(mode="after")
    def _fits(self) -> "Sweep":
        for name in self.names:
            if self.names.count(name) > 1:
                text = f"has two files {name}.toml: another configuration is called {name} too, and so would be its folder"
                raise ConfigurationError([Problem(("configs",), text)])
        if "seed" in parsed_changes(self.set):
            raise ConfigurationError([Problem(("set",), "has seed: --seeds and --first-seed say which there are")])
        return self

    @property
    def names(self) -> list[str]:
        """Names of the configurations."""
        return [Path(config).stem for config in self.configs]

    @property
    def all_seeds(self) -> list[int]:
        """All seeds that each configuration is trained with."""
        return list(range(self.first_seed, self.first_seed + self.seeds))

    def jobs(self, out: Path) -> list["Job"]:
        """Runs, seed by seed, so that all have come equally far. Raises ConfigurationError where one cannot be trained."""
        files = [find_config(config) for config in self.configs]
        pairs = ((file, read_training(file, self.set, seed=seed)) for seed in self.all_seeds for file in files)
        return [Job(training, out.absolute() / file.stem / f"seed_{training.seed}") for file, training in pairs]


class Job(NamedTuple):
    """One run: a training, and its folder."""

    training: Training
    folder: Path


def run_job(job: Job) -> str | None:
    """Error of a run that has failed, once it has ended; what it prints goes into train.log of its folder."""
    from soft_tendon_env.learning import train

    job.folder.mkdir(parents=True, exist_ok=True)
    with open(job.folder / "train.log", "a") as log, redirect_stdout(log), redirect_stderr(log):
        try:
            train.train(job.training, job.folder, train.checkpoint_to_resume(job.folder, job.training, resume=True))
        except Exception:
            return traceback.format_exc()
    return None


def train_all(jobs: Sequence[Job], workers: int, cluster: str | None = None) -> dict[Path, str]:
    """Runs all, at most `workers` at once, and returns the errors of those that failed by folder. What still runs when this is left, by
    Ctrl-C too, is stopped. Raises ValueError where the Ray cluster cannot be reached."""
    errors = run_all(run_job, jobs, workers, "sweep", cluster=cluster)
    return {job.folder: error for job, error in zip(jobs, errors, strict=True) if error is not None}
