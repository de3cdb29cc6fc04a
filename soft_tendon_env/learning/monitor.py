"""Monitor of a training, whatever its engine.

It has validation, learning curve, best and last agent in the training's folder, and progress.
"""

import csv
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation import VALIDATION_SEEDS, evaluate_rows, summarise
from soft_tendon_env.evaluation.provenance import write_json
from soft_tendon_env.evaluation.summaries import tracking_cost
from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.learning.checkpoints import (
    acting_network,
    config_record,
    find_checkpoint,
    read_checkpoint,
    replace_checkpoint,
    statistics_of,
    write_model,
)
from soft_tendon_env.learning.config import BestBy, Training
from soft_tendon_env.learning.purpose import PURPOSE, purpose
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import CONFIG, NetworkPolicy, acting_policy
from soft_tendon_env.tools.files import read_json, replacing
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.tables import read_numbers

COLUMNS = ("steps", "seconds", "return", "diverged")
"""Columns of every learning curve, before the task's own."""
RMS = "_rms"  # with which columns of errors end
Watch = Callable[[Mapping[str, float]], None]
"""Function that gets every row of a learning curve as it is measured."""


def quality(row: Mapping[str, Any], best_by: BestBy = "errors") -> tuple[float, ...]:
    """Sort key of rows, the smaller the better.

    By errors more goals reached come first, then a smaller `tracking_cost`, then a smaller typical
    error. By the return nothing else counts.
    """
    if best_by == "return":
        return (-row["return"],)
    typical = row["typical"]
    if typical is None or np.isnan(typical):
        typical = np.inf
    reached = row.get("reached", 0.0)
    return -reached, row["cost"], typical


def format_row(row: Mapping[str, float]) -> str:
    """The errors of a row of the learning curve."""
    parts = []
    for name, value in row.items():
        if name.endswith(RMS):
            unit = error_unit(name.removesuffix(RMS))
            text = number(unit.factor * value)
            parts.append(f"{unit.heading} {text}")
    return ", ".join(parts)


class TrainingMonitor(ABC):
    """Validations and checkpoints of a training while it learns.

    An engine says what its network is, and when nothing is half done.
    """

    watch: Watch | None = None

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        """A monitor of a training in a folder.

        checkpoint: where it goes on; None: at the beginning. Raises ValueError, OSError.
        """
        if checkpoint is None:
            record = {}
        else:
            record = read_checkpoint(checkpoint)
        self.training = training
        self.folder = folder
        self.began = record.get("steps_done", 0)
        self._before = record.get("seconds_learned", 0.0)
        self._untimed = 0.0
        self._csv = folder / "evaluations.csv"
        if self._csv.exists():
            rows = read_numbers(self._csv, COLUMNS)
        else:
            rows = []
        # what follows was learned by an agent that is lost
        self.curve = [row for row in rows if row["steps"] <= self.began]
        # which may be further than the last checkpoint
        best = find_checkpoint(folder / "best")
        if best is None:
            self._best = None
        else:
            evaluated = read_json(best / CONFIG)["evaluated"]
            self._best = self._quality(evaluated)
        self.envs = gym.make_vec(
            IDS[training.task],
            num_envs=training.evaluation.episodes,
            max_episode_steps=training.episode_steps,
            threads=1,
            **training.options,
        )

    @abstractmethod
    def steps_done(self) -> int:
        """Steps of all arms together."""

    @abstractmethod
    def network(self) -> Any:
        """The policy network, all weights of the agent."""

    @abstractmethod
    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        """Replace a checkpoint, see `checkpoints`."""

    def normalise(self, observation: Any) -> Any:
        """An observation as the network sees it."""
        return observation

    def begin(self, config: dict[str, Any]) -> None:
        """Begin before the first step of this process.

        config: the record for config.json.
        """
        self._started = time.perf_counter()
        self._config = config
        write_json(self.folder / CONFIG, config, say=False)
        file = self.folder / PURPOSE
        text = purpose(self.training)
        file.write_text(text, encoding="utf-8")
        self._evaluated = self._evaluations_due()
        if not self.curve:
            self.evaluate()  # compiles, if need be

    def _evaluations_due(self) -> int:
        """Number of evaluations that the steps so far make."""
        return self.steps_done() // self.training.evaluation.every

    def between_rollouts(self, ends: bool = False) -> None:
        """Evaluate and keep the agent if that is due, when nothing is half done.

        ends: after the last step, when it is.
        """
        before = self._evaluated
        self._evaluated = self._evaluations_due()
        is_due = self._evaluated > before
        is_last = ends and self.curve[-1]["steps"] < self.steps_done()
        if is_due or is_last:
            self.evaluate()
            config = {
                **self._config,
                "steps_done": self.steps_done(),
                "seconds_learned": self._seconds(),
            }
            self.save(self.folder / "last", config, True)

    def evaluate(self) -> None:
        """Add a row of fixed validation episodes to the learning curve, in SI units.

        The agent is kept if it is the best so far.
        """
        self.check()
        row: dict[str, float] = {"steps": self.steps_done(), "seconds": self._seconds()}
        row |= self._validate()
        self.curve.append(row)
        self._write_curve()
        print(
            f"{row['steps']} of {self.training.steps} steps, {row['seconds']:.0f} s:"
            f" {format_row(row)}",
            flush=True,
        )
        row_quality = self._quality(row)
        if self._best is None or row_quality < self._best:
            self._best = row_quality
            config = {**self._config, "steps_done": self.steps_done(), "evaluated": row}
            self.save(self.folder / "best", config, False)
        # the time of validations is no time of learning
        self._untimed += self._seconds() - row["seconds"]
        if self.watch is not None:
            self.watch(row)

    def _quality(self, row: Mapping[str, Any]) -> tuple[float, ...]:
        return quality(row, self.training.evaluation.best_by)

    def _validate(self) -> dict[str, float]:
        """Scores of the agent on fixed validation episodes, by column."""
        agent = NetworkPolicy(self.network(), self.normalise)
        policy = acting_policy(agent, self.envs, self.training.integral_time)
        seeds = VALIDATION_SEEDS[: self.envs.num_envs]
        scores = evaluate_rows(policy, self.envs, seeds, self.training.evaluation.skip)
        summary = summarise(scores)
        # of the task's first error, in episodes that did not diverge
        rms = []
        for score in scores:
            if score.diverged is None:
                first = next(iter(score.errors.values()))
                rms.append(first.rms)
        columns = {
            "return": summary.mean_return,
            "diverged": summary.diverged,
            "cost": tracking_cost(scores),
            # geometric: a few episodes that go wrong do not hide the others
            "typical": float(np.exp(np.log(rms).mean())) if rms else np.nan,
        }
        if summary.reached is not None:
            columns["reached"] = summary.reached
        for name, error in summary.errors.items():
            columns[f"{name}{RMS}"] = error.rms
            columns[f"{name}_p95"] = error.percentile_95
        return columns

    def _write_curve(self) -> None:
        """Replace the file of the learning curve."""
        with replacing(self._csv) as new, open(new, "w", newline="") as file:
            names = list(self.curve[-1])
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            for values in self.curve:
                texts = {name: f"{value:.9g}" for name, value in values.items()}
                writer.writerow(texts)

    def check(self) -> None:
        """Raises UserError where weights are not finite: such an agent replaces no checkpoint."""
        parameters = self.network().parameters()
        is_finite = (bool(torch.isfinite(weights).all()) for weights in parameters)
        if not all(is_finite):
            text = (
                f"after {self.steps_done()} steps the agent's weights are no longer finite: a"
                " smaller learning_rate may help"
            )
            raise UserError(f"{text}. The last checkpoint in {self.folder} is from before")

    def report(self) -> None:
        """Print the speed of learning in this process."""
        steps = self.steps_done() - self.began
        learned = self._seconds() - self._before
        print(
            f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s; at the end:"
            f" {format_row(self.curve[-1])}"
        )

    def _seconds(self) -> float:
        """How long it has learned [s], without evaluations."""
        now = self._before + time.perf_counter()
        elapsed = now - self._started
        return elapsed - self._untimed


class TrainingCallback(TrainingMonitor, BaseCallback):
    """Monitor of a training with Stable-Baselines3.

    Raises ValueError, OSError.
    """

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        BaseCallback.__init__(self)
        TrainingMonitor.__init__(self, training, folder, checkpoint)

    def steps_done(self) -> int:
        return int(self.num_timesteps)

    def network(self) -> Any:
        return acting_network(self.model)

    def normalise(self, observation: Any) -> Any:
        return statistics_of(self.model).normalize_obs(observation)

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        replace_checkpoint(folder, config, lambda new: write_model(new, self.model, resumable))

    def _on_training_start(self) -> None:
        rows = unwrapped(self.training_env).env
        self.begin(config_record(self.training, rows.episodes))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.between_rollouts()

    def _on_training_end(self) -> None:
        self.between_rollouts(ends=True)
