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
from soft_tendon_env.mechanics.terms.tendon_friction import find_shares, tendons_rub
from soft_tendon_env.mechanics.terms.tendons import actuation_matrix
from soft_tendon_env.mechanics.terms.transmission import add_tendon_matrices, tendons_transmit
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import sizes_of, zeros


@kernel
def matrices_of_motion(arm, method, scratch):
    """M, D and G of the last evaluation into scratch.first, with elastic tendons and those that
    rub, without M for quasi-static motion."""
    start_matrices(arm, scratch)
    work = scratch.work
    matrices = scratch.first.matrices
    if tendons_rub(arm):
        find_shares(arm, work.strain, work.tendons, work.friction)
    if tendons_transmit(arm):
        add_tendon_matrices(arm, work, scratch.first.borders, matrices.D, matrices.G)
    if not method.with_inertia:
        matrices.M[:, :] = 0.0


@kernel
def transposed_step(balance, h, scratch, q, v, impulse):
    """Cotangents q, v (n) of the end of a step, whose A is factored, to those of its beginning, in
    place, and of forces, impulse (n)."""
    matrices = balance.matrices
    n = q.size
    # impulse = h A^-T (v + h q), since q' = q + h v'
    for i in range(n):
        along = v[i] + h * q[i]
        impulse[i] = h * along
    solve_again(scratch.system, n, impulse)
    for i in range(n):
        stiffness = matrices.G[i]
        v[i] = product(matrices.M[i], impulse) / h
        for j in range(n):
            q[j] -= impulse[i] * stiffness[j]


@kernel
def transposed_map(balance, period, scratch, q, v, impulse):
    """Cotangents q, v (n) of a period's end to those of its beginning, in place, and of the forces
    in its halves, impulse (2, n); a status: NOT_POSITIVE where A is not positive definite.
    Overwrites the linear system and the error estimates of the scratch."""
    whole_q = scratch.error_q
    whole_v = scratch.error_v
    whole = scratch.q
    copy(q, whole_q)
    copy(v, whole_v)
    # two halves
    half_period = 0.5 * period
    status = rate_change(True, balance, half_period, scratch)
    transposed_step(balance, half_period, scratch, q, v, impulse[1])
    transposed_step(balance, half_period, scratch, q, v, impulse[0])
    # one whole
    if status == OK:
        status = rate_change(True, balance, period, scratch)
    transposed_step(balance, period, scratch, whole_q, whole_v, whole)
    # extrapolated: T = 2 T(h/2) - T(h)
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
    # B at the beginning of a period and what was asked for besides
    forces: Annotated[np.ndarray, "n", "k"]
    system: Annotated[np.ndarray, "n", "n"]  # A, then its factor
    solved: Annotated[np.ndarray, "n", "2 n + k"]  # A^-1 [-h G | M | h forces]
    # coordinates after a step by those before the first
    moved: Annotated[np.ndarray, "n", "2 n + k"]
    rates: Annotated[np.ndarray, "n", "2 n + k"]  # likewise their rates
    ahead: Annotated[np.ndarray, "n", "2 n + k"]  # likewise the rates a step later


def make_plan(arm: Arm, periods: int, parts: int, forces: np.ndarray) -> Plan:
    """Zeroed Plan for an arm, with forces (n, k - n_a) besides those of the tendons."""
    n_a = arm.tendons.size
    inputs = n_a + forces.shape[1]
    sizes = sizes_of(arm)
    sizes["N"] = periods
    sizes["N + 1"] = periods + 1
    sizes["parts"] = parts
    sizes["k"] = inputs
    sizes["2 n + k"] = 2 * arm.strain.size + inputs
    plan = zeros(Plan, sizes)
    plan.forces[:, n_a:] = forces
    return plan


@kernel
def solve_step(balance, h, plan):
    """A^-1 [-h G | M | h forces] into plan.solved: the rates after a step of length h by (q, v,
    forces)."""
    n, inputs = plan.forces.shape
    matrices = balance.matrices
    solved = plan.solved
    for i in range(n):
        for j in range(n):
            mass = matrices.M[i, j]
            stiffness = matrices.G[i, j]
            resistance = matrices.D[i, j] + h * stiffness
            plan.system[i, j] = mass + h * resistance
            solved[i, j] = -h * stiffness
            solved[i, n + j] = mass
        for j in range(inputs):
            solved[i, 2 * n + j] = h * plan.forces[i, j]
    solve_symmetric(plan.system, solved)


@kernel
def add_jacobian(balance, h, count, share, plan, out):
    """Adds a share of the Jacobian (2 n, 2 n + k) of `count` steps of length h by (q, v, forces) to
    out."""
    solve_step(balance, h, plan)
    n, columns = plan.solved.shape
    moved = plan.moved
    rates = plan.rates
    # before the first step q is itself
    moved[:, :] = 0.0
    for i in range(n):
        moved[i, i] = 1.0
    copy_matrix(plan.solved, rates)
    for step in range(count):
        if step > 0:
            step_ahead(plan)
        # q' = q + h v'
        for i in range(n):
            for k in range(columns):
                moved[i, k] = moved[i, k] + h * rates[i, k]
    for i in range(n):
        for k in range(columns):
            out[i, k] += share * moved[i, k]
            out[n + i, k] += share * rates[i, k]


@kernel
def step_ahead(plan):
    """Rates of the next step, of coordinates plan.moved and rates plan.rates, in place of these."""
    n, columns = plan.solved.shape
    solved = plan.solved
    ahead = plan.ahead
    for i in range(n):
        # forces act in every step
        for k in range(columns):
            ahead[i, k] = solved[i, k] if k >= 2 * n else 0.0
        for j in range(n):
            by_q = solved[i, j]
            by_v = solved[i, n + j]
            moved = plan.moved[j]
            rates = plan.rates[j]
            for k in range(columns):
                ahead[i, k] += by_q * moved[k] + by_v * rates[k]
    copy_matrix(ahead, plan.rates)


@kernel
def linearised_rollout(arm, scheme, motion, steps, scratch, plan):
    """Plays plan.command from the motion, in place, and fills the plan with what happens and the
    Jacobians by `steps` steps a period. Returns a status, and the period that failed or their
    number."""
    step = scheme.control.step
    none = Record(plan.q[:0], plan.q_dot[:0], plan.tip_pose[:0])
    periods = plan.command.shape[0]
    length = total(plan.duration)
    for k in range(periods + 1):
        # where the last period ends its last command still acts
        command = plan.command[k, 0] if k < periods else plan.command[periods - 1, -1]
        status = evaluate_motion(arm, scheme.method, command, motion, scratch)
        if status != OK:
            return status, k
        copy(motion.q, plan.q[k])
        copy(motion.q_dot, plan.q_dot[k])
        copy(motion.state, plan.state[k])
        kinematics = scratch.work.kinematics
        copy_tip(kinematics, plan.tip_pose[k], plan.tip_jacobian[k], plan.tip_bias)
        if k == periods:
            break
        linearise_period(arm, scheme.method, length, steps, scratch, plan, plan.jacobian[k])
        progress = advance(arm, scheme, plan.command[k], plan.duration, motion, step, scratch, none)
        if progress.status != OK:
            return progress.status, k
        step = progress.step
    return OK, periods


@kernel
def evaluate_motion(arm, method, command, motion, scratch):
    """Evaluation at a motion under a command (n_a) that is held; a status."""
    arrival = scratch.arrival
    time = motion.clock[0]
    state = motion.state
    copy(motion.xi, scratch.work.strain.xi)
    receive(arm.effects, command, False, time, state, arrival)
    arrived = arrival.command
    acting = command_at(arm.effects, arrived, state, 0.0, scratch.acting)
    return evaluate_force(arm, method, acting, motion.q, motion.q_dot, state, time, scratch)


@kernel
def linearise_period(arm, method, length, steps, scratch, plan, jacobian):
    """Jacobian (2 n, 2 n + k) of a period of a length [s] by `steps` steps, of the evaluation where
    it begins."""
    work = scratch.work
    matrices_of_motion(arm, method, scratch)
    share = work.friction.share if tendons_rub(arm) else work.ones.tendon
    actuation_matrix(arm, work.strain, share, work.spare, plan.forces)
    jacobian[:, :] = 0.0
    # T = 2 T(h/2) - T(h)
    step = length / steps
    half_step = 0.5 * length / steps
    add_jacobian(scratch.first, half_step, 2 * steps, 2.0, plan, jacobian)
    add_jacobian(scratch.first, step, steps, -1.0, plan, jacobian)
