"""Classical fourth-order Runge-Kutta step of (23), tension held over a step: explicit, for soft and slow rods."""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, row_stride, solve_positive_definite
from soft_tendon_env.mechanics.late_kernels import call_late
from soft_tendon_env.mechanics.motion.error_estimate import error_estimate
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE, Attempt, advance_effects, evaluate_force, predict_strain
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK

REACH = (0.0, 0.5, 0.5, 1.0)
WEIGHT = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
"""Places of the stages in a step, and their weights in its mean slopes."""


@kernel
def acceleration(scratch):
    """Acceleration q_ddot of the last evaluation, into scratch.delta."""
    n, stride = scratch.q.size, row_stride(scratch.q.size + 1)
    for i in range(n):
        for j in range(i, n):
            scratch.system[i * stride + j] = scratch.work.M[i, j]
        scratch.system[i * stride + n] = scratch.force[i]
    return OK if solve_positive_definite(scratch.system, n, scratch.delta) else NOT_POSITIVE


@kernel
def begin_stages(motion, scratch):
    """Puts scratch.q, scratch.v where the step begins, with nothing of the stages' mean slopes."""
    copy(motion.xi, scratch.work.xi)
    scratch.table_q[0, 0, :] = 0.0
    scratch.table_v[0, 0, :] = 0.0
    copy(motion.q, scratch.q)
    copy(motion.q_dot, scratch.v)


@kernel
def take_stage(arm, method, u, motion, step, stage, scratch):
    """One stage: its acceleration in scratch.delta, its share of the mean slopes, and the place of the next one; a status."""
    slope_q, slope_v = scratch.table_q[0, 0], scratch.table_v[0, 0]
    if stage > 0:
        predict_strain(arm.strain, scratch.q, scratch.q_last, scratch.work)
    time = motion.clock[0] + REACH[stage] * step
    status = evaluate_force(arm, method, u, scratch.q, scratch.v, motion.state, time, scratch)
    if status == OK:
        status = acceleration(scratch)
    if status != OK:
        return status
    weight, reach = WEIGHT[stage], REACH[min(stage + 1, 3)] * step
    for i in range(slope_q.size):
        velocity = scratch.v[i]
        slope_q[i] += weight * velocity
        slope_v[i] += weight * scratch.delta[i]
        scratch.q[i] = motion.q[i] + reach * velocity
        scratch.v[i] = motion.q_dot[i] + reach * scratch.delta[i]
    return OK


@kernel
def end_stages(arm, motion, step, scratch):
    """The end of a step whose stages have been taken, to scratch.q, scratch.v and scratch.state."""
    slope_q, slope_v = scratch.table_q[0, 0], scratch.table_v[0, 0]
    for i in range(slope_q.size):
        scratch.q[i] = motion.q[i] + step * slope_q[i]
        scratch.v[i] = motion.q_dot[i] + step * slope_v[i]
    copy(motion.state, scratch.state)
    if motion.state.size > 0:
        call_late(advance_effects, arm.effects.late, (arm, step, scratch))


@kernel
def runge_kutta_step(arm, method, u, motion, step, scratch):
    """Attempt one step of the classical fourth-order Runge-Kutta method, to scratch.q and scratch.v; its error is not estimated."""
    begin_stages(motion, scratch)
    for stage in range(4):
        status = take_stage(arm, method, u, motion, step, stage, scratch)
        if status != OK:
            return Attempt(status, 1, stage + 1, math.inf)
    end_stages(arm, motion, step, scratch)
    status, error = error_estimate(arm.rod, step, scratch)
    return Attempt(status, 1, 4, error)


class RungeKutta(NamedTuple):
    """Classical Runge-Kutta method of order 4."""

    columns: int = 1  # the size of the table that it borrows
    least: int = 1
    with_inertia: bool = True
    strain_tolerance: float = STEP_TOLERANCE
