"""Rewards in PyTorch: those of the environments, with gradients."""

from collections.abc import Callable, Mapping

import numpy as np
import torch

from soft_tendon_env.differentiable.rollout import Trajectories
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.kernels import EFFORT, SMOOTHNESS
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

Square = Callable[[Trajectories], torch.Tensor]


def _position_square(trajectories: Trajectories) -> torch.Tensor:
    return trajectories.position_error.square().sum(-1)


def _angle_square(trajectories: Trajectories) -> torch.Tensor:
    angles = trajectories.error[..., :3]
    return angles.square().sum(-1)


def _backbone_square(trajectories: Trajectories) -> torch.Tensor:
    squares = trajectories.backbone_error.square().sum(-1)
    return squares.mean(-1)


SQUARES: Mapping[str, Square] = {
    "position_error": _position_square,
    "angle_error": _angle_square,
    "backbone_error": _backbone_square,
}
"""Squares (periods, rows) of tracking errors, [m^2] or [rad^2], by the names of the errors."""


class TensorReward:
    """Reward of trajectories as the environment gives it, with gradients.

    Args:
        episodes: of the environment, whose chosen terms count.

    Raises:
        ConfigurationError: gradients cannot pass its terms, which are named.
    """

    def __init__(self, episodes: Episodes) -> None:
        reward = episodes.reward_terms
        if reward is None:
            text = f"is that of goals, of the task {episodes.task.name}: it has no gradients"
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        lacking = [*reward.functions]
        lacking += [name for name in reward.errors if name not in SQUARES]
        if lacking:
            text = (
                f"has terms of {', '.join(lacking)}, without gradients: those of effort,"
                f" smoothness, {', '.join(SQUARES)} have them"
            )
            raise ConfigurationError([Problem(("reward",), text)], "environment")
        self._errors = reward.errors
        self._table = reward.table

    def __call__(self, trajectories: Trajectories) -> torch.Tensor:
        """Computes the rewards of all periods.

        Args:
            trajectories: of a rollout in the environment.

        Returns:
            Rewards (periods, rows), 0 where the simulation diverged, as `trajectories.reward`.
        """
        table = self._table
        squares = [SQUARES[name](trajectories) for name in self._errors]
        reward = torch.zeros_like(trajectories.reward)
        for i, source in enumerate(table.source.tolist()):
            if source == EFFORT:
                value = _economy(trajectories.applied, table.strongest)
            elif source == SMOOTHNESS:
                value = _economy(trajectories.action_change, table.most_change)
            else:
                begin = table.first[i]
                end = table.first[i + 1]
                scales = table.scale[begin:end]
                value = _mean_closeness(squares[source], scales)
            weight = float(table.weight[i])
            reward = reward + weight * value
        return reward * ~trajectories.diverged


def _economy(values: torch.Tensor, most: Array) -> torch.Tensor:
    """1 less the mean square (periods, rows) of values as parts of the largest, most (n_a,)."""
    parts = values / torch.tensor(most)
    squares = parts.square().clamp(max=1.0)
    return 1.0 - squares.mean(-1)


def _mean_closeness(square: torch.Tensor, scales: Array) -> torch.Tensor:
    """Mean closeness (periods, rows) at some scales of an error, of its square."""
    scale_squares = torch.tensor(np.square(scales))
    ratios = square[..., None] / scale_squares
    closeness = 1.0 / (1.0 + ratios)
    return closeness.mean(-1)
