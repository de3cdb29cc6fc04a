"""Linear map of a held period: extrapolated linearly implicit Euler with the matrices of one
evaluation, forward and transposed.

Changes (dq, dv) of coordinates and rates and df of held forces go over a step of length h to

    v' = A^-1 (M dv - h G dq + h df),    q' = dq + h v',    A = M + h D + h^2 G,

and over a period by equal steps, extrapolated as the integrator's: T = 2 T(h/2) - T(h). The factor
of A makes the columns of its Jacobian, and its adjoint, which takes cotangents of (q', v') to those
of (dq, dv, df). Left out is how M, D, G and B change along the motion.
"""

from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import (
    copy,
    copy_matrix,
    product,
    solve_again,
    solve_symmetric,
    total,
)
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.advance import Record, advance
from soft_tendon_env.mechanics.motion.extrapolation import evaluate_force
from soft_tendon_env.mechanics.motion.implicit_euler import rate_change, start_matrices
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.mechanics.terms.command_filter import command_at, receive
from soft_tendon_env.mechanics.terms.evaluate import copy_tip
from soft_tendon_env.mechanics.terms.tendons import actuation_matrix
from soft_tendon_env.mechanics.terms.transmission import add_tendon_matrices
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import sizes_of, zeros


@kernel
def matrices_of_motion(arm, method, scratch):
    """M, D and G of the last evaluation into scratch.first, with elastic tendons and those that
    rub, without M for quasi-static motion."""
    start_matrices(arm, scratch)
    add_tendon_matrices(arm, scratch.work, scratch.first.damping, scratch.first.stiffness)
    if not method.with_inertia:
        scratch.first.mass[:, :] = 0.0


@kernel
def transposed_step(balance, h, scratch, q, v, impulse):
    """Cotangents q, v (n) of the end of a step, whose A is factored, to those of its beginning, in
    place, and of forces, impulse (n)."""
    n = q.size
    for i in range(n):
        impulse[i] = h * (v[i] + h * q[i])
    solve_again(scratch.system, n, impulse)
    for i in range(n):
        v[i] = product(balance.mass[i], impulse) / h
        for j in range(n):
            q[j] -= impulse[i] * balance.stiffness[i, j]


@kernel
def transposed_map(balance, period, scratch, q, v, impulse):
    """Cotangents q, v (n) of a period's end to those of its beginning, in place, and of the forces
    in its halves, impulse (2, n); a status: NOT_POSITIVE where A is not positive definite.
    Overwrites the linear system and the error estimates of the scratch."""
    whole_q, whole_v, whole = scratch.error_q, scratch.error_v, scratch.q
    copy(q, whole_q)
    copy(v, whole_v)
    status = rate_change(True, balance, 0.5 * period, scratch)
    transposed_step(balance, 0.5 * period, scratch, q, v, impulse[1])
    transposed_step(balance, 0.5 * period, scratch, q, v, impulse[0])
    if status == OK:
        status = rate_change(True, balance, period, scratch)
    transposed_step(balance, period, scratch, whole_q, whole_v, whole)
    for i in range(q.size):
        q[i] = 2.0 * q[i] - whole_q[i]
        v[i] = 2.0 * v[i] - whole_v[i]
        for half in range(2):
            impulse[half, i] = 2.0 * impulse[half, i] - 0.5 * whole[i]
    return status


class Plan(Struct):
    """Arrays of a rollout over N periods, its outcome first: n coordinates, n_a tendons, k forces,
    those of the tendons first. The 2 n + k columns of the matrices are derivatives by (q, v,
    forces)."""

    q: Annotated[np.ndarray, "N + 1", "n"]  # where every period begins, and the last one ends
    q_dot: Annotated[np.ndarray, "N + 1", "n"]
    state: Annotated[np.ndarray, "N + 1", "states"]  # of the effects
    tip_pose: Annotated[np.ndarray, "N + 1", "4", "4"]
    tip_jacobian: Annotated[np.ndarray, "N + 1", "6", "n"]
    tip_bias: Annotated[np.ndarray, "6"]  # of the last one
    jacobian: Annotated[np.ndarray, "N", "2 x n", "2 n + k"]  # of (q', v')
    command: Annotated[np.ndarray, "N", "parts", "n_a"]  # that is played
    duration: Annotated[np.ndarray, "parts"]  # [s] of the parts of a period
    forces: Annotated[
        np.ndarray, "n", "k"
    ]  # B at the beginning of a period and what was asked for besides
    system: Annotated[np.ndarray, "n", "n"]  # A, then its factor
    solved: Annotated[np.ndarray, "n", "2 n + k"]  # A^-1 [-h G | M | h forces]
    moved: Annotated[
        np.ndarray, "n", "2 n + k"
    ]  # coordinates after a step by those before the first
    rates: Annotated[np.ndarray, "n", "2 n + k"]  # likewise their rates
    ahead: Annotated[np.ndarray, "n", "2 n + k"]  # likewise the rates a step later


def make_plan(arm: Arm, periods: int, parts: int, forces: np.ndarray) -> Plan:
    """Zeroed Plan for an arm, with forces (n, k - n_a) besides those of the tendons."""
    n_a, inputs = arm.tendons.size, arm.tendons.size + forces.shape[1]
    sizes = {
        "N": periods,
        "N + 1": periods + 1,
        "parts": parts,
        "k": inputs,
        "2 n + k": 2 * arm.strain.size + inputs,
    }
    plan = zeros(Plan, {**sizes_of(arm), **sizes})
    plan.forces[:, n_a:] = forces
    return plan


@kernel
def add_jacobian(balance, h, count, share, plan, out):
    """Adds a share of the Jacobian (2 n, 2 n + k) of `count` steps of length h by (q, v, forces) to
    out."""
    n, inputs = plan.forces.shape
    solved, moved, rates, ahead, stiffness, mass = (
        plan.solved,
        plan.moved,
        plan.rates,
        plan.ahead,
        balance.stiffness,
        balance.mass,
    )
    for i in range(n):
        for j in range(n):
            plan.system[i, j] = mass[i, j] + h * (balance.damping[i, j] + h * stiffness[i, j])
            solved[i, j], solved[i, n + j] = -h * stiffness[i, j], mass[i, j]
        for j in range(inputs):
            solved[i, 2 * n + j] = h * plan.forces[i, j]
    solve_symmetric(plan.system, solved)
    copy_matrix(solved, rates)
    for step in range(count):
        if step > 0:
            for i in range(n):
                for k in range(2 * n + inputs):
                    ahead[i, k] = solved[i, k] if k >= 2 * n else 0.0
                for j in range(n):
                    by_q, by_v = solved[i, j], solved[i, n + j]
                    for k in range(2 * n + inputs):
                        ahead[i, k] += by_q * moved[j, k] + by_v * rates[j, k]
            copy_matrix(ahead, rates)
        for i in range(n):
            for k in range(2 * n + inputs):
                before = moved[i, k] if step > 0 else 1.0 if k == i else 0.0
                moved[i, k] = before + h * rates[i, k]
    for i in range(n):
        for k in range(2 * n + inputs):
            out[i, k] += share * moved[i, k]
            out[n + i, k] += share * rates[i, k]


@kernel
def linearised_rollout(arm, scheme, motion, steps, scratch, plan):
    """Plays plan.command from the motion, in place, and fills the plan with what happens and the
    Jacobians by `steps` steps a period. Returns a status, and the period that failed or their
    number."""
    method, step, none = (
        scheme.method,
        scheme.control.step,
        Record(plan.q[:0], plan.q_dot[:0], plan.tip_pose[:0]),
    )
    periods, length = plan.command.shape[0], total(plan.duration)
    for k in range(periods + 1):
        command, clock = (
            plan.command[k, 0] if k < periods else plan.command[periods - 1, -1],
            motion.clock[0],
        )
        copy(motion.xi, scratch.work.xi)
        receive(arm.effects, command, False, clock, motion.state, scratch.acting, scratch.until)
        u = command_at(arm.effects, scratch.acting, motion.state, 0.0, scratch.command)
        status = evaluate_force(
            arm, method, u, motion.q, motion.q_dot, motion.state, clock, scratch
        )
        if status != OK:
            return status, k
        copy(motion.q, plan.q[k])
        copy(motion.q_dot, plan.q_dot[k])
        copy(motion.state, plan.state[k])
        copy_tip(scratch.work, plan.tip_pose[k], plan.tip_jacobian[k], plan.tip_bias)
        if k < periods:
            matrices_of_motion(arm, method, scratch)
            actuation_matrix(arm, scratch.work, plan.forces)
            plan.jacobian[k] = 0.0
            add_jacobian(
                scratch.first, 0.5 * length / steps, 2 * steps, 2.0, plan, plan.jacobian[k]
            )
            add_jacobian(scratch.first, length / steps, steps, -1.0, plan, plan.jacobian[k])
            done = advance(arm, scheme, plan.command[k], plan.duration, motion, step, scratch, none)
            if done.status != OK:
                return done.status, k
            step = done.step
    return OK, periods
