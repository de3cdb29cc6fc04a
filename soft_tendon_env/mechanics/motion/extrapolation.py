"""Extrapolated linearly implicit Euler (SEULEX) step of (23), tension held over a step (Deuflhard,
Hairer and Zugck 1987).

The substep of implicit_euler is repeated n_j = 1, 2, ... times over the step, and the results
extrapolated to h = 0 by Aitken-Neville. Every column adds an order, and the difference between the
last two entries of the last row estimates the error. So the rows of the table can be built one
after the other until that estimate meets a tolerance: the order follows the error.

M, the forces and the effects' share of D and G are always those of the substep: an arm may come
upon something within a step. The rod's own D and G, of which any leave the order as it is, are
those at the start of the step where the order follows the error, as SEULEX keeps its Jacobian: a
violent step is less accurate with them, and then takes a column more, but every evaluation costs a
fifth less.
"""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.linear import copy, product
from soft_tendon_env.mechanics.motion.implicit_euler import implicit_euler, start_matrices
from soft_tendon_env.mechanics.motion.status import INACCURATE, NO_STRAIN, NOT_FINITE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces

# tolerances. Measured on random 0 to 150 N: 15 % fewer evaluations than without; with 1 more again,
# steps that succeed
HOPELESS = 3.0
# of a step's tolerance: how far a tendon may go to a kink of its tension in a step that is
# extrapolated
NEAR = 0.05
STEP_TOLERANCE = (
    1e-6  # of the strain's Newton: quadratic, so the strain itself is good to the square of it
)


class Demand(NamedTuple):
    """Accuracy that is asked of one step."""

    tolerance: float  # [m] of the error estimate
    least: int  # columns to begin with
    horizon: float  # [s] over which an error of the rates counts as displacement


class Substep(NamedTuple):
    """One of the substeps of equal length from the beginning of a step to its end."""

    length: float  # [s]
    number: int
    is_alone: bool  # it is the whole step
    # [m] how far elastic tendons may go to where they become slack, taut or as tense as can be in a
    # smooth step
    near: float


class Attempt(NamedTuple):
    """Outcome of one attempted step."""

    status: int
    columns: int  # that `error` belongs to
    evaluations: int
    error: float  # [m] estimate
    rows: int  # of the table that were taken


@kernel
def predict_strain(strain, q, q_last, work):
    """Predicts the strain at coordinates q in work.xi: to first order along the columns of the last
    evaluation, and to second order as far as q lies where its rates lead, along its bias; never
    further along the bias than along the columns."""
    change, per_column = work.mismatch, work.xi.size  # the mismatch has been made a force
    for m in range(0, per_column, LANES):
        store(change, m, spread(0.0))
    for j in range(strain.size):
        step = q[j] - q_last[j]
        rows = per_column // strain.jacobian_end[j]
        for m in range(strain.pack_begin[j] * rows, strain.pack_end[j] * rows, LANES):
            store(change, m, load(change, m) + step * load(work.Phi, j * per_column + m))
    along, rates, curved, moved = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for m in range(0, per_column, LANES):
        x, rate, bias = load(change, m), load(work.xi_dot, m), load(work.xi_bias, m)
        along, rates, curved, moved = (
            along + x * rate,
            rates + rate * rate,
            curved + bias * bias,
            moved + x * x,
        )
    time = lane_sum(along) / max(lane_sum(rates), 1e-300)
    half = 0.5 * time * time
    if not half * half * lane_sum(curved) <= lane_sum(moved):
        half = 0.0
    for m in range(0, per_column, LANES):
        store(work.xi, m, load(work.xi, m) + load(change, m) + half * load(work.xi_bias, m))


@kernel
def evaluate_force(arm, method, u, q, v, state, time, scratch):
    """Force on the coordinates, drive - C v + F, or without inertia drive + F, under the command u
    that acts, into scratch.force; a status. state: internal states of the effects, at this time or
    that of work.since before it."""
    work = scratch.work
    copy(state, work.state)
    work.clock[0] = time
    work.u_is_command[0] = 1.0
    if evaluate_forces(arm, u, q, v, method.strain_tolerance, work) >= 0:
        return NO_STRAIN
    copy(q, scratch.q_last)
    for i in range(q.size):
        scratch.force[i] = (
            work.drive[i] - (work.bias[i] if method.with_inertia else 0.0) + work.load[i]
        )
    return OK


@kernel
def substeps(arm, method, tolerance, u, motion, step, row, scratch):
    """The first entry of a row of the table: row + 1 substeps, to scratch.q, scratch.v, of which
    the first goes from the evaluation at the start that all rows share; a status and the number of
    evaluations."""
    evaluations, h = 0, step / (row + 1)
    copy(motion.q, scratch.q)
    copy(motion.q_dot, scratch.v)
    for number in range(row + 1):
        if number > 0 or row == 0:
            status = evaluate_substep(arm, method, u, motion, number, h, scratch)
            evaluations += 1
            if status != OK:
                return status, evaluations
        if row == 0:
            start_matrices(arm, scratch)
        status = implicit_euler(
            arm, method, u, motion, Substep(h, number, row == 0, NEAR * tolerance), scratch
        )
        if status != OK:
            return status, evaluations
    return OK, evaluations


@kernel
def evaluate_substep(arm, method, u, motion, number, h, scratch):
    """Force at the beginning of a substep, from scratch.q, scratch.v, into scratch.force; a
    status."""
    work, state = scratch.work, motion.state
    if number > 0:
        predict_strain(arm.strain, scratch.q, scratch.q_last, work)
    command = command_at(arm.effects, u, motion.state, number * h, scratch.command)
    if work.before.size > 0 and number > 0:
        work.since[0] = h
        if number == 1:
            copy(motion.xi, work.before)
        else:
            state = work.state
    status = evaluate_force(
        arm, method, command, scratch.q, scratch.v, state, motion.clock[0] + number * h, scratch
    )
    work.since[0] = 0.0
    if work.before.size > 0 and status == OK:
        copy(work.xi, work.before)
    return status


@kernel
def complete_row(row, scratch):
    """Extrapolates a row of the table from scratch.q, scratch.v, its first entry: the last one in
    their place, with the error estimate; where the tension of an elastic tendon has a kink within
    the step, which cannot be extrapolated, the first one, as of a first-order method."""
    is_kinked = scratch.is_kinked[0] != 0.0 and row > 0
    kept, other = (0, 1) if is_kinked else (row, max(row - 1, 0))
    for table, value, error in (
        (scratch.table_q, scratch.q, scratch.error_q),
        (scratch.table_v, scratch.v, scratch.error_v),
    ):
        copy(value, table[row, 0])
        for k in range(1, row + 1):  # Aitken-Neville for the step numbers 1, 2, 3, ...
            ratio = (row + 1.0) / (row + 1.0 - k) - 1.0
            for i in range(value.size):
                table[row, k, i] = (
                    table[row, k - 1, i] + (table[row, k - 1, i] - table[row - 1, k - 1, i]) / ratio
                )
        copy(table[row, kept], value)
        for i in range(value.size):
            error[i] = value[i] - table[row, other, i]


@kernel
def error_estimate(rod, horizon, scratch):
    """Status and error estimate [m] of the step to scratch.q, scratch.v: the root mean square
    displacement of the rod, sqrt(e^T M e / m), that error_q makes at once or error_v within a
    horizon [s], that of a step as a rule."""
    mass, by_q, by_v = scratch.work.M, 0.0, 0.0
    for i in range(scratch.q.size):
        if not (math.isfinite(scratch.q[i]) and math.isfinite(scratch.v[i])):
            return NOT_FINITE, math.inf
        by_q += scratch.error_q[i] * product(mass[i], scratch.error_q)
        by_v += scratch.error_v[i] * product(mass[i], scratch.error_v)
    if not math.isfinite(by_q + by_v):
        return NOT_FINITE, math.inf
    return OK, max(
        math.sqrt(max(by_q, 0.0) / rod.mass[0]), horizon * math.sqrt(max(by_v, 0.0) / rod.mass[0])
    )


@kernel
def extrapolated_step(arm, method, demand, u, motion, step, scratch):
    """One extrapolated step from motion to scratch.q, scratch.v with as few columns, from
    demand.least on, as meet the tolerance. It ends early where the estimate, falling as it did by
    the last column, would miss the tolerance by HOPELESS at the end, with that estimate."""
    copy(motion.xi, scratch.work.xi)
    evaluations, error = 0, math.inf
    for row in range(method.columns):
        status, more = substeps(arm, method, demand.tolerance, u, motion, step, row, scratch)
        evaluations += more
        if status != OK:
            return Attempt(status, row + 1, evaluations, math.inf, row + 1)
        complete_row(row, scratch)
        if row + 1 < demand.least and row + 1 < method.columns:
            continue
        before = error
        status, error = error_estimate(arm.rod, demand.horizon, scratch)
        if status != OK or error <= demand.tolerance:
            return Attempt(
                status,
                row + 1 if scratch.is_kinked[0] == 0.0 else method.columns,
                evaluations,
                error,
                row + 1,
            )
        foreseen = error * (error / before) ** (method.columns - row - 1)
        if foreseen > HOPELESS * demand.tolerance:
            return Attempt(INACCURATE, method.columns, evaluations, foreseen, row + 1)
    return Attempt(INACCURATE, method.columns, evaluations, error, method.columns)


class Extrapolated(NamedTuple):
    """Extrapolated linearly implicit Euler, from `least` to `columns` columns: as many as the error
    calls for."""

    columns: int
    least: int
    with_inertia: bool  # False for quasi-static motion
    freeze_jacobian: bool  # the rod's D and G stay those at the start of a step
    strain_tolerance: float  # of the strain's Newton
