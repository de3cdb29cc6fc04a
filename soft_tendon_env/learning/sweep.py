"""Sweep: trainings of every configuration with several seeds, side by side in processes of their own.

Every run is a process of `soft-tendon train` in OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are done are not
repeated, and interrupted ones go on. A run that fails stops no other.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import Field, model_validator
from tqdm import tqdm

from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, parsed_change

TRAIN = (sys.executable, "-m", "soft_tendon_env", "train")
POLL = 0.2  # [s] between looks at what has ended
TAIL = 15  # lines of a log
MOST_RUNS = 10_000


class Sweep(Configuration):
    """Which trainings a sweep has.

    Attributes:
        configs: names of trainings that ship, or paths of TOML files.
        seeds: how many of each.
        first_seed: the others follow.
        workers: runs side by side.
        set: KEY=VALUE, goes before what the files say, as for train, in all runs.
        only_plot: train nothing, show all seeds that are there.
    """

    configs: tuple[str, ...] = Field(min_length=1)
    seeds: int = Field(default=5, ge=1)
    first_seed: int = Field(default=0, ge=0)
    workers: int = Field(default=2, ge=1)
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
        if any(parsed_change(change)[0] == "seed" for change in self.set):
            problems.append(Problem(("set",), "has seed: --seeds and --first-seed say which there are"))
        if problems:
            raise ConfigurationError(problems[:1])
        return self

    @property
    def names(self) -> list[str]:
        """Of the configurations."""
        return [Path(config).stem for config in self.configs]

    @property
    def all_seeds(self) -> list[int]:
        return list(range(self.first_seed, self.first_seed + self.seeds))

    def tasks(self) -> list[str]:
        """Of the configurations, with the first seed and the last. Raises ConfigurationError where they cannot be trained."""
        seeds = (self.all_seeds[0], self.all_seeds[-1])
        found = [read_training(find_config(config), self.set, seed=seed).task for config in self.configs for seed in seeds]
        return list(dict.fromkeys(found))

    def jobs(self, out: Path) -> list["Job"]:
        """Seed by seed, so that mistakes of any configuration show early, and all have come equally far."""
        configs = [find_config(config) for config in self.configs]
        return [Job(config, seed, out / config.stem / f"seed_{seed}", self.set) for seed in self.all_seeds for config in configs]


class Job(NamedTuple):
    """One run: a configuration with a seed, its folder, and what is changed of the configuration."""

    config: Path
    seed: int
    folder: Path
    changes: tuple[str, ...]

    @property
    def log(self) -> Path:
        return self.folder / "train.log"

    @property
    def command(self) -> list[str]:
        changes = ["--set", *self.changes] if self.changes else []
        return [*TRAIN, str(self.config), "--seed", str(self.seed), "--out", str(self.folder), "--resume", *changes]


def train_all(jobs: Sequence[Job], workers: int) -> list[Job]:
    """Run all, so many at once; those that failed. What still runs when this is left, by Ctrl-C too, is stopped."""
    waiting, failed = list(jobs), []
    running: dict[Job, subprocess.Popen[bytes]] = {}
    with tqdm(total=len(jobs), desc="sweep", unit="run") as bar:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    job = waiting.pop(0)
                    running[job] = start(job)
                time.sleep(POLL)
                for job in [job for job, child in running.items() if child.poll() is not None]:
                    if running.pop(job).returncode:
                        failed.append(job)
                        bar.write(f"failed: {job.folder}, see {job.log}")
                    bar.update()
        finally:
            stop(running.values())
    return failed


def start(job: Job) -> subprocess.Popen[bytes]:
    job.folder.mkdir(parents=True, exist_ok=True)
    with open(job.log, "ab") as log:
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(job.command, stdout=log, stderr=subprocess.STDOUT, env=environment)


def stop(children: Iterable[subprocess.Popen[bytes]]) -> None:
    """By SIGTERM: Ctrl-C is ignored by what is started in the background. What follows the last checkpoint is lost."""
    running = list(children)
    for child in running:
        child.terminate()
    for child in running:
        child.wait()


def tail(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").replace("\r", "\n").splitlines()[-TAIL:])
