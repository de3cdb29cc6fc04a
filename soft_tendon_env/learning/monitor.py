"""Monitor of a training, whatever its engine: validation, learning curve, best and last agent in
the training's folder, and progress."""

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
    config_record,
    find_checkpoint,
    read_checkpoint,
    replace_checkpoint,
    statistics_of,
    write_model,
)
from soft_tendon_env.learning.config import Training
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.policies.agent import CONFIG, NetworkPolicy, acting_policy
from soft_tendon_env.tools.files import read_json, replacing
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.tables import read_numbers

COLUMNS = (
    "steps",
    "seconds",
    "return",
    "diverged",
)  # of every learning curve, before the task's own
Watch = Callable[[Mapping[str, float]], None]
"""Function that gets every row of a learning curve as it is measured."""


def quality(row: Mapping[str, Any]) -> tuple[float, ...]:
    """Sort key of rows, the smaller the better: more goals reached, then a smaller `tracking_cost`,
    then a smaller typical error."""
    typical = row["typical"]
    return (
        -row.get("reached", 0.0),
        row["cost"],
        np.inf if typical is None or np.isnan(typical) else typical,
    )


def format_row(row: Mapping[str, float]) -> str:
    """The errors of a row of the learning curve."""
    named = [(name, error_unit(name.removesuffix("_rms"))) for name in row if name.endswith("_rms")]
    return ", ".join(f"{unit.heading} {number(unit.factor * row[name])}" for name, unit in named)


class TrainingMonitor(ABC):
    """Validations and checkpoints of a training while it learns. An engine says what its network
    is, and when nothing is half done.

    checkpoint: where it goes on; None: at the beginning. Raises ValueError, OSError.
    """

    watch: Watch | None = None

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        found = {} if checkpoint is None else read_checkpoint(checkpoint)
        self.training, self.folder, self._csv = training, folder, folder / "evaluations.csv"
        self.began, self._before, self._untimed = (
            found.get("steps_done", 0),
            found.get("seconds_learned", 0.0),
            0.0,
        )
        rows = read_numbers(self._csv, COLUMNS) if self._csv.exists() else []
        self.curve = [
            row for row in rows if row["steps"] <= self.began
        ]  # what follows was learned by an agent that is lost
        best = find_checkpoint(folder / "best")  # which may be further than the last checkpoint
        self._best = None if best is None else quality(read_json(best / CONFIG)["evaluated"])
        size: dict[str, Any] = {
            "num_envs": training.evaluation.episodes,
            "max_episode_steps": training.episode_steps,
            "threads": 1,
        }
        self.envs = gym.make_vec(IDS[training.task], **size, **training.options)

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
        """Begin before the first step of this process. config: the record for config.json."""
        self._started, self._config = time.perf_counter(), config
        write_json(self.folder / CONFIG, config, say=False)
        self._evaluated = self.steps_done() // self.training.evaluation.every
        if not self.curve:
            self.evaluate()  # compiles, if need be

    def between_rollouts(self, ends: bool = False) -> None:
        """Evaluate and keep the agent if that is due, when nothing is half done. ends: after the
        last step, when it is."""
        before, self._evaluated = (
            self._evaluated,
            self.steps_done() // self.training.evaluation.every,
        )
        if self._evaluated > before or ends and self.curve[-1]["steps"] < self.steps_done():
            self.evaluate()
            self.save(
                self.folder / "last",
                self._config
                | {
                    "steps_done": self.steps_done(),
                    "seconds_learned": self._seconds(),
                },
                True,
            )

    def evaluate(self) -> None:
        """Add a row of fixed validation episodes, in SI units, to the learning curve, and keep the
        agent if it is the best so far."""
        self.check()
        row: dict[str, float] = {"steps": self.steps_done(), "seconds": self._seconds()}
        policy = acting_policy(
            NetworkPolicy(self.network(), self.normalise), self.envs, self.training.integral_time
        )
        seeds = VALIDATION_SEEDS[: self.envs.num_envs]
        scores = evaluate_rows(policy, self.envs, seeds, self.training.evaluation.skip)
        summary, first = (
            summarise(scores),
            np.array(
                [
                    next(iter(score.errors.values())).rms
                    for score in scores
                    if score.diverged is None
                ]
            ),
        )
        row |= {
            "return": summary.mean_return,
            "diverged": summary.diverged,
            "cost": tracking_cost(scores),
        }
        row |= {"typical": float(np.exp(np.log(first).mean())) if first.size else np.nan}
        row |= {} if summary.reached is None else {"reached": summary.reached}
        for name, error in summary.errors.items():
            row |= {f"{name}_rms": error.rms, f"{name}_p95": error.percentile_95}
        self.curve.append(row)
        with replacing(self._csv) as new, open(new, "w", newline="") as file:
            writer = csv.DictWriter(file, list(row))
            writer.writeheader()
            writer.writerows(
                {name: f"{value:.9g}" for name, value in values.items()} for values in self.curve
            )
        print(
            f"{row['steps']} of {self.training.steps} steps, {row['seconds']:.0f} s:"
            f" {format_row(row)}",
            flush=True,
        )
        if self._best is None or quality(row) < self._best:
            self._best = quality(row)
            self.save(
                self.folder / "best",
                self._config | {"steps_done": self.steps_done(), "evaluated": row},
                False,
            )
        self._untimed += self._seconds() - row["seconds"]
        if self.watch is not None:
            self.watch(row)

    def check(self) -> None:
        """Raises UserError where weights are not finite: such an agent replaces no checkpoint."""
        if not all(bool(torch.isfinite(weights).all()) for weights in self.network().parameters()):
            text = (
                f"after {self.steps_done()} steps the agent's weights are no longer finite: a"
                " smaller learning_rate may help"
            )
            raise UserError(f"{text}. The last checkpoint in {self.folder} is from before")

    def report(self) -> None:
        """Print the speed of learning in this process."""
        steps, learned = self.steps_done() - self.began, self._seconds() - self._before
        print(
            f"{steps} steps in {learned:.0f} s: {steps / learned:.0f} steps/s; at the end:"
            f" {format_row(self.curve[-1])}"
        )

    def _seconds(self) -> float:
        return self._before + time.perf_counter() - self._started - self._untimed


class TrainingCallback(TrainingMonitor, BaseCallback):
    """Monitor of a training with Stable-Baselines3. Raises ValueError, OSError."""

    def __init__(self, training: Training, folder: Path, checkpoint: Path | None) -> None:
        BaseCallback.__init__(self)
        TrainingMonitor.__init__(self, training, folder, checkpoint)

    def steps_done(self) -> int:
        return int(self.num_timesteps)

    def network(self) -> Any:
        return self.model.policy

    def normalise(self, observation: Any) -> Any:
        return statistics_of(self.model).normalize_obs(observation)

    def save(self, folder: Path, config: Mapping[str, Any], resumable: bool) -> None:
        replace_checkpoint(folder, config, lambda new: write_model(new, self.model, resumable))

    def _on_training_start(self) -> None:
        self.begin(config_record(self.training, unwrapped(self.training_env).env.episodes))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.between_rollouts()

    def _on_training_end(self) -> None:
        self.between_rollouts(ends=True)
