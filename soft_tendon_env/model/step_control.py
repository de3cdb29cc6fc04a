"""Time steps of a scene as the kernels take them.

They are the integration method, control of step size, and the commands held over each.
"""

import warnings
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.mechanics.motion.advance import Control
from soft_tendon_env.mechanics.motion.extrapolation import STEP_TOLERANCE, Extrapolated
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import extrapolation_columns
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.types import Array

# steps of one call, whose commands and samples are kept
MOST_STEPS = 2 * 10**6
# estimated error, as displacement over the rod's length, that a step of fixed size may have
UNSTABLE = 0.05
# tolerance of the strain's Newton, as a share of the step's over the rod's length
STRAIN_SHARE = 2.0
# largest tolerance of the strain's Newton
LOOSEST_STRAIN = 3e-6
# columns of the extrapolation that a step with a tolerance takes at least
LEAST_COLUMNS = 2
# share of a step by which a duration may be too long for its number of steps: round-off
ROUND_OFF = 1e-9
# place in a step from its middle, a Gauss point that no period in steps hits, where a function of
# time is looked at besides
BESIDE_MIDDLE = 0.5 / np.sqrt(3.0)
# share of its range that a function of time may change there otherwise than from step to step
UNRESOLVED = 0.05
# phase [rad] of the slowest vibration that one step of a linearised motion may cover
RESOLVED = 0.3

Command = ArrayLike | Callable[[float], ArrayLike]


class CommandWarning(UserWarning):
    """A command that is a function of time changes faster than integrator steps follow."""


def cause_of(code: int, model: Model, control: Control) -> str:
    """The message of a status, which says the tolerance that could not be met."""
    if code != status.INACCURATE or not control.adaptive:
        return status.MESSAGES[code]
    halvings = model.scene.integrator.max_halvings
    return (
        f"the estimated error is above integrator.tolerance, {control.tolerance:g} m, even with"
        f" steps of {control.smallest:.2g} s, {halvings} halvings: allow more of either"
    )


def step_method(model: Model) -> Extrapolated:
    """Integration method of the scene, as the kernels take it."""
    integrator = model.scene.integrator
    columns = extrapolation_columns(model.scene)
    # without inertia D is in the place of M
    has_inertia = not integrator.quasi_static
    if integrator.tolerance is None:
        least_columns = columns
        strain_tolerance = STEP_TOLERANCE
    else:
        least_columns = LEAST_COLUMNS
        share = STRAIN_SHARE * integrator.tolerance / model.length
        strain_tolerance = min(max(share, STEP_TOLERANCE), LOOSEST_STRAIN)
    return Extrapolated(
        columns,
        least_columns,
        has_inertia,
        least_columns < columns and has_inertia,
        strain_tolerance,
    )


@lru_cache(maxsize=8)
def step_control(model: Model, duration: float) -> Control:
    """Step control of the scene over a duration: equal steps of at most the scene's.

    Args:
        model: of the scene.
        duration: [s].
    """
    integrator = model.scene.integrator
    steps = duration / integrator.step
    at_least = steps * (1.0 - ROUND_OFF)
    step = duration / np.ceil(at_least)
    if integrator.tolerance is None:
        tolerance = UNSTABLE * model.length
    else:
        tolerance = integrator.tolerance
    return Control(
        step,
        tolerance,
        adaptive=integrator.tolerance is not None,
        smallest=step * 0.5**integrator.max_halvings,
        horizon=0.0 if integrator.quasi_static else integrator.step,
    )


def step_count(duration: float, control: Control) -> int:
    """Number of integrator steps of a duration [s].

    Raises:
        ValueError: where one call would have to keep too many samples and commands.
    """
    most = MOST_STEPS * control.step
    if duration > most:
        raise ValueError(
            f"duration should be at most {most:g} s in one call, not {duration:g} s: go on from the"
            " last state"
        )
    return round(duration / control.step)


@lru_cache(maxsize=8)
def linear_rate(model: Model) -> float:
    """Steps per second in which a linearised motion resolves the slowest vibration of the bare arm.

    It has a phase of RESOLVED in each.
    """
    still = np.zeros(model.coordinate_count)
    terms = model.terms(still, still)
    # M q_ddot + G q = 0
    acceleration = np.linalg.solve(terms.mass, terms.stiffness)
    squared_rates = np.linalg.eigvals(acceleration).real
    slowest = np.sqrt(squared_rates.min())
    return float(slowest) / RESOLVED


def command_table(
    model: Model, command: Command, start: float, samples: int, per_sample: int, step: float
) -> Array:
    """Commands over every integrator step: (samples, per_sample, n_a).

    Warns where a function of time changes faster than steps follow.

    Args:
        model: of the arm.
        command: (n_a,), a row for each sample (samples, n_a), or a function of time [s].
        start: time [s] at which the first step begins.
        samples: of the motion.
        per_sample: integrator steps.
        step: of the integrator [s].
    """
    tendons = model.tendon_count
    if callable(command):
        count = samples * per_sample
        index = np.arange(count, dtype=np.float64)
        from_start = step * (index + 0.5)
        middles: Array = start + from_start
        rows = _sample(command, middles, tendons)
        if count > 1:
            beside_middles = middles + BESIDE_MIDDLE * step
            beside = _sample(command, beside_middles, tendons)
            _warn_of_changes_within_steps(rows, beside, middles, step)
        return rows.reshape(samples, per_sample, tendons)
    # rows that are not alike are refused below, by name
    if isinstance(command, np.ndarray):
        kind = None
    else:
        kind = object
    array = np.asarray(command, dtype=kind)
    if array.ndim == 1:
        constant = checked_array("command", command, (tendons,))
        return np.tile(constant, (samples, per_sample, 1))
    table = checked_array("command", command, (samples, tendons))
    return np.repeat(table[:, None], per_sample, axis=1)


def _warn_of_changes_within_steps(rows: Array, beside: Array, middles: Array, step: float) -> None:
    """Warns where a command changes within steps otherwise than from step to step.

    Args:
        rows: commands (steps, n_a) in the middles of the steps.
        beside: commands (steps, n_a) BESIDE_MIDDLE of a step later.
        middles: times (steps,) [s].
        step: [s].
    """
    change = np.abs(beside - rows)
    from_step_to_step = BESIDE_MIDDLE * np.gradient(rows, axis=0)
    # neither constant over the step nor on the line through its neighbours
    deviation = beside - rows - from_step_to_step
    off_line = np.abs(deviation)
    missed = np.minimum(change, off_line).max(axis=1)
    largest_range = np.ptp(rows, axis=0).max()
    if missed.max() > UNRESOLVED * largest_range:
        place = middles[np.argmax(missed)]
        text = (
            f"command(t) changes within integrator steps of {step:g} s, over which it is held,"
            f" at {place:.6g} s: use a shorter integrator.step; jumps belong to borders of steps"
        )
        warnings.warn(text, CommandWarning, stacklevel=4)


def _sample(command: Callable[[float], ArrayLike], times: Array, size: int) -> Array:
    """The function at all times (m,): (m, size).

    An error names the time.
    """
    rows = list[Array]()
    for time in times:
        name = f"command({time:.6g})"
        row = checked_array(name, command(time), (size,))
        rows.append(row)
    return np.array(rows).reshape(-1, size)
