"""Derivatives by central differences: of a period by state and command, of equilibria by numbers of the scene."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion.advance import Scheme
from soft_tendon_env.mechanics.motion.batch import make_batch, step_rows
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch, make_tape
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.step_control import step_control, step_method
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_parameters
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

SHARE, NUMBER_SHARE, TOUCHING = 1e-4, 1e-3, 1e-2  # steps as shares of units and of numbers' sizes; their factor among obstacles
RATE, LEAST_STATE, ZERO = 3.0, 1e-3, 1e-5  # unit of a rate, in those of its coordinate; least unit of a state; step of numbers that are 0
STRAIN, SPARE, JUMP = 1e-12, 2.0, 1e3  # tolerance of the strain's Newton; factor of that of steps; ratio of sides of which one jumps
SIDES = ({-1: -0.5, 1: 0.5}, {0: -1.5, 1: 2.0, 2: -0.5}, {0: 1.5, -1: -2.0, -2: 0.5})  # weights of second order: central, one-sided


class Linearization(NamedTuple):
    """The end of a period and its derivatives, with s = 2 n + m numbers of a state: n coordinates, their rates, m internal states.

    Columns are by the numbers of the state before, then by the n_a commands; angular components before linear ones.
    """

    next: State
    state: Array  # (s, s) of the next state by the state
    command: Array  # (s, n_a) of the next state by the command
    tip: Array  # (6, s + n_a) body twist of the next tip pose [rad, m]
    tip_twist: Array  # (6, s + n_a) of the next body twist of the tip [rad/s, m/s]
    tendon_length: Array  # (n_a, s + n_a) of the next lengths of the tendons [m]


class Derivatives(NamedTuple):
    """Derivatives of an equilibrium by p numbers of the scene, each in the unit of its key, see Parameter."""

    state: Array  # (n, p) of the coordinates
    tip: Array  # (6, p) body twist of the tip pose (angular, linear) [rad, m]
    tendon_length: Array  # (n_a, p) [m]


def ends(model: Model, start: Motion, taken: Array, inputs: Array) -> list[Array]:
    """States (copies, s), tip poses, tendon lengths and tip twists after a period, inf where it fails. Raises LinAlgError.

    inputs (copies, s + n_a): numbers of the state where it begins, and commands; taken (steps, 2): length [s] and columns of every step,
    the same for all copies, since an order that follows their own errors would jump.
    """
    arm, n, count = model.arm, model.coordinate_count, len(inputs)
    batch = make_batch(arm, model.grid.places(np.zeros(0), np.zeros(0)), start, 0.0, count)
    rows, read, failed = batch.rows, batch.reading, np.zeros(count, dtype=bool)
    rows.q[:], rows.q_dot[:], rows.state[:], commands = np.split(inputs, [n, 2 * n, 2 * n + start.state.size], axis=1)
    for row, q in enumerate(rows.q if rows.state.size else ()):  # a memory remembers the strain before a step
        with contextlib.suppress(StrainLimitError):
            rows.xi[row] = model.packed_strain(q)
    method, control = step_method(model)._replace(strain_tolerance=STRAIN), step_control(model, taken[:, 0].sum() or 1.0)
    control = control._replace(adaptive=False, tolerance=SPARE * control.tolerance)
    scratch, tape = make_scratch(arm, method.columns), make_tape(arm, 0, 0)
    for begins, (length, columns) in zip([True, *[False] * len(taken)], taken, strict=False):
        scheme = Scheme(method._replace(columns=int(columns), least=int(columns)), control, begins)
        step_rows(batch, scheme, np.flatnonzero(~failed), commands[:, None].copy(), np.full((count, 1), length), scratch, tape)
        failed |= batch.outcome.status != OK
    if failed[0]:
        raise np.linalg.LinAlgError(f"the motion has no derivative: {MESSAGES[batch.outcome.status[0]]}")
    found = np.hstack([rows.q, rows.q_dot, rows.state]), read.tip_pose, read.tendon_length, read.tip_twist
    return [np.where(failed.reshape(-1, *[1] * (own.ndim - 1)), np.inf, own) for own in found]


@np.errstate(invalid="ignore")
def linearized(model: Model, start: Motion, here: Array, taken: Array, following: State) -> Linearization:
    """Linearization of a period that leads from inputs to a state by the steps taken. Raises LinAlgError."""
    unit, command_unit, factor = _units(model)
    step = SHARE * factor * np.concatenate([unit, np.maximum(np.abs(start.state), LEAST_STATE), command_unit])
    found, slopes = ends(model, start, taken, np.vstack([here, here + np.diag(step), here - np.diag(step)])), []
    for value in found:
        right, left = value[1 : step.size + 1] - value[0], value[0] - value[step.size + 1 :]
        jumps = [(abs(a) > JUMP * abs(b)) & ((b != 0.0) | np.isinf(a)) for a, b in ((right, left), (left, right))]  # not from rest: a kink
        slopes.append(np.moveaxis(np.select(jumps, [left, right], 0.5 * (left + right)), 0, -1) / step)
    by, poses, lengths, twists = slopes
    if not np.isfinite(by).all():
        raise np.linalg.LinAlgError("the motion has no derivative: on either side of it a step fails")
    return Linearization(following, by[:, : len(by)], by[:, len(by) :], _twists(found[1][0], poses), twists, lengths)


def static_derivatives(model: Model, keys: Iterable[str], tension: ArrayLike) -> Derivatives:
    """Derivatives of the static equilibrium under tensions (n_a,) [N] by numbers of the scene: equilibria beside it are solved again.

    keys: dotted keys, see `scene_parameters`. A number is moved by a thousandth of its size, or by 1e-5 of its unit where it is zero; to
    one side where it ends, as Poisson's ratio at 0.5. The error is about 1e-6 of the largest entry. Raises ConfigurationError for keys,
    ValueError, TypeError, LinAlgError where the arm does not come to rest.
    """

    def rest(other: Model, guess: Array | None = None) -> tuple[Array, Array, Array]:
        found = static_equilibrium(other, tension, guess)
        if not found.converged:
            raise np.linalg.LinAlgError(f"there is no equilibrium to differentiate: {found.reason}")
        return found.q, found.tip_pose, other.tendon_lengths(found.q)

    here = rest(model)
    slopes = [np.zeros((*own.shape, 0)) for own in here]
    for parameter in scene_parameters(model.scene, keys):
        step = NUMBER_SHARE * _units(model)[2] * (1.0 if parameter.is_factor else parameter.size) or ZERO
        for weights in SIDES:
            try:
                others = [model.with_numbers(parameter.changes(parameter.value + k * step)) for k in weights]
                break
            except ConfigurationError:  # beyond a bound
                if weights is SIDES[-1]:
                    raise
        values = [(weight / step, rest(other, here[0])) for weight, other in zip(weights.values(), others, strict=True)]
        columns = (sum(weight * value[i] for weight, value in values) for i in range(3))
        slopes = [np.concatenate([own, np.asarray(column)[..., None]], axis=-1) for own, column in zip(slopes, columns, strict=True)]
    return Derivatives(slopes[0], _twists(here[1], slopes[1]), slopes[2])


def _twists(pose: Array, slopes: Array) -> Array:
    """Body twists (6, m) of a pose (4, 4) with derivatives (4, 4, m)."""
    turned = np.einsum("ji,jkm->ikm", pose[:3, :3], slopes[:3])
    return np.stack([turned[2, 1], turned[0, 2], turned[1, 0], *turned[:, 3]])


@lru_cache(maxsize=8)
def _units(model: Model) -> tuple[Array, Array, float]:
    """Units of coordinates and rates (2 n,), and of commands (n_a,), the largest that there may be; factor of steps for the scene."""
    limits, scale = np.array([tendon.tension_limits for tendon in model.scene.tendons]), model.coordinate_scale()
    factor = TOUCHING if any(effect.is_contact for effect in model.scene.effects.chosen().values()) else 1.0
    return np.concatenate([scale, RATE * scale]), np.abs(model.scene.effects.command_limits(limits)).max(axis=1), factor
