"""Accuracy of gradients through an arm: the adjoint's beside central differences of the same
rollout."""

import warnings
from typing import NamedTuple

import numpy as np
import torch

from soft_tendon_env.differentiable.period import arm_tensors, control_period
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.tools.types import Array

LEAST_COSINE = 0.99  # cosine with differences below which gradients lead a training astray
WITHIN = (
    0.05,
    0.2,
    0.6,
)  # shares of the range of commands: the least of a trial, where it begins, and its greatest
# share of the range by which commands are moved for the differences: as an optimiser's steps, above
# an adaptive order's jumps
WAY = 0.01
CHANGE = 0.05  # share of the range that commands of absolute actions change by in a period
DIRECTIONS, PERIODS, ROWS = 16, 16, 4


class GradientWarning(UserWarning):
    """Gradients of this arm differ from finite differences of its motion."""


class GradientAccuracy(NamedTuple):
    """Adjoint gradient beside central differences, along random directions of the commands."""

    cosine: float
    ratio: float  # of its length to theirs


def check_gradients(episodes: Episodes) -> None:
    """Warns (GradientWarning) where gradients through the first arms of an environment, as drawn,
    are below LEAST_COSINE.

    Commands are within the upper half of the environment's, or from 0 on: below that elastic
    tendons hang slack.
    """
    scale, arms = episodes.actuation.actions, episodes.arms
    least = np.minimum(np.maximum(scale.least, 0.0), 0.5 * (scale.least + scale.greatest))
    change = CHANGE * (scale.greatest - least) if scale.increment is None else scale.increment
    models = map(arms.model_of, range(min(ROWS, arms.size)))
    tried = [
        gradient_accuracy(model, episodes.period, least, scale.greatest, change) for model in models
    ]
    found = min(tried, key=lambda one: (one.cosine >= LEAST_COSINE, one.cosine))
    if not found.cosine >= LEAST_COSINE:
        warnings.warn(
            f"gradients through this arm have a cosine of {found.cosine:.3f} with differences of"
            f" its motion, and {found.ratio:.2f} times their length: learning by them may end at"
            " larger errors. A shorter control_period, softer tendons or slower commands bring"
            " them nearer; PPO and SAC need none",
            GradientWarning,
            stacklevel=3,
        )


def gradient_accuracy(
    model: Model, period: float, least: Array, greatest: Array, change: Array, seed: int = 0
) -> GradientAccuracy:
    """Accuracy of the gradient of a tracking error over 16 control periods [s] by all commands,
    from rest; seconds at most.

    The commands are random walks within limits least, greatest (n_a,), by up to `change` (n_a,)
    every period. The arm tracks where another walk leads it. Rows side by side have commands that
    are moved to either side along 16 directions. Raises as `Arms.adjoint`.
    """
    random, reach = np.random.default_rng(seed), greatest - least
    low, begin, high = (least + share * reach for share in WITHIN)
    walks = begin + np.cumsum(
        random.uniform(-1.0, 1.0, (2, PERIODS, reach.size))
        * np.minimum(change, 0.5 * (high - low)),
        axis=1,
    )
    walks = low + np.abs(
        (walks - low + (high - low)) % (2.0 * (high - low)) - (high - low)
    )  # reflected at both ends
    ways = random.normal(size=(DIRECTIONS, PERIODS, reach.size)) * WAY * reach
    commands = torch.tensor(
        np.concatenate([walks, walks[0] + ways, walks[0] - ways]), requires_grad=True
    )
    arms, costs = (
        Arms(model, len(commands), period, np.zeros(0), np.zeros(0)),
        torch.zeros(len(commands)),
    )
    arms.place(np.arange(arms.size), np.tile(Simulation(model).reset_at_rest().q, (arms.size, 1)))
    now = arm_tensors(arms)
    for k in range(PERIODS):
        now = control_period(arms, now, commands[:, k : k + 1].expand(-1, arms.substeps, -1))
        costs = costs + 0.5 * (
            now.tip_pose[:, :3, 3] - now.tip_pose[1, :3, 3].detach()
        ).square().sum(dim=1)
    (gradient,) = torch.autograd.grad(costs[0], commands)
    moved = (costs[2 : 2 + DIRECTIONS] - costs[2 + DIRECTIONS :]).detach().numpy()
    found = 2.0 * np.einsum("dka,ka->d", ways, gradient[0].numpy())
    sizes = np.linalg.norm(found), np.linalg.norm(moved)
    return GradientAccuracy(float(found @ moved / np.prod(sizes)), float(sizes[0] / sizes[1]))
