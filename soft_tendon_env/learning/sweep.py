"""Sweep: trainings of every configuration with several seeds, side by side in processes of their own.

Every run is a process of `soft-tendon train` in OUT/CONFIG/seed_N, with what it prints in train.log there. Runs that are done are not
repeated, and interrupted ones go on. A run that fails stops no other. Where Ray is installed, Ray Tune starts them, see tune.py.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import Field, model_validator
from tqdm import tqdm

from soft_tendon_env.learning.config import find_config, read_training
from soft_tendon_env.learning.engine import Engine
from soft_tendon_env.learning.rllib.settings import rllib_settings
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, parsed_change

TRAIN = (sys.executable, "-m", "soft_tendon_env", "train")
POLL = 0.2  # [s] between looks at what has ended
TAIL = 15  # lines of a log
MOST_RUNS = 10_000


class Sweep(Engine):
    """Which trainings a sweep has.

    Attributes:
        configs: names of trainings that ship, or paths of TOML files.
        seeds: how many of each.
        first_seed: the others follow.
        workers: runs side by side.
        scheduler: "tune", runs are trials of Ray Tune, or "processes", of this command alone; by default Ray Tune where Ray is installed.
        address: of a Ray cluster for the trials, or "auto" for the one that runs here; by default there is one of its own on this machine.
        set: KEY=VALUE, goes before what the files say, as for train, in all runs.
        only_plot: train nothing, show all seeds that are there.
    """

    configs: tuple[str, ...] = Field(min_length=1)
    seeds: int = Field(default=5, ge=1)
    first_seed: int = Field(default=0, ge=0)
    workers: int = Field(default=2, ge=1)
    scheduler: Literal["tune", "processes"] | None = None
    address: str | None = None
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
        if self.address is not None and self.scheduler == "processes":
            problems.append(Problem(("address",), "is for --scheduler tune"))
        if problems:
            raise ConfigurationError(problems[:1])
        return self

    @property
    def with_ray(self) -> bool:
        """Whether runs are trials of Ray Tune."""
        asked = self.scheduler == "tune" or self.address is not None
        return asked or self.scheduler is None and find_spec("ray") is not None

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
        found = [read_training(find_config(config), self.set, seed=seed) for config in self.configs for seed in seeds]
        for training in found if self.engine == "rllib" else ():
            rllib_settings(training, self.all_runners)
        return list(dict.fromkeys(training.task for training in found))

    def jobs(self, out: Path) -> list["Job"]:
        """Seed by seed, so that mistakes of any configuration show early, and all have come equally far."""
        configs = [find_config(config) for config in self.configs]
        engine = ("--engine", self.engine, "--runners", str(self.all_runners)) if self.engine == "rllib" else ()
        folders = [(config, seed, out / config.stem / f"seed_{seed}") for seed in self.all_seeds for config in configs]
        return [Job(*where, self.set, engine, 1 + self.all_runners) for where in folders]


class Job(NamedTuple):
    """One run: a configuration with a seed, its folder, what is changed of the configuration, options of the engine, processes."""

    config: Path
    seed: int
    folder: Path
    changes: tuple[str, ...]
    engine: tuple[str, ...] = ()
    processors: int = 1

    @property
    def log(self) -> Path:
        return self.folder / "train.log"

    @property
    def command(self) -> list[str]:
        changes = ["--set", *self.changes] if self.changes else []
        return [*TRAIN, str(self.config), "--seed", str(self.seed), "--out", str(self.folder), "--resume", *self.engine, *changes]

    def absolute(self) -> "Job":
        """With paths that mean the same in any folder."""
        return self._replace(config=self.config.absolute(), folder=self.folder.absolute())


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


def start(job: Job, working_directory: str | None = None) -> subprocess.Popen[bytes]:
    job.folder.mkdir(parents=True, exist_ok=True)
    with open(job.log, "ab") as log:
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        return subprocess.Popen(job.command, stdout=log, stderr=subprocess.STDOUT, env=environment, cwd=working_directory)


def stop(children: Iterable[subprocess.Popen[bytes]]) -> None:
    """By SIGTERM: Ctrl-C is ignored by what is started in the background. What follows the last checkpoint is lost."""
    running = list(children)
    for child in running:
        child.terminate()
    for child in running:
        child.wait()


def tail(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").replace("\r", "\n").splitlines()[-TAIL:])
