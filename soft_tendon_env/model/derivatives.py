"""Derivatives of a period by state and command, by central differences."""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion.advance import Scheme
from soft_tendon_env.mechanics.motion.batch import make_batch, step_rows
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.mechanics.motion.tape import make_tape
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.model.step_control import step_control, step_method
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.types import Array

SHARE, TOUCHING = 1e-4, 1e-2  # steps as shares of units; their factor among obstacles
RATE, LEAST_STATE = 3.0, 1e-3  # unit of a rate, in those of its coordinate; least unit of a state
STRAIN, SPARE, JUMP = 1e-12, 2.0, 1e3  # tolerance of the strain's Newton; factor of that of steps; ratio of sides of which one jumps


class Linearization(NamedTuple):
    """The end of a period and its derivatives, with s = 2 n + m numbers of a state: n coordinates, their rates, m internal states.

    Columns are by the numbers of the state before, then by the n_a commands; angular components before linear ones.
    """

    next: State
    state: Array  # (s, s) of the next state by the state
    command: Array  # (s, n_a) of the next state by the command
    tip: Array  # (6, s + n_a) body twist of the next tip pose [rad, m]


def ends(model: Model, start: Motion, taken: Array, inputs: Array) -> tuple[Array, Array]:
    """States (copies, s) and tip poses (copies, 4, 4) after a period, inf where it fails. Raises LinAlgError.

    inputs (copies, s + n_a): numbers of the state where it begins, and commands; taken (steps, 2): length [s] and columns of every step,
    the same for all copies, since an order that follows their errors would jump.
    """
    arm, n, count = model.arm, model.coordinate_count, len(inputs)
    batch = make_batch(arm, model.grid.places(np.zeros(0), np.zeros(0)), start, 0.0, count)
    rows, failed = batch.rows, np.zeros(count, dtype=bool)
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
    states, poses = np.hstack([rows.q, rows.q_dot, rows.state]), batch.reading.tip_pose
    states[failed], poses[failed] = np.inf, np.inf
    return states, poses


@np.errstate(invalid="ignore")
def period_derivatives(model: Model, start: Motion, inputs: Array, taken: Array, following: State) -> Linearization:
    """Linearization of a period that leads from inputs to a state by the steps taken, see `ends`. Raises LinAlgError."""
    scale, effects = model.coordinate_scale(), model.scene.effects
    largest = np.abs(effects.command_limits(model.discretisation.tension_limits)).max(axis=1)
    step = SHARE * np.concatenate([scale, RATE * scale, np.maximum(np.abs(start.state), LEAST_STATE), largest])
    step *= TOUCHING if any(effect.is_contact for effect in effects.chosen().values()) else 1.0
    values, slopes = ends(model, start, taken, np.vstack([inputs, inputs + np.diag(step), inputs - np.diag(step)])), []
    for value in values:
        right, left = value[1 : step.size + 1] - value[0], value[0] - value[step.size + 1 :]
        jumps = [(abs(a) > JUMP * abs(b)) & ((b != 0.0) | np.isinf(a)) for a, b in ((right, left), (left, right))]  # not from rest: a kink
        slopes.append(np.moveaxis(np.select(jumps, [left, right], 0.5 * (left + right)), 0, -1) / step)
    by, pose_slopes = slopes
    if not np.isfinite(by).all():
        raise np.linalg.LinAlgError("the motion has no derivative: on either side of it a step fails")
    return Linearization(following, by[:, : len(by)], by[:, len(by) :], _twists(values[1][0], pose_slopes))


def _twists(pose: Array, slopes: Array) -> Array:
    """Body twists (6, m) of a pose (4, 4) with derivatives (4, 4, m)."""
    turned = np.einsum("ji,jkm->ikm", pose[:3, :3], slopes[:3])
    return np.stack([turned[2, 1], turned[0, 2], turned[1, 0], *turned[:, 3]])
