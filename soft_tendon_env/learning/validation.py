"""Validation of an agent while it learns: errors on fixed episodes, as rows of the learning curve, and which agent is the best so far."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.tracking import error_unit
from soft_tendon_env.evaluation import VALIDATION_SEEDS, Summary, evaluate_rows, summarise
from soft_tendon_env.evaluation.tables import number
from soft_tendon_env.learning.checkpoints import find_checkpoint
from soft_tendon_env.learning.config import Training
from soft_tendon_env.policies.agent import acting_policy
from soft_tendon_env.policies.agent_files import CONFIG
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.files import read_json


class Validation:
    """Fixed validation episodes, side by side, with targets of their own. `envs`: the vector environment that they are in."""

    def __init__(self, training: Training) -> None:
        self._seeds, self._skip = VALIDATION_SEEDS[: training.evaluation.episodes], training.evaluation.skip
        steps = training.episode_steps
        size: dict[str, Any] = {"num_envs": len(self._seeds), "max_episode_steps": steps, "threads": training.threads}
        self.envs = gym.make_vec(IDS[training.task], **size, **training.options)
        self._integral_time = training.integral_time

    def summary(self, agent: Policy) -> Summary:
        """Summary of all episodes under an agent, with its integral action."""
        policy = acting_policy(agent, self.envs, self._integral_time)
        return summarise(evaluate_rows(policy, self.envs, self._seeds, self._skip))


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


def best_quality(folder: Path) -> tuple[float, ...] | None:
    """Quality of the best agent in a training's folder, which may be further than the last checkpoint; None without one.

    Raises ValueError.
    """
    best = find_checkpoint(folder / "best")
    if best is None:
        return None
    try:
        row = read_json(best / CONFIG).get("evaluated")
        if not isinstance(row, dict) or "diverged" not in row or not any(name.endswith("_rms") for name in row):
            raise ValueError(f"{best / CONFIG} has no evaluation of the agent")
    except (ValueError, OSError) as error:
        raise ValueError(f"{error}: take {best} away, and the best is chosen anew from here on") from error
    return quality(row)
