"""Linear map of a held period: extrapolated linearly implicit Euler with the matrices of one evaluation, forward and transposed.

Changes (dq, dv) of coordinates and rates and df of held forces go over a step of length h to

    v' = A^-1 (M dv - h G dq + h df),    q' = dq + h v',    A = M + h D + h^2 G,

and over a period by equal steps, extrapolated as the integrator's: T = 2 T(h/2) - T(h). The factor of A makes the step itself, and the
adjoint, which takes cotangents of (q', v') to those of (dq, dv, df). The rows of the Jacobian are the adjoint of unit cotangents. Left out
is how M, D, G and B change along the motion.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, factorise, solve_factored, total
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.motion.advance import Record, advance
from soft_tendon_env.mechanics.motion.implicit_euler import linear_matrices
from soft_tendon_env.mechanics.motion.stages import evaluate_force
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at, receive
from soft_tendon_env.mechanics.terms.evaluate import copy_tip
from soft_tendon_env.mechanics.terms.external_forces import add_matrix
from soft_tendon_env.mechanics.terms.tendons import actuation_matrix
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of


class PeriodMap(Struct):
    """Factor of A, and m cotangents that go back through steps, of n coordinates."""

    system: np.ndarray  # (n, n) A, then its factor
    q: np.ndarray  # (n, m) cotangents of q' and v', then those of dq and dv
    v: np.ndarray  # (n, m)
    impulse: np.ndarray  # (n, m) those of df, h A^-1 (v + h q)
    total: np.ndarray  # (n, m) sum of these over the steps


def make_period_map(coordinates: int, cotangents: int) -> PeriodMap:
    """Zeroed PeriodMap for so many coordinates and cotangents."""
    return PeriodMap(**zeros_of(((coordinates, coordinates), "system"), ((coordinates, cotangents), "q v impulse total")))


@kernel
def step_matrix(mass, damping, stiffness, h, out):
    """A = M + h D + h^2 G of a step of length h, out (n, n)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = mass[i, j] + h * (damping[i, j] + h * stiffness[i, j])


@kernel
def matrices_of_motion(arm, method, scratch):
    """M, D and G of the last evaluation into scratch.first, without M for quasi-static motion."""
    linear_matrices(arm, scratch)
    if not method.with_inertia:
        scratch.first.mass[:, :] = 0.0


@kernel
def factorise_step(balance, h, own):
    """Factors A of a step of length h; whether it is positive definite."""
    step_matrix(balance.mass, balance.damping, balance.stiffness, h, own.system)
    return factorise(own.system)


@kernel
def transposed_step(balance, h, own):
    """Cotangents own.q, own.v of the end of a step, whose A is factored, to those of its beginning, and of forces, own.impulse."""
    q, v, impulse = own.q, own.v, own.impulse
    n, m = q.shape
    for i in range(n):
        for k in range(m):
            impulse[i, k] = h * (v[i, k] + h * q[i, k])
            v[i, k] = 0.0
    solve_factored(own.system, impulse)
    for i in range(n):
        for j in range(n):
            inertia, stiffness = balance.mass[i, j] / h, balance.stiffness[i, j]
            for k in range(m):
                v[i, k] += inertia * impulse[j, k]
                q[i, k] -= stiffness * impulse[j, k]


@kernel
def transposed_map(balance, period, own, q, v, impulse):
    """Cotangents q, v (n) of a period's end to those of its beginning, in place, and of the forces in its halves, impulse (2, n); a status:
    NOT_POSITIVE where A is not positive definite."""
    n = q.size
    for i in range(n):
        own.q[i, 0], own.v[i, 0] = q[i], v[i]
    fine = factorise_step(balance, 0.5 * period, own)
    for half in range(1, -1, -1):
        transposed_step(balance, 0.5 * period, own)
        for i in range(n):
            impulse[half, i] = 2.0 * own.impulse[i, 0]
    for i in range(n):
        own.q[i, 0], q[i] = q[i], 2.0 * own.q[i, 0]
        own.v[i, 0], v[i] = v[i], 2.0 * own.v[i, 0]
    coarse = factorise_step(balance, period, own)
    transposed_step(balance, period, own)
    for i in range(n):
        q[i] -= own.q[i, 0]
        v[i] -= own.v[i, 0]
        for half in range(2):
            impulse[half, i] -= 0.5 * own.impulse[i, 0]
    return OK if fine and coarse else NOT_POSITIVE


@kernel
def add_jacobian(balance, h, count, share, forces, own, out):
    """Adds a share of the Jacobian (2 n, 2 n + k) of `count` steps of length h by (q, v) and by factors of the columns of forces (n, k).

    Its rows of v' go back from unit cotangents. Those of q' are sums of them over the steps, as q' is q + h sum v'.
    """
    n = own.q.shape[0]
    factorise_step(balance, h, own)
    own.q[:, :] = 0.0
    own.v[:, :] = 0.0
    own.total[:, :] = 0.0
    for i in range(n):
        own.v[i, i] = 1.0
        out[i, i] += share
    for _ in range(count):
        transposed_step(balance, h, own)
        add_matrix(own.impulse, own.total)
        add_rows(share * h, forces, own, out[:n])
    add_rows(share, forces, own, out[n:])


@kernel
def add_rows(share, forces, own, rows):
    """Adds a share of the cotangents so far to rows (n, 2 n + k) of a Jacobian."""
    n = rows.shape[0]
    for i in range(n):
        for j in range(n):
            rows[i, j] += share * own.q[j, i]
            rows[i, n + j] += share * own.v[j, i]
            pull = share * own.total[j, i]
            for k in range(forces.shape[1]):
                rows[i, 2 * n + k] += pull * forces[j, k]


class Plan(Struct):
    """Arrays of a rollout over N periods, its outcome first: n coordinates, n_a tendons, k forces, those of the tendons first."""

    q: np.ndarray  # (N + 1, n) where every period begins, and the last one ends
    q_dot: np.ndarray  # (N + 1, n)
    state: np.ndarray  # (N + 1, states) of the effects
    tip_pose: np.ndarray  # (N + 1, 4, 4)
    tip_jacobian: np.ndarray  # (N + 1, 6, n)
    tip_bias: np.ndarray  # (6) of the last one
    jacobian: np.ndarray  # (N, 2 n, 2 n + k) of (q', v') by (q, v, forces)
    command: np.ndarray  # (N, parts, n_a) that is played
    duration: FloatVector  # (parts) [s] of the parts of a period
    forces: np.ndarray  # (n, k), B at the beginning of a period and what was asked for besides
    map: PeriodMap


def make_plan(arm: Arm, periods: int, parts: int, forces: np.ndarray) -> Plan:
    """Zeroed Plan for an arm, with forces (n, k - n_a) besides those of the tendons."""
    n, n_a, begins = arm.strain.size, arm.tendons.size, periods + 1
    inputs = n_a + forces.shape[1]
    motion = (((begins, n), "q q_dot"), ((begins, arm.effects.state.size), "state"))
    tip = (((begins, 4, 4), "tip_pose"), ((begins, 6, n), "tip_jacobian"), ((6,), "tip_bias"))
    played = (((periods, parts, n_a), "command"), ((parts,), "duration"), ((n, inputs), "forces"))
    plan = Plan(map=make_period_map(n, n), **zeros_of(*motion, *tip, *played, ((periods, 2 * n, 2 * n + inputs), "jacobian")))
    plan.forces[:, n_a:] = forces
    return plan


class Tip(NamedTuple):
    """Tip of an arm, as copy_tip() writes it."""

    tip_pose: np.ndarray
    tip_jacobian: np.ndarray
    tip_bias: np.ndarray


@kernel
def linearised_rollout(arm, scheme, motion, steps, scratch, plan):
    """Play plan.command from the motion, in place, and fill the plan with what happens and with the Jacobians by `steps` steps a period.

    Returns a status, and the period that failed or their number.
    """
    method, step, none = scheme.method, scheme.control.step, Record(plan.q[:0], plan.q_dot[:0], plan.tip_pose[:0])
    periods, length = plan.command.shape[0], total(plan.duration)
    for k in range(periods + 1):
        command, clock = plan.command[k, 0] if k < periods else plan.command[periods - 1, -1], motion.clock[0]
        copy(motion.xi, scratch.work.xi)
        receive(arm.effects, command, False, clock, motion.state, scratch.acting, scratch.until)
        u = command_at(arm.effects, scratch.acting, motion.state, 0.0, scratch.command)
        status = evaluate_force(arm, method, u, motion.q, motion.q_dot, motion.state, clock, scratch)
        if status != OK:
            return status, k
        copy(motion.q, plan.q[k])
        copy(motion.q_dot, plan.q_dot[k])
        copy(motion.state, plan.state[k])
        copy_tip(scratch.work, Tip(plan.tip_pose[k], plan.tip_jacobian[k], plan.tip_bias))
        if k < periods:
            matrices_of_motion(arm, method, scratch)
            actuation_matrix(arm.rod, arm.tendons, arm.strain, scratch.work, plan.forces)
            plan.jacobian[k] = 0.0
            add_jacobian(scratch.first, 0.5 * length / steps, 2 * steps, 2.0, plan.forces, plan.map, plan.jacobian[k])
            add_jacobian(scratch.first, length / steps, steps, -1.0, plan.forces, plan.map, plan.jacobian[k])
            done = advance(arm, scheme, plan.command[k], plan.duration, motion, step, scratch, none)
            if done.status != OK:
                return done.status, k
            step = done.step
    return OK, periods
