"""Accuracy of gradients through an arm: the adjoint beside central differences of a rollout."""

import warnings
import weakref
from typing import NamedTuple

import numpy as np
import torch

from soft_tendon_env.differentiable.period import arm_tensors, control_period
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.tools.types import Array

LEAST_COSINE = 0.99
"""Cosine with differences below which gradients lead a training astray."""

LEAST_SHARE = 0.05
"""Least commands of a trial, as a share of their range."""

FIRST_SHARE = 0.2
"""Commands that a trial begins with, likewise."""

GREATEST_SHARE = 0.6
"""Greatest commands of a trial, likewise."""

WAY = 0.01
"""Share of the range by which commands are moved for the differences: as an optimiser's steps,
above an adaptive order's jumps."""

CHANGE = 0.05
"""Share of the range that commands of absolute actions change by in a period."""

DIRECTIONS = 16
"""Directions of the commands along which gradients are compared."""

PERIODS = 16
"""Control periods of a trial."""

ROWS = 4
"""Rows of an environment whose arms are tried."""


_checked: weakref.WeakSet[Episodes] = weakref.WeakSet()
"""Episodes of environments whose gradients were checked."""


class GradientWarning(UserWarning):
    """Gradients of this arm differ from finite differences of its motion."""


class GradientAccuracy(NamedTuple):
    """Adjoint gradient beside central differences, along random directions of the commands."""

    cosine: float  # of the angle between the two
    ratio: float  # of its length to theirs


def check_gradients(episodes: Episodes) -> None:
    """Warn (GradientWarning) where gradients through arms of an environment are not accurate.

    Commands are within the upper half of the environment's, or from 0 on. Elastic tendons, which
    hang slack below that, are tried over all commands too.

    Args:
        episodes: whose first arms, as drawn, are tried; accurate are gradients with a cosine of at
            least LEAST_COSINE.
    """
    _checked.add(episodes)
    scale = episodes.actuation.actions
    middle = 0.5 * (scale.least + scale.greatest)
    above_zero = np.maximum(scale.least, 0.0)
    least = np.minimum(above_zero, middle)
    ranges = [least]
    if has_elastic_tendons(episodes) and np.any(scale.least < least):
        ranges.append(scale.least)
    reports = []
    row_count = min(ROWS, episodes.arms.size)
    for row in range(row_count):
        model = episodes.arms.model_of(row)
        for lowest in ranges:
            change = scale.increment
            if change is None:
                change = CHANGE * (scale.greatest - lowest)
            report = gradient_accuracy(
                model,
                episodes.period,
                lowest,
                scale.greatest,
                change,
            )
            reports.append(report)
    worst = min(reports, key=_quality)
    if not worst.cosine >= LEAST_COSINE:
        warnings.warn(
            f"gradients through this arm have a cosine of {worst.cosine:.3f} with differences of"
            f" its motion, and {worst.ratio:.2f} times their length: learning by them may end at"
            " larger errors. A shorter control_period, softer tendons, none that hang slack or"
            " slower commands bring them nearer; PPO and SAC need none",
            GradientWarning,
            stacklevel=3,
        )


def check_elastic_gradients(episodes: Episodes) -> None:
    """Warn as `check_gradients`, once for an environment, where tendons are elastic.

    Stiff ones that become taut within a control period are as impacts, whose gradients differ most.

    Args:
        episodes: of the environment.
    """
    if has_elastic_tendons(episodes) and episodes not in _checked:
        check_gradients(episodes)


def has_elastic_tendons(episodes: Episodes) -> bool:
    """Whether tendons of an environment's arms are springs.

    Args:
        episodes: of the environment.

    Returns:
        True if its scene has `effects.tendon_elasticity`.
    """
    return "tendon_elasticity" in episodes.model.scene.effects.chosen()


def _quality(report: GradientAccuracy) -> tuple[bool, float]:
    """Whether a gradient is accurate, and its cosine: nan is the worst."""
    return report.cosine >= LEAST_COSINE, report.cosine


def gradient_accuracy(
    model: Model,
    period: float,
    least: Array,
    greatest: Array,
    change: Array,
    seed: int = 0,
) -> GradientAccuracy:
    """Measures the accuracy of a tracking error's gradient by all commands, from rest.

    It takes seconds at most. The commands are random walks of PERIODS control periods. The arm
    tracks where another walk leads it. Rows side by side have commands that are moved to either
    side along DIRECTIONS.

    Args:
        model: of the arm.
        period: of control [s].
        least: limits (n_a,) of the commands.
        greatest: limits (n_a,) of the commands.
        change: (n_a,) by which commands change in a period at most.
        seed: of the walks and directions.

    Returns:
        Cosine and ratio to central differences.

    Raises:
        ValueError: as `Arms.adjoint`, where it has none.
        LinAlgError: as `Arms.adjoint`, where it has none.
    """
    random = np.random.default_rng(seed)
    reach = greatest - least
    walks = _walks(random, least, reach, change)
    shape = DIRECTIONS, PERIODS, reach.size
    unit_ways = random.normal(size=shape) * WAY
    ways = unit_ways * reach
    ahead = walks[0] + ways
    behind = walks[0] - ways
    every_walk = np.concatenate([walks, ahead, behind])
    commands = torch.tensor(every_walk, requires_grad=True)
    costs = _costs(model, period, commands)
    (gradient,) = torch.autograd.grad(costs[0], commands)

    # rows are: the walk, the one that is tracked, those moved forth, those moved back
    forth = costs[2 : 2 + DIRECTIONS]
    back = costs[2 + DIRECTIONS :]
    differences = (forth - back).detach().numpy()
    # moves are to both sides
    products = np.einsum("dka,ka->d", ways, gradient[0].numpy())
    slopes = 2.0 * products
    length = np.linalg.norm(slopes)
    length_of_differences = np.linalg.norm(differences)
    lengths = np.prod([length, length_of_differences])
    cosine = slopes @ differences / lengths
    ratio = float(length / length_of_differences)
    return GradientAccuracy(float(cosine), ratio)


def _walks(
    random: np.random.Generator,
    least: Array,
    reach: Array,
    change: Array,
) -> Array:
    """Two random walks (2, PERIODS, n_a) of commands, reflected at the ends of a trial's range."""
    low = least + LEAST_SHARE * reach
    begin = least + FIRST_SHARE * reach
    high = least + GREATEST_SHARE * reach
    width = high - low
    largest_step = np.minimum(change, 0.5 * width)
    shape = 2, PERIODS, reach.size
    shares = random.uniform(-1.0, 1.0, shape)
    steps = shares * largest_step
    unlimited = begin + np.cumsum(steps, axis=1)
    # a triangle wave, which goes to and fro between 0 and the width
    from_low = unlimited - low + width
    beyond = from_low % (2.0 * width)
    from_fold = np.abs(beyond - width)
    return np.asarray(low + from_fold)


def _costs(model: Model, period: float, commands: torch.Tensor) -> torch.Tensor:
    """Tracking errors (rows,) of arms under commands (rows, PERIODS, n_a); row 1 is tracked."""
    rows = len(commands)
    no_places = np.zeros(0)
    arms = Arms(
        model,
        rows,
        period,
        no_places,
        no_places,
    )
    rest = Simulation(model).reset_at_rest().q
    numbers = np.arange(rows)
    rests = np.tile(rest, (rows, 1))
    arms.place(numbers, rests)
    now = arm_tensors(arms)
    costs = torch.zeros(rows)
    for k in range(PERIODS):
        command = commands[:, k : k + 1]
        held = command.expand(-1, arms.substeps, -1)
        now = control_period(arms, now, held)
        tip = now.tip_pose[:, :3, 3]
        position = now.tip_pose[1, :3, 3].detach()
        way = tip - position
        square = way.square().sum(dim=1)
        costs = costs + 0.5 * square
    return costs
