"""Time steps of a scene as the kernels take them: integration method, control of step size, and the commands held over each."""

import warnings
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion import status
from soft_tendon_env.mechanics.motion.advance import Control
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import extrapolation_columns
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.types import Array

UNSTABLE = 0.05  # estimated error, as displacement over the rod's length, that a step of fixed size may have
STRAIN_SHARE, LOOSEST_STRAIN = 2.0, 3e-6  # tolerance of the strain's Newton, as a share of the step's over the rod's length, and the most
BESIDE_MIDDLE, UNRESOLVED = 0.5 / np.sqrt(3.0), 0.05
"""Place in a step from its middle where a command that is a function of time is looked at besides, a Gauss point, which no period that fits
into steps hits; and the share of its range that it may change there otherwise than from step to step."""
RESOLVED = 0.3  # [rad], phase of the slowest vibration that one step of a linearised motion may cover
Command = ArrayLike | Callable[[float], ArrayLike]


def cause_of(code: int, model: Model, control: Control) -> str:
    """The message of a status, which says the tolerance that could not be met."""
    if code != status.INACCURATE or not control.adaptive:
        return status.MESSAGES[code]
    settings = f"steps of {control.smallest:.2g} s, {model.scene.integrator.max_halvings} halvings"
    return f"the estimated error is above integrator.tolerance, {control.tolerance:g} m, even with {settings}: allow more of either"


def step_method(model: Model) -> Extrapolated:
    """Integration method of the scene, as the kernels take it."""
    integrator, columns = model.scene.integrator, extrapolation_columns(model.scene)
    least, strain = columns, STEP_TOLERANCE
    if integrator.tolerance is not None:
        least, strain = 2, min(max(STRAIN_SHARE * integrator.tolerance / model.length, STEP_TOLERANCE), LOOSEST_STRAIN)
    freeze_jacobian = least < columns and not integrator.quasi_static  # without inertia D is in the place of M
    return Extrapolated(columns, least, not integrator.quasi_static, freeze_jacobian, strain)


def step_control(model: Model, duration: float) -> Control:
    """Step control of the scene over `duration` [s]: equal steps of at most the scene's, tolerance, smallest step."""
    integrator = model.scene.integrator
    step = duration / np.ceil(duration / integrator.step * (1.0 - 1e-9))
    adaptive, horizon = integrator.tolerance is not None, 0.0 if integrator.quasi_static else integrator.step
    tolerance = UNSTABLE * model.length if integrator.tolerance is None else integrator.tolerance
    return Control(step, tolerance, adaptive, smallest=step * 0.5**integrator.max_halvings, horizon=horizon)


@lru_cache(maxsize=8)
def slowest_vibration(model: Model) -> float:
    """Angular frequency [rad/s] of the slowest vibration of the bare arm about its stress-free shape."""
    still = np.zeros(model.coordinate_count)
    terms = model.terms(still, still)
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(terms.mass, terms.stiffness)).real.min()))


def linear_rate(model: Model) -> float:
    """Steps per second [1/s] in which a linearised motion resolves the slowest vibration."""
    return slowest_vibration(model) / RESOLVED


class CommandWarning(UserWarning):
    """A command that is a function of time changes faster than integrator steps follow."""


def command_table(model: Model, command: Command, start: float, samples: int, per_sample: int, step: float) -> Array:
    """Commands over every integrator step: (samples, per_sample, n_a). Warns where a function of time changes faster than steps follow."""
    shape = (samples, per_sample, model.tendon_count)
    if not callable(command):
        kind = None if isinstance(command, np.ndarray) else object  # rows that are not alike are refused below, by name
        if np.asarray(command, dtype=kind).ndim == 1:
            return np.tile(checked_array("command", command, shape[2:]), (samples, per_sample, 1))
        return np.repeat(checked_array("command", command, (samples, model.tendon_count))[:, None], per_sample, axis=1)
    middles: Array = start + step * (np.arange(samples * per_sample, dtype=np.float64) + 0.5)
    held = _sampled(command, middles, model.tendon_count)
    if len(held) > 1:
        inside = _sampled(command, middles + BESIDE_MIDDLE * step, model.tendon_count) - held
        missed = np.minimum(np.abs(inside), np.abs(inside - BESIDE_MIDDLE * np.gradient(held, axis=0))).max(axis=1)
        if missed.max() > UNRESOLVED * np.ptp(held, axis=0).max():
            text = f"command(t) changes within integrator steps of {step:g} s, over which it is held, at {middles[np.argmax(missed)]:.6g} s"
            warnings.warn(f"{text}: use a shorter integrator.step; jumps belong to borders of steps", CommandWarning, stacklevel=3)
    return held.reshape(shape)


def _sampled(command: Callable[[float], ArrayLike], times: Array, size: int) -> Array:
    """The function at all times (m,): (m, size). An error names the time."""
    return np.array([checked_array(f"command({time:.6g})", command(time), (size,)) for time in times]).reshape(-1, size)
