"""Rollout of a plan with its linearisation: the motion over periods by the integrator, and the Jacobian of every period by implicit steps.

Changes (dq, dv) of coordinates and rates and df of held forces go over a period by linearly implicit Euler with the matrices of its start,

    v' = A^-1 (M dv - h G dq + h df),    q' = dq + h v',    A = M + h D + h^2 G,

in `count` steps, extrapolated as the integrator's: T = 2 T(h/2) - T(h). Left out is how M, D, G and B change along the motion.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import add_product, copy, copy_matrix, solve_columns, total
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.advance import Record, advance
from soft_tendon_env.mechanics.motion.implicit_euler import linear_matrices
from soft_tendon_env.mechanics.motion.stages import evaluate_force
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.terms.command_filter import command_at, receive
from soft_tendon_env.mechanics.terms.evaluate import copy_tip
from soft_tendon_env.mechanics.terms.tendons import actuation_matrix
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of


class Plan(Struct):
    """Arrays of a rollout over N periods, its outcome first: n coordinates, n_a tendons, k forces, those of the tendons first."""

    q: np.ndarray  # (N + 1, n) where every period begins, and the last one ends
    q_dot: np.ndarray  # (N + 1, n)
    state: np.ndarray  # (N + 1, states) of the effects
    tip_pose: np.ndarray  # (N + 1, 4, 4)
    tip_jacobian: np.ndarray  # (N + 1, 6, n)
    tip_bias: np.ndarray  # (N + 1, 6)
    jacobian: np.ndarray  # (N, 2 n, 2 n + k) of (q', v') by (q, v, forces)
    command: np.ndarray  # (N, parts, n_a) that is played
    duration: FloatVector  # (parts) [s] of the parts of a period
    forces: np.ndarray  # (n, k), B at the beginning of a period and what was asked for besides
    system: np.ndarray  # (n, n) A
    solved: np.ndarray  # (n, 2 n + k) A^-1 [-h G | M | h forces]
    moved: np.ndarray  # (n, 2 n + k) coordinates after a step by (q, v, forces) before the first
    rates: np.ndarray  # (n, 2 n + k) likewise their rates
    ahead: np.ndarray  # (n, 2 n + k) likewise the rates a step later


def make_plan(arm: Arm, periods: int, parts: int, forces: np.ndarray) -> Plan:
    """Zeroed Plan for an arm, with forces (n, k - n_a) besides those of the tendons."""
    n, n_a, states = arm.strain.size, arm.tendons.size, arm.effects.state.size
    inputs = n_a + forces.shape[1]
    plan = Plan(
        **zeros_of(
            ((periods + 1, n), "q q_dot"),
            ((periods + 1, states), "state"),
            ((periods + 1, 4, 4), "tip_pose"),
            ((periods + 1, 6, n), "tip_jacobian"),
            ((periods + 1, 6), "tip_bias"),
            ((periods, 2 * n, 2 * n + inputs), "jacobian"),
            ((periods, parts, n_a), "command"),
            ((parts,), "duration"),
            ((n, inputs), "forces"),
            ((n, n), "system"),
            ((n, 2 * n + inputs), "solved moved rates ahead"),
        )
    )
    plan.forces[:, n_a:] = forces
    return plan


@kernel
def one_step(balance, with_inertia, h, plan):
    """A step of length h of changes in coordinates, rates and forces: coordinates and rates after it, into plan.moved, plan.rates."""
    n, inputs = plan.forces.shape
    system, solved, moved, share = plan.system, plan.solved, plan.moved, 1.0 if with_inertia else 0.0
    for i in range(n):
        for j in range(n):
            m, g = share * balance.mass[i, j], balance.stiffness[i, j]
            system[i, j] = m + h * (balance.damping[i, j] + h * g)
            solved[i, j] = -h * g
            solved[i, n + j] = m
        for j in range(inputs):
            solved[i, 2 * n + j] = h * plan.forces[i, j]
    solve_columns(system, solved)
    copy_matrix(solved, plan.rates)
    for i in range(n):
        for j in range(2 * n + inputs):
            moved[i, j] = h * solved[i, j]
        moved[i, i] += 1.0


@kernel
def next_step(h, plan):
    """A further step of length h after one_step() of the same length."""
    n, inputs = plan.forces.shape
    solved, moved, rates, ahead = plan.solved, plan.moved, plan.rates, plan.ahead
    for i in range(n):
        for j in range(2 * n + inputs):
            ahead[i, j] = solved[i, j] if j >= 2 * n else 0.0
    add_product(solved[:, :n], moved, ahead)
    add_product(solved[:, n : 2 * n], rates, ahead)
    copy_matrix(ahead, rates)
    for i in range(n):
        for j in range(2 * n + inputs):
            moved[i, j] += h * ahead[i, j]


@kernel
def add_steps(balance, with_inertia, period, count, share, plan, out):
    """Adds a share of the Jacobian (2 n, 2 n + k) of `count` equal steps over a period to `out`."""
    h, n = period / count, plan.forces.shape[0]
    one_step(balance, with_inertia, h, plan)
    for _ in range(count - 1):
        next_step(h, plan)
    for i in range(n):
        for j in range(out.shape[1]):
            out[i, j] += share * plan.moved[i, j]
            out[n + i, j] += share * plan.rates[i, j]


class Tip(NamedTuple):
    """Tip of an arm, as copy_tip() writes it."""

    tip_pose: np.ndarray
    tip_jacobian: np.ndarray
    tip_bias: np.ndarray


@kernel
def begin_period(arm, method, command, motion, k, scratch, plan):
    """Evaluates the motion under a command (n_a) and keeps it as the beginning of the k-th period; a status."""
    copy(motion.xi, scratch.work.xi)
    receive(arm.effects, command, False, motion.clock[0], motion.state, scratch.acting, scratch.until)
    u = command_at(arm.effects, scratch.acting, motion.state, 0.0, scratch.command)
    status = evaluate_force(arm, method, u, motion.q, motion.q_dot, motion.state, motion.clock[0], scratch)
    if status == OK:
        copy(motion.q, plan.q[k])
        copy(motion.q_dot, plan.q_dot[k])
        copy(motion.state, plan.state[k])
        copy_tip(scratch.work, Tip(plan.tip_pose[k], plan.tip_jacobian[k], plan.tip_bias[k]))
    return status


@kernel
def linearised_rollout(arm, scheme, motion, steps, scratch, plan):
    """Play plan.command from the motion, in place, and fill the plan with what happens and with the Jacobians by `steps` steps a period.

    Returns a status, and the period that failed or their number.
    """
    method, step, none = scheme.method, scheme.control.step, Record(plan.q[:0], plan.q_dot[:0], plan.tip_pose[:0])
    periods, length = plan.command.shape[0], total(plan.duration)
    for k in range(periods):
        status = begin_period(arm, method, plan.command[k, 0], motion, k, scratch, plan)
        if status != OK:
            return status, k
        linear_matrices(arm, scratch)
        actuation_matrix(arm.rod, arm.tendons, arm.strain, scratch.work, plan.forces)
        plan.jacobian[k] = 0.0
        add_steps(scratch.first, method.with_inertia, length, 2 * steps, 2.0, plan, plan.jacobian[k])
        add_steps(scratch.first, method.with_inertia, length, steps, -1.0, plan, plan.jacobian[k])
        done = advance(arm, scheme, plan.command[k], plan.duration, motion, step, scratch, none)
        if done.status != OK:
            return done.status, k
        step = done.step
    return begin_period(arm, method, plan.command[periods - 1, -1], motion, periods, scratch, plan), periods
