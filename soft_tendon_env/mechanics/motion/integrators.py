"""Time integrators: extrapolated linearly implicit Euler and classical Runge-Kutta steps of (23), tension held over a step.

Extrapolated linearly implicit Euler (Deuflhard, Hairer and Zugck 1987, SEULEX): the substep
(M + h D + h^2 G) dv = h (B u - K - C v - D v + F - h G v), q += h v, repeated n_j = 1, 2, ... times over the step, and the results
extrapolated to h = 0 by Aitken-Neville. G is the stiffness of the drive to first order, so the substep is stable at any h;
every column adds an order, and the difference between the last two entries of the last row estimates the error. So the rows of the table
can be built one after the other until that estimate meets a tolerance: the order follows the error.

M, the forces and the effects' share of D and G are always those of the substep: an arm may come upon something within a step. The rod's own
D and G, of which any leave the order as it is, are those at the start of the step where the order follows the error, as SEULEX keeps its
Jacobian: a violent step is less accurate with them, and then takes a column more, but every evaluation costs a fifth less.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, aligned_zeros, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix, product, row_stride, solve_positive_definite
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.late_binding import call_late
from soft_tendon_env.mechanics.motion.error_estimate import error_estimate
from soft_tendon_env.mechanics.motion.status import INACCURATE, NO_STRAIN, NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces
from soft_tendon_env.mechanics.terms.external_forces import add_implicit, advance_states, rates_of
from soft_tendon_env.mechanics.terms.parametrisation import strain_matrices
from soft_tendon_env.mechanics.terms.transmission import change_parts, jolts, way_to_part
from soft_tendon_env.mechanics.types import Arm, Bounded, Workspace, make_bounded, make_workspace

STEP_TOLERANCE = 1e-6  # of the strain's Newton: quadratic, so the strain itself is good to the square of it
MOST_AT_ONCE, MOST_ONE_BY_ONE = 8, 64  # solutions of a substep with bounded tensions, all of which or one of which change in each
NEAR = 0.05  # of a step's tolerance, the way of a tendon to a bound of its tension that it may go in a step that is extrapolated
HOPELESS = 3.0  # tolerances. Measured on random 0 to 150 N: 15 % fewer evaluations than without; with 1 more again, steps that succeed


class Motion(NamedTuple):
    """Coordinates, rates, strain and effects' states of one arm, which a step advances in place."""

    q: np.ndarray  # (n)
    q_dot: np.ndarray  # (n)
    xi: np.ndarray  # points x 6, the strain at q, from which the next Newton starts
    state: np.ndarray  # internal states of the effects
    clock: np.ndarray  # (1) time [s]


class Start(Struct):
    """The evaluation at the start of a step, as far as effects with internal states need it in every row; empty without any."""

    pose: np.ndarray
    xi: np.ndarray
    J: np.ndarray
    Phi: np.ndarray
    tension: np.ndarray


class Scratch(Struct):
    """Scratch of the steps."""

    work: Workspace  # of the evaluations
    table_q: np.ndarray  # (columns, columns, n) extrapolation table
    table_v: np.ndarray
    table_state: np.ndarray  # (columns, columns, states)
    mass: np.ndarray  # (n, n) M, D, G and the force at the start of the step
    damping: np.ndarray
    stiffness: np.ndarray
    rod_damping: np.ndarray  # (n, n) D and G there without the effects' share
    rod_stiffness: np.ndarray
    start_force: np.ndarray  # (n)
    start_drift: np.ndarray  # (n)
    start_bounded: Bounded  # the tensions with bounds there
    start_columns: np.ndarray  # (n_a, n) and their columns
    held: np.ndarray  # (1) status of hold_bounds()
    jolted: np.ndarray  # (1) 1 where the step is one of first order, see complete_row(), else 0
    parts: np.ndarray  # (n_a) of the tensions with bounds, at the end of the first substep
    force: np.ndarray  # (n) drive - C v - D v + F of the last evaluation
    q_last: np.ndarray  # (n) where that was
    system: np.ndarray  # n rows, see linear
    delta: np.ndarray  # (n)
    ahead: np.ndarray  # (n) the rates that a substep ends with
    q: np.ndarray  # (n)
    v: np.ndarray  # (n)
    error_q: np.ndarray  # (n) estimated error of the step
    error_v: np.ndarray
    state: np.ndarray  # (states)
    longest: np.ndarray  # (1) [s] the longest step from the motion that effects allow
    meeting: np.ndarray  # (2) 1 where the step went through something, else 0; 1 where it ends touching something or about to
    pose: np.ndarray  # nodes x 12, of the motion, and its base (24): where effects look at the way of the arm
    base: np.ndarray
    acting: np.ndarray  # (n_a) the command that has arrived
    until: np.ndarray  # (1) [s] when another one does
    start: Start


def make_scratch(arm: Arm, columns: int) -> Scratch:
    """Zeroed scratch for one arm and a method with this many columns."""
    n, states, work = arm.strain.size, arm.effects.state.size, make_workspace(arm)
    zeros = aligned_zeros
    return Scratch(
        work=work,
        table_q=zeros(columns, columns, n),
        table_v=zeros(columns, columns, n),
        table_state=zeros(columns, columns, states),
        mass=zeros(n, n),
        damping=zeros(n, n),
        stiffness=zeros(n, n),
        rod_damping=zeros(n, n),
        rod_stiffness=zeros(n, n),
        start_force=zeros(n),
        start_drift=zeros(n),
        start_bounded=make_bounded(arm.tendons.size),
        start_columns=zeros(arm.tendons.size, n),
        held=zeros(1),
        jolted=zeros(1),
        parts=zeros(arm.tendons.size),
        force=zeros(n),
        q_last=zeros(n),
        system=zeros(n * row_stride(n + 1)),
        delta=zeros(n),
        ahead=zeros(n),
        q=zeros(n),
        v=zeros(n),
        state=zeros(states),
        longest=np.full(1, np.inf),
        meeting=zeros(2),
        pose=zeros(work.pose.size),
        base=zeros(work.base.size),
        error_q=zeros(n),
        error_v=zeros(n),
        acting=zeros(arm.tendons.size),
        until=zeros(1),
        start=Start(**{name: zeros(getattr(work, name).size if states else 0) for name in ("pose", "xi", "J", "Phi", "tension")}),
    )


@kernel
def predict_strain(strain, q, q_last, work):
    """Move work.xi to the coordinates q: to first order along the columns of the last evaluation, and to second order as far as q lies
    where its rates lead, along its bias, which is the second derivative there; never further along the bias than along the columns.
    """
    change, per_column = work.mismatch, work.xi.size  # the mismatch has been made a force
    for m in range(0, per_column, LANES):
        store(change, m, spread(0.0))
    for j in range(strain.size):
        step = q[j] - q_last[j]
        rows = per_column // strain.tip[j]
        for m in range(strain.first[j] * rows, strain.last[j] * rows, LANES):
            store(change, m, load(change, m) + step * load(work.Phi, j * per_column + m))
    along, rates, curved, moved = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for m in range(0, per_column, LANES):
        x, rate, bias = load(change, m), load(work.xi_dot, m), load(work.xi_bias, m)
        along, rates, curved, moved = along + x * rate, rates + rate * rate, curved + bias * bias, moved + x * x
    time = lane_sum(along) / max(lane_sum(rates), 1e-300)
    half = 0.5 * time * time
    if not half * half * lane_sum(curved) <= lane_sum(moved):
        half = 0.0
    for m in range(0, per_column, LANES):
        store(work.xi, m, load(work.xi, m) + load(change, m) + half * load(work.xi_bias, m))


@kernel
def evaluate_force(arm, method, u, q, v, state, time, scratch):
    """evaluate_forces() under the command u, with the force on the coordinates in scratch.force."""
    work = scratch.work
    copy(state, work.state)
    work.clock[0] = time
    work.driven[0] = 1.0
    if evaluate_forces(arm, u, q, v, method.strain_tolerance, work) >= 0:
        return NO_STRAIN
    copy(q, scratch.q_last)
    for i in range(q.size):
        scratch.force[i] = work.drive[i] - (work.bias[i] if method.with_inertia else 0.0) + work.load[i]
    return OK


@kernel
def start_matrices(arm, scratch):
    """M, D and G with the effects' share, and the force, of the evaluation at the start of the step."""
    work = scratch.work
    strain_matrices(arm, work)
    if arm.effects.count > 0:
        copy_matrix(work.D, scratch.rod_damping)
        copy_matrix(work.G, scratch.rod_stiffness)
        call_late(add_implicit, (arm, work))
    copy_matrix(work.M, scratch.mass)
    copy_matrix(work.D, scratch.damping)
    copy_matrix(work.G, scratch.stiffness)
    copy(scratch.force, scratch.start_force)
    copy(work.drift, scratch.start_drift)
    if work.bounded.any[0] != 0.0:
        call_late(keep_bounded, (scratch,))


@kernel
def keep_bounded(scratch):
    """Keep the tensions with bounds at the start of the step, and their columns."""
    source, kept = scratch.work.bounded, scratch.start_bounded
    copy(source.free, kept.free)
    copy(source.stiffness, kept.stiffness)
    copy(source.least, kept.least)
    copy(source.greatest, kept.greatest)
    copy(source.part, kept.part)
    copy_matrix(scratch.work.tendon_columns, scratch.start_columns)


@kernel
def later_matrices(arm, method, scratch):
    """D and G of a later evaluation into work.D and work.G, where start_matrices() left those of the step's start."""
    work = scratch.work
    if not method.keeps:
        strain_matrices(arm, work)
    elif arm.effects.count > 0:
        copy_matrix(scratch.rod_damping, work.D)
        copy_matrix(scratch.rod_stiffness, work.G)
    if arm.effects.count > 0:
        call_late(add_implicit, (arm, work))


class Balance(NamedTuple):
    """Forces and matrices of one substep."""

    mass: np.ndarray  # (n, n)
    damping: np.ndarray
    stiffness: np.ndarray
    force: np.ndarray  # (n)
    drift: np.ndarray  # (n) the rate at which the force grows besides by the motion of the arm
    bounded: Bounded  # the tensions with bounds
    columns: np.ndarray  # (n_a, n) and their columns


@kernel
def rate_change(with_inertia, balance, h, scratch):
    """Change of the rates scratch.v in a substep of length h, into scratch.delta; without inertia they follow from the forces alone."""
    mass, damping, stiffness, force, drift = balance.mass, balance.damping, balance.stiffness, balance.force, balance.drift
    n = force.size
    system, delta, v = scratch.system, scratch.delta, scratch.v
    stride = row_stride(n + 1)
    share = 1.0 if with_inertia else 0.0
    for i in range(n):
        row, m, d, g = system[i * stride : i * stride + n], mass[i], damping[i], stiffness[i]
        for j in range(n):  # left of the diagonal too, where nothing is read: whole rows are quicker
            row[j] = share * m[j] + h * (d[j] + h * g[j])
        system[i * stride + n] = h * (force[i] + h * (drift[i] - product(g, v)))
    return OK if solve_positive_definite(system, n, delta) else NOT_POSITIVE


@kernel
def hold_bounds(begins, near, with_inertia, balance, h, scratch):
    """Repeat rate_change() until every tension with bounds is on that part of its law on which it ends, with a status in scratch.held.

    That is one step of implicit Euler with the force max(0, ..) of cables that hang slack, a monotone one: a complementarity problem
    (D. E. Stewart and J. C. Trinkle 1996), by Newton's method on its parts, and where that goes in circles one part at a time, which
    for a positive definite system comes to an end (K. G. Murty 1974).

    begins: whether it is the first substep of a step, which may bring a tendon by no more than a way `near` [m] to a bound, or from one,
    and still be smooth.
    """
    bounded = balance.bounded
    scratch.held[0] = OK
    if begins:
        scratch.jolted[0] = 0.0
        copy(bounded.part, scratch.parts)
    for repeat in range(MOST_AT_ONCE + MOST_ONE_BY_ONE):
        for i in range(scratch.v.size):
            scratch.ahead[i] = scratch.v[i] + scratch.delta[i]
        if not change_parts(bounded, balance.columns, scratch.ahead, h, repeat >= MOST_AT_ONCE, balance.stiffness, balance.force):
            break
        status = rate_change(with_inertia, balance, h, scratch)
        if status != OK:
            scratch.held[0] = status
            return
    for i in range(bounded.part.size):
        if bounded.part[i] != scratch.parts[i] and not (begins and way_to_part(bounded, i) < near):
            scratch.jolted[0] = 1.0
    if begins:
        copy(bounded.part, scratch.parts)


@kernel
def move(h, scratch):
    """Take the change of rates that was found over a substep of length h, from scratch.q, scratch.v, in place."""
    delta, q, v = scratch.delta, scratch.q, scratch.v
    for i in range(q.size):
        v[i] += delta[i]
        q[i] += h * v[i]


@kernel
def implicit_euler(arm, method, tolerance, step, row, substep, scratch):
    """One substep from scratch.q, scratch.v, in place: the first of a row from the evaluation at the start of the step."""
    work, h, with_inertia = scratch.work, step / (row + 1), method.with_inertia
    if substep == 0:
        balance = Balance(
            scratch.mass, scratch.damping, scratch.stiffness, scratch.start_force, scratch.start_drift, scratch.start_bounded,
            scratch.start_columns,
        )  # fmt: skip
    else:
        later_matrices(arm, method, scratch)
        balance = Balance(work.M, work.D, work.G, scratch.force, work.drift, work.bounded, work.tendon_columns)
    status = rate_change(with_inertia, balance, h, scratch)
    if status == OK and work.bounded.any[0] != 0.0:
        call_late(hold_bounds, (row == 0, NEAR * tolerance, with_inertia, balance, h, scratch))
        status = int(scratch.held[0])
    if status == OK:
        move(h, scratch)
    return status


@kernel
def extrapolate(table, row):
    """Aitken-Neville for the step numbers 1, 2, 3, ...: one row, in place of the table, from its first entry and the row before."""
    for k in range(1, row + 1):
        ratio = (row + 1.0) / (row + 1.0 - k) - 1.0
        for i in range(table.shape[2]):
            table[row, k, i] = table[row, k - 1, i] + (table[row, k - 1, i] - table[row - 1, k - 1, i]) / ratio


@kernel
def substeps(arm, method, tolerance, u, motion, step, row, scratch):
    """The first entry of a row of the table: row + 1 substeps, to scratch.q, scratch.v; a status and the number of evaluations.

    The first substep of every row goes from the evaluation at the start, which they share.
    """
    work, h, evaluations, has_states = scratch.work, step / (row + 1), 0, motion.state.size > 0
    copy(motion.q, scratch.q)
    copy(motion.q_dot, scratch.v)
    copy(motion.state, scratch.state)
    for substep in range(row + 1):
        if substep > 0 or row == 0:
            if substep > 0:
                predict_strain(arm.strain, scratch.q, scratch.q_last, work)
            time = motion.clock[0] + substep * h
            status = evaluate_force(arm, method, u, scratch.q, scratch.v, scratch.state, time, scratch)
            evaluations += 1
            if status != OK:
                return status, evaluations
        if row == 0:
            if has_states:
                keep_start(work, scratch.start)
            start_matrices(arm, scratch)
        status = implicit_euler(arm, method, tolerance, step, row, substep, scratch)
        if status != OK:
            return status, evaluations
        if has_states:
            if row > 0 and substep == 0:
                restore_start(motion, scratch)
            call_late(advance_effects, (arm, h, scratch))
    return OK, evaluations


@kernel
def keep_start(work, start):
    """Keep what advance_effects() needs of the evaluation at the start of the step."""
    copy(work.pose, start.pose)
    copy(work.xi, start.xi)
    copy(work.J, start.J)
    copy(work.Phi, start.Phi)
    copy(work.tension, start.tension)


@kernel
def restore_start(motion, scratch):
    """Undo what evaluations since keep_start() have changed of it."""
    start, work = scratch.start, scratch.work
    copy(start.pose, work.pose)
    copy(start.xi, work.xi)
    copy(start.J, work.J)
    copy(start.Phi, work.Phi)
    copy(start.tension, work.tension)
    work.clock[0] = motion.clock[0]
    copy(motion.q, scratch.q_last)


@kernel
def advance_effects(arm, h, scratch):
    """Advance the effects' states by a substep, with the rates after it, in the configuration before it."""
    work = scratch.work
    rates_of(arm.strain, scratch.v, work)
    copy(scratch.state, work.state)
    advance_states(arm, h, work)
    copy(work.state, scratch.state)


@kernel
def complete_row(row, scratch):
    """Extrapolate a row of the table from scratch.q, scratch.v, its first entry: the last one in their place, with the error estimate.

    Where tendons come to a bound of their tension within the step or leave one, as where they become slack or taut, nothing is smooth
    enough to be extrapolated: the first entry is kept, with the estimate of a method of first order. So it is, but with the estimate of
    the last one, where friction that sticks makes a tension jump.
    """
    copy(scratch.q, scratch.table_q[row, 0])
    copy(scratch.v, scratch.table_v[row, 0])
    extrapolate(scratch.table_q, row)
    extrapolate(scratch.table_v, row)
    copy(scratch.table_q[row, row], scratch.q)
    copy(scratch.table_v[row, row], scratch.v)
    if scratch.state.size > 0:
        copy(scratch.state, scratch.table_state[row, 0])
        extrapolate(scratch.table_state, row)
        copy(scratch.table_state[row, row], scratch.state)
    if row == 0:
        return
    for i in range(scratch.q.size):
        scratch.error_q[i] = scratch.q[i] - scratch.table_q[row, row - 1, i]
        scratch.error_v[i] = scratch.v[i] - scratch.table_v[row, row - 1, i]
    jolted = scratch.jolted[0] != 0.0
    if jolted or jolts(scratch.work, scratch.table_q[row, 0], scratch.q):
        copy(scratch.table_q[row, 0], scratch.q)
        copy(scratch.table_v[row, 0], scratch.v)
        copy(scratch.table_state[row, 0], scratch.state)
        for i in range(scratch.q.size if jolted else 0):
            scratch.error_q[i] = scratch.table_q[row, 1, i] - scratch.q[i]
            scratch.error_v[i] = scratch.table_v[row, 1, i] - scratch.v[i]


class Demand(NamedTuple):
    """Accuracy that is asked of one step."""

    tolerance: float  # [m] of the error estimate
    least: int  # columns to begin with
    horizon: float  # [s] over which an error of the rates counts as displacement


class Attempt(NamedTuple):
    """How one step went."""

    status: int
    columns: int  # that `error` belongs to
    evaluations: int
    error: float  # [m] estimate


@kernel
def extrapolated_step(arm, method, demand, u, motion, step, scratch):
    """One extrapolated step from motion to scratch.q, scratch.v with as few columns, from demand.least on, as meet the tolerance.

    An estimate that falls as it did by the last column, column by column, and still misses the tolerance by HOPELESS at the last one
    ends the step before its time, with the estimate that it would have come to.
    """
    copy(motion.xi, scratch.work.xi)
    evaluations, error = 0, math.inf
    for row in range(method.columns):
        status, more = substeps(arm, method, demand.tolerance, u, motion, step, row, scratch)
        evaluations += more
        if status != OK:
            return Attempt(status, row + 1, evaluations, math.inf)
        complete_row(row, scratch)
        if row + 1 < demand.least and row + 1 < method.columns:
            continue
        before = error
        status, error = error_estimate(arm.rod, demand.horizon, scratch)
        if status != OK or error <= demand.tolerance:
            return Attempt(status, row + 1 if scratch.jolted[0] == 0.0 else method.columns, evaluations, error)
        foreseen = error * (error / before) ** (method.columns - row - 1)
        if foreseen > HOPELESS * demand.tolerance:
            return Attempt(INACCURATE, method.columns, evaluations, foreseen)
    return Attempt(INACCURATE, method.columns, evaluations, error)


@kernel
def acceleration(scratch):
    """q_ddot of the last evaluation into scratch.delta."""
    n, stride = scratch.q.size, row_stride(scratch.q.size + 1)
    for i in range(n):
        for j in range(i, n):
            scratch.system[i * stride + j] = scratch.work.M[i, j]
        scratch.system[i * stride + n] = scratch.force[i]
    return OK if solve_positive_definite(scratch.system, n, scratch.delta) else NOT_POSITIVE


@kernel
def runge_kutta_step(arm, method, u, motion, step, scratch):
    """Attempt one step of the classical fourth-order Runge-Kutta method, to scratch.q and scratch.v; its error is not estimated."""
    work = scratch.work
    copy(motion.xi, work.xi)
    slope_q, slope_v = scratch.table_q[0, 0], scratch.table_v[0, 0]
    slope_q[:] = 0.0
    slope_v[:] = 0.0
    reach = 0.0
    copy(motion.q, scratch.q)
    copy(motion.q_dot, scratch.v)
    for stage in range(4):
        if stage > 0:
            predict_strain(arm.strain, scratch.q, scratch.q_last, work)
        time = motion.clock[0] + reach
        status = evaluate_force(arm, method, u, scratch.q, scratch.v, motion.state, time, scratch)
        if status == OK:
            status = acceleration(scratch)
        if status != OK:
            return Attempt(status, 1, stage + 1, math.inf)
        weight = 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0
        reach = 0.5 * step if stage < 2 else step
        for i in range(slope_q.size):
            velocity = scratch.v[i]
            slope_q[i] += weight * velocity
            slope_v[i] += weight * scratch.delta[i]
            scratch.q[i] = motion.q[i] + reach * velocity
            scratch.v[i] = motion.q_dot[i] + reach * scratch.delta[i]
    for i in range(slope_q.size):
        scratch.q[i] = motion.q[i] + step * slope_q[i]
        scratch.v[i] = motion.q_dot[i] + step * slope_v[i]
    copy(motion.state, scratch.state)
    if motion.state.size > 0:
        call_late(advance_effects, (arm, step, scratch))
    status, error = error_estimate(arm.rod, step, scratch)
    return Attempt(status, 1, 4, error)


class Extrapolated(NamedTuple):
    """Extrapolated linearly implicit Euler, from `least` to `columns` columns: as many as the error calls for."""

    columns: int
    least: int
    with_inertia: bool  # False for quasi-static motion
    keeps: bool  # the rod's D and G stay those at the start of a step
    strain_tolerance: float  # of the strain's Newton


class RungeKutta(NamedTuple):
    """The classical method of order 4."""

    columns: int = 1  # the size of the table that it borrows
    least: int = 1
    with_inertia: bool = True
    strain_tolerance: float = STEP_TOLERANCE


def take_step(arm, method, demand, u, motion, step, scratch):
    """Attempt one step of the method from motion to scratch.q, scratch.v. The type of `method` selects the code."""
    if isinstance(method, RungeKutta):
        return runge_kutta_step(arm, method, u, motion, step, scratch)
    return extrapolated_step(arm, method, demand, u, motion, step, scratch)


@overload(take_step)
def _take_step_overload(arm, method, demand, u, motion, step, scratch):
    if method.instance_class is RungeKutta:
        return lambda arm, method, demand, u, motion, step, scratch: runge_kutta_step(arm, method, u, motion, step, scratch)
    return lambda arm, method, demand, u, motion, step, scratch: extrapolated_step(arm, method, demand, u, motion, step, scratch)
