"""Monitor of a training, whatever its engine: validation, learning curve, best and last agent in the training's folder, and the bar."""

import csv
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from tqdm import tqdm

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation import VALIDATION_SEEDS, Summary, evaluate_rows, summarise
from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.learning.checkpoints import find_checkpoint, read_checkpoint
from soft_tendon_env.learning.config import Training
from soft_tendon_env.policies.agent import acting_policy
from soft_tendon_env.policies.agent_files import CONFIG
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.files import read_json, read_numbers
from soft_tendon_env.tools.messages import UserError

CHECKPOINT_SECONDS, CHECKPOINT_SHARE = 60.0, 0.05
"""Time after which there is a checkpoint between evaluations, unless those took a greater share of it."""
COLUMNS = ("steps", "seconds", "return", "diverged")
"""First columns of every learning curve, before the task's own."""
Watch = Callable[[Mapping[str, float]], None]
"""Function that gets every row of a learning curve as it is measured."""


class Validation:
    """Fixed validation episodes, side by side, with targets of their own. `envs`: the vector environment that they are in."""

    def __init__(self, training: Training) -> None:
        self.seeds, self._training = VALIDATION_SEEDS[: training.evaluation.episodes], training
        size: dict[str, Any] = {"num_envs": len(self.seeds), "max_episode_steps": training.episode_steps, "threads": 1}
        self.envs = gym.make_vec(IDS[training.task], **size, **training.options)

    def summary(self, agent: Policy) -> Summary:
        """Summary of all episodes under an agent, with its integral action."""
        policy = acting_policy(agent, self.envs, self._training.integral_time)
        return summarise(evaluate_rows(policy, self.envs, self.seeds, self._training.evaluation.skip))


def curve_row(steps: int, seconds: float, summary: Summary) -> dict[str, float]:
    """Row of the learning curve, in SI units."""
    row = {"steps": steps, "seconds": seconds, "return": summary.mean_return, "diverged": summary.diverged}
    if summary.reached is not None:
        row["reached"] = summary.reached
    for name, error in summary.errors.items():
        row |= {f"{name}_rms": error.rms, f"{name}_p95": error.percentile_95}
    return row


def format_row(row: Mapping[str, float]) -> str:
    """A row of the learning curve in a few words."""
    named = [(name, error_unit(name.removesuffix("_rms"))) for name in row if name.endswith("_rms")]
    words = [f"{unit.heading} {number(unit.factor * row[name])}" for name, unit in named]
    return ", ".join([*words, *([f"reached {100 * row['reached']:.0f} %"] if "reached" in row else [])])


def quality(row: Mapping[str, Any]) -> tuple[float, ...]:
    """Sort key of rows, the smaller the better: fewer divergences, then more goals reached, then a smaller first error of the task."""
    error = next(value for name, value in row.items() if name.endswith("_rms"))
    return row["diverged"], -row.get("reached", 0.0), np.inf if error is None or np.isnan(error) else error


class TrainingMonitor(ABC):
    """Validations and checkpoints of a training while it learns. An engine says what its agent is, and when nothing is half done.

    checkpoint: where it goes on; None: at the beginning. Raises ValueError, OSError.
    """

    watch: Watch | None = None
    _bar: Any = None

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        found = {} if checkpoint is None else read_checkpoint(checkpoint)
        self.training, self.folder = training, folder
        self.began, self._before = found.get("steps_done", 0), found.get("seconds_learned", 0.0)
        rows = read_numbers(folder / "evaluations.csv", COLUMNS) if (folder / "evaluations.csv").exists() else []
        self.curve = [row for row in rows if row["steps"] <= self.began]  # what follows was learned by an agent that is lost
        best = find_checkpoint(folder / "best")  # which may be further than the last checkpoint
        self._best = None if best is None else quality(read_json(best / CONFIG)["evaluated"])
        self.validation, self._untimed = Validation(training), 0.0

    @abstractmethod
    def steps_done(self) -> int:
        """Steps of all arms together."""

    @abstractmethod
    def agent(self) -> Policy:
        """The agent as it is now."""

    @abstractmethod
    def network(self) -> torch.nn.Module:
        """All weights of the agent."""

    @abstractmethod
    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        """Replace a checkpoint, see `checkpoints`."""

    def begin(self, config: dict[str, Any]) -> None:
        """Begin before the first step of this process. config: the record for config.json."""
        self._started, self._config, done = time.perf_counter(), config, self.steps_done()
        write_json(self.folder / CONFIG, self._config, say=False)
        self._bar = tqdm(total=self.training.steps, initial=done, unit="step", unit_scale=True, desc=self.folder.name, smoothing=0.05)
        self._evaluated = done // self.training.evaluation.every
        if not self.curve:
            self.untimed(self.evaluate)  # compiles, if need be
        self._due = time.perf_counter() + CHECKPOINT_SECONDS

    def between_rollouts(self) -> None:
        """Evaluate and keep what is due, when nothing is half done."""
        done = self.steps_done()
        self._bar.update(done - self._bar.n)
        if now_due := (now := done // self.training.evaluation.every) > self._evaluated:
            self._evaluated = now
            self.untimed(self.evaluate)
        if now_due or time.perf_counter() >= self._due:
            self.untimed(self.checkpoint)

    def end(self) -> None:
        """End after the last step."""
        self._bar.update(self.steps_done() - self._bar.n)
        if self.curve[-1]["steps"] < self.steps_done():
            self.untimed(self.evaluate)
        self.untimed(self.checkpoint)

    def close(self) -> None:
        """Close the bar, after the end or an error."""
        if self._bar is not None:
            self._bar.close()

    def untimed(self, work: Callable[[], None]) -> None:
        """Do work whose time does not count as learning."""
        self.check()
        started = time.perf_counter()
        work()
        self._untimed += time.perf_counter() - started

    def evaluate(self) -> None:
        """Add a row to the learning curve, and keep the agent if it is the best so far."""
        row = curve_row(self.steps_done(), self._seconds(), self.validation.summary(self.agent()))
        self.curve.append(row)
        path = self.folder / "evaluations.csv"
        with open(path.with_suffix(".new"), "w", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            writer.writeheader()
            writer.writerows({name: f"{value:.9g}" for name, value in row.items()} for row in self.curve)
        path.with_suffix(".new").replace(path)
        self._bar.set_postfix_str(format_row(row))
        if self._best is None or quality(row) < self._best:
            self._best = quality(row)
            self.save(self.folder / "best", self._config | {"steps_done": self.steps_done(), "evaluated": row}, resumable=False)
        if self.watch is not None:
            self.watch(row)

    def checkpoint(self) -> None:
        """Keep what is needed to go on from here."""
        started = time.perf_counter()
        self._config |= {"steps_done": self.steps_done(), "seconds_learned": self._seconds()}
        self.save(self.folder / "last", self._config, resumable=True)
        ended = time.perf_counter()
        self._due = ended + max(CHECKPOINT_SECONDS, (ended - started) / CHECKPOINT_SHARE)

    def check(self) -> None:
        """Raises UserError where weights are not finite: such an agent replaces no checkpoint."""
        if not all(bool(torch.isfinite(weights).all()) for weights in self.network().parameters()):
            text = f"after {self.steps_done()} steps the agent's weights are no longer finite: a smaller learning_rate may help"
            raise UserError(f"{text}. The last checkpoint in {self.folder} is from before")

    def report(self, note: str = "") -> None:
        """Print the speed of learning in this process. note: on what it ran."""
        steps = self.steps_done() - self.began
        learned = time.perf_counter() - self._started - self._untimed
        speed = f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s{note}"
        beside = f"{self._untimed:.0f} s of evaluations and checkpoints beside"
        print(f"{speed}; {beside}. At the end: {format_row(self.curve[-1])}")

    def _seconds(self) -> float:
        return self._before + time.perf_counter() - self._started - self._untimed
