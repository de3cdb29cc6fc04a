"""Sweeps: trainings of every configuration with several seeds, side by side in processes of their own.

Every run is a process of `soft-tendon train` in OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are done are not
repeated, and interrupted ones go on. A run that fails stops no other.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import Field, model_validator

from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, parsed_changes
from soft_tendon_env.tools.parallel import run_all

TRAIN = (sys.executable, "-m", "soft_tendon_env", "train")
TAIL = 15  # lines of a log
MOST_RUNS = 10_000


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
    seeds: int = Field(default=5, ge=1)
    first_seed: int = Field(default=0, ge=0)
    workers: int = Field(default=2, ge=1)
    cluster: str | None = None
    set: tuple[str, ...] = ()
    only_plot: bool = False

    @model_validator(mode="after")
    def _fits(self) -> "Sweep":
        problems = []
        if self.seeds * len(self.configs) > MOST_RUNS:
            problems.append(Problem(("seeds",), f"is {self.seeds}: that makes more than {MOST_RUNS} runs"))
        for path in self.configs:
            if self.names.count(Path(path).stem) > 1:
                text = f"has {path}: another configuration is called {Path(path).stem} too, and so would be its folder"
                problems.append(Problem(("configs",), text))
        if "seed" in parsed_changes(self.set):
            problems.append(Problem(("set",), "has seed: --seeds and --first-seed say which there are"))
        if problems:
            raise ConfigurationError(problems[:1])
        return self

    @property
    def names(self) -> list[str]:
        """Names of the configurations."""
        return [Path(config).stem for config in self.configs]

    @property
    def all_seeds(self) -> list[int]:
        """All seeds that each configuration is trained with."""
        return list(range(self.first_seed, self.first_seed + self.seeds))

    def tasks(self) -> list[str]:
        """Tasks of the configurations, with the first seed and the last. Raises ConfigurationError where they cannot be trained."""
        seeds = (self.all_seeds[0], self.all_seeds[-1])
        found = [read_training(find_config(config), self.set, seed=seed) for config in self.configs for seed in seeds]
        return list(dict.fromkeys(training.task for training in found))

    def jobs(self, out: Path) -> list["Job"]:
        """Runs, seed by seed, so that mistakes of any configuration show early, and all have come equally far."""
        configs, out = [find_config(config).absolute() for config in self.configs], out.absolute()
        return [Job(config, seed, out / config.stem / f"seed_{seed}", self.set) for seed in self.all_seeds for config in configs]


class Job(NamedTuple):
    """One run: a configuration with a seed, its folder, what is changed of the configuration. Paths are absolute."""

    config: Path
    seed: int
    folder: Path
    changes: tuple[str, ...]

    @property
    def log(self) -> Path:
        """File of what it prints."""
        return self.folder / "train.log"

    @property
    def command(self) -> list[str]:
        """Command line of the run."""
        changes = ["--set", *self.changes] if self.changes else []
        return [*TRAIN, str(self.config), "--seed", str(self.seed), "--out", str(self.folder), "--resume", *changes]


class Trainings:
    """Processes of trainings, which end with this one."""

    def __init__(self) -> None:
        self._children: list[subprocess.Popen[bytes]] = []
        self._stopped = False
        self._folder = os.getcwd()

    def run(self, job: Job) -> bool:
        """True if a run fails, once it has ended."""
        job.folder.mkdir(parents=True, exist_ok=True)
        if self._stopped:
            return True
        with open(job.log, "ab") as log:
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            child = subprocess.Popen(job.command, stdout=log, stderr=subprocess.STDOUT, env=environment, cwd=self._folder)
        self._children.append(child)
        return child.wait() != 0

    def stop(self) -> None:
        """Ends those that still run, by SIGTERM: Ctrl-C is ignored by what is started in the background."""
        self._stopped = True
        for child in self._children:
            child.terminate()
        for child in self._children:
            child.wait()


def train_all(jobs: Sequence[Job], workers: int, cluster: str | None = None) -> list[Job]:
    """Runs all, at most `workers` at once, and returns those that failed. What still runs when this is left, by Ctrl-C too, is stopped.

    Raises ValueError where the Ray cluster cannot be reached.
    """
    trainings = Trainings()
    try:
        failed = run_all(trainings.run, jobs, workers, "sweep", cluster=cluster, threads=True)
    finally:
        trainings.stop()
    return [job for job, has_failed in zip(jobs, failed, strict=True) if has_failed]


def tail(log: Path) -> str:
    """Last lines of a log."""
    return "\n".join(log.read_text(errors="replace").replace("\r", "\n").splitlines()[-TAIL:])
