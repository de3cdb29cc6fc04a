"""Time steps of a scene as the kernels take them: integration method, control of step size, and the
commands held over each."""

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

MOST_STEPS = 2 * 10**6  # of one call, whose commands and samples are kept
# estimated error, as displacement over the rod's length, that a step of fixed size may have
UNSTABLE = 0.05
STRAIN_SHARE, LOOSEST_STRAIN = (
    2.0,
    3e-6,
)  # tolerance of the strain's Newton, as a share of the step's over the rod's length, and the most
BESIDE_MIDDLE, UNRESOLVED = 0.5 / np.sqrt(3.0), 0.05
"""Place in a step from its middle, a Gauss point that no period in steps hits, where a function of
time is looked at besides; share of its range that it may change there otherwise than from step to
step."""
RESOLVED = (
    0.3  # [rad], phase of the slowest vibration that one step of a linearised motion may cover
)
Command = ArrayLike | Callable[[float], ArrayLike]


def cause_of(code: int, model: Model, control: Control) -> str:
    """The message of a status, which says the tolerance that could not be met."""
    if code != status.INACCURATE or not control.adaptive:
        return status.MESSAGES[code]
    settings = f"steps of {control.smallest:.2g} s, {model.scene.integrator.max_halvings} halvings"
    return (
        f"the estimated error is above integrator.tolerance, {control.tolerance:g} m, even with"
        f" {settings}: allow more of either"
    )


def step_method(model: Model) -> Extrapolated:
    """Integration method of the scene, as the kernels take it."""
    integrator, columns = model.scene.integrator, extrapolation_columns(model.scene)
    least, strain, has_inertia = columns, STEP_TOLERANCE, not integrator.quasi_static
    if integrator.tolerance is not None:
        least, strain = (
            2,
            min(
                max(STRAIN_SHARE * integrator.tolerance / model.length, STEP_TOLERANCE),
                LOOSEST_STRAIN,
            ),
        )
    return Extrapolated(
        columns, least, has_inertia, least < columns and has_inertia, strain
    )  # without inertia D is in the place of M


@lru_cache(maxsize=8)
def step_control(model: Model, duration: float) -> Control:
    """Step control of the scene over `duration` [s]: equal steps of at most the scene's, tolerance,
    smallest step."""
    integrator = model.scene.integrator
    step = duration / np.ceil(duration / integrator.step * (1.0 - 1e-9))
    adaptive, horizon = (
        integrator.tolerance is not None,
        0.0 if integrator.quasi_static else integrator.step,
    )
    tolerance = UNSTABLE * model.length if integrator.tolerance is None else integrator.tolerance
    return Control(
        step, tolerance, adaptive, smallest=step * 0.5**integrator.max_halvings, horizon=horizon
    )


def step_count(duration: float, control: Control) -> int:
    """Number of integrator steps of a duration [s]. Raises ValueError where one call would have to
    keep too many samples and commands."""
    if duration > (most := MOST_STEPS * control.step):
        raise ValueError(
            f"duration should be at most {most:g} s in one call, not {duration:g} s: go on from the"
            " last state"
        )
    return round(duration / control.step)


@lru_cache(maxsize=8)
def linear_rate(model: Model) -> float:
    """Steps per second in which a linearised motion resolves the slowest vibration of the bare arm,
    RESOLVED of its phase in each."""
    still = np.zeros(model.coordinate_count)
    terms = model.terms(still, still)
    return (
        float(np.sqrt(np.linalg.eigvals(np.linalg.solve(terms.mass, terms.stiffness)).real.min()))
        / RESOLVED
    )


class CommandWarning(UserWarning):
    """A command that is a function of time changes faster than integrator steps follow."""


def command_table(
    model: Model, command: Command, start: float, samples: int, per_sample: int, step: float
) -> Array:
    """Commands over every integrator step: (samples, per_sample, n_a). Warns where a function of
    time changes faster than steps follow."""
    shape = (samples, per_sample, model.tendon_count)
    if not callable(command):
        kind = (
            None if isinstance(command, np.ndarray) else object
        )  # rows that are not alike are refused below, by name
        if np.asarray(command, dtype=kind).ndim == 1:
            return np.tile(checked_array("command", command, shape[2:]), (samples, per_sample, 1))
        return np.repeat(
            checked_array("command", command, (samples, model.tendon_count))[:, None],
            per_sample,
            axis=1,
        )
    middles: Array = start + step * (np.arange(samples * per_sample, dtype=np.float64) + 0.5)
    table = _sample(command, middles, model.tendon_count)
    if len(table) > 1:
        inside = _sample(command, middles + BESIDE_MIDDLE * step, model.tendon_count) - table
        missed = np.minimum(
            np.abs(inside), np.abs(inside - BESIDE_MIDDLE * np.gradient(table, axis=0))
        ).max(axis=1)
        if missed.max() > UNRESOLVED * np.ptp(table, axis=0).max():
            text = (
                f"command(t) changes within integrator steps of {step:g} s, over which it is held,"
                f" at {middles[np.argmax(missed)]:.6g} s"
            )
            warnings.warn(
                f"{text}: use a shorter integrator.step; jumps belong to borders of steps",
                CommandWarning,
                stacklevel=3,
            )
    return table.reshape(shape)


def _sample(command: Callable[[float], ArrayLike], times: Array, size: int) -> Array:
    """The function at all times (m,): (m, size). An error names the time."""
    return np.array(
        [checked_array(f"command({time:.6g})", command(time), (size,)) for time in times]
    ).reshape(-1, size)
