"""Extrapolated linearly implicit Euler (SEULEX) step of (23), tension held over a step.

It is that of Deuflhard, Hairer and Zugck 1987.

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
from soft_tendon_env.mechanics.motion.scratch import KINKED, SMOOTH
from soft_tendon_env.mechanics.motion.status import INACCURATE, NO_STRAIN, NOT_FINITE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces_of_command
from soft_tendon_env.mechanics.terms.tendon_friction import tendons_rub

# tolerances. Measured on random 0 to 150 N: 15 % fewer evaluations than without; with 1 more again,
# steps that succeed
HOPELESS = 3.0
# of a step's tolerance: how far a tendon may go to a kink of its tension in a step that is
# extrapolated
NEAR = 0.05
# of a logarithm of a tension: the change by directions of friction within a step, beyond which it
# shows in the error
TURNED = 0.01
# of the strain's Newton: quadratic, so the strain itself is good to the square of it
STEP_TOLERANCE = 1e-6
LEAST_SQUARE = 1e-300  # of rates, so that none divides by zero


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
def predict_strain(law, q, q_last, strain, change):
    """Predicts the strain at coordinates q in strain.xi.

    It does so to first order along the columns of the last evaluation, and to second order as far
    as q lies where its rates lead, along its bias; never further along the bias than along the
    columns. Overwrites `change` (points x 6).
    """
    per_column = change.size
    # Phi (q - q_last)
    for m in range(0, per_column, LANES):
        store(change, m, spread(0.0))
    for j in range(law.size):
        step = q[j] - q_last[j]
        per_pack = per_column // law.jacobian_end[j]
        begin = law.pack_begin[j] * per_pack
        end = law.pack_end[j] * per_pack
        for m in range(begin, end, LANES):
            phi = load(strain.Phi, j * per_column + m)
            others = load(change, m)
            store(change, m, others + step * phi)
    # the time t for which xi_dot t is nearest to that
    along = spread(0.0)
    rates = spread(0.0)
    curved = spread(0.0)
    moved = spread(0.0)
    for m in range(0, per_column, LANES):
        x = load(change, m)
        rate = load(strain.xi_dot, m)
        bias = load(strain.xi_bias, m)
        along = along + x * rate
        rates = rates + rate * rate
        curved = curved + bias * bias
        moved = moved + x * x
    squared_rate = max(lane_sum(rates), LEAST_SQUARE)
    time = lane_sum(along) / squared_rate
    # xi + Phi (q - q_last) + t^2/2 xi_bias
    half = 0.5 * time * time
    if not half * half * lane_sum(curved) <= lane_sum(moved):
        half = 0.0
    for m in range(0, per_column, LANES):
        bent = half * load(strain.xi_bias, m)
        straight = load(strain.xi, m) + load(change, m)
        store(strain.xi, m, straight + bent)


@kernel
def evaluate_force(arm, method, command, q, v, state, time, scratch):
    """Force on the coordinates under the command (n_a) that acts; a status.

    It is drive - C v + F, or without inertia drive + F, into scratch.now.force. state: internal
    states of the effects, at this time or that of inputs.since before it.
    """
    work = scratch.work
    copy(state, work.inputs.state)
    work.inputs.clock[0] = time
    failed = evaluate_forces_of_command(arm, command, q, v, method.strain_tolerance, work)
    if failed >= 0:
        return NO_STRAIN
    copy(q, scratch.q_last)
    forces = work.forces
    for i in range(q.size):
        bias = forces.bias[i] if method.with_inertia else 0.0
        scratch.now.force[i] = forces.drive[i] - bias + forces.load[i]
    return OK


@kernel
def substeps(arm, method, tolerance, arrived, motion, step, row, scratch):
    """First entry of a row of the table: row + 1 substeps, to scratch.q, scratch.v.

    The first of them goes from the evaluation at the start that all rows share; a status and the
    number of evaluations.
    """
    h = step / (row + 1)
    is_alone = row == 0
    evaluations = 0
    copy(motion.q, scratch.q)
    copy(motion.q_dot, scratch.v)
    for number in range(row + 1):
        if number > 0 or is_alone:
            status = evaluate_substep(arm, method, arrived, motion, number, h, scratch)
            evaluations += 1
            if status != OK:
                return status, evaluations
        if is_alone:
            start_matrices(arm, scratch)
        substep = Substep(h, number, is_alone, NEAR * tolerance)
        status = implicit_euler(arm, method, arrived, motion, substep, scratch)
        if status != OK:
            return status, evaluations
    return OK, evaluations


@kernel
def evaluate_substep(arm, method, arrived, motion, number, h, scratch):
    """Force at the beginning of a substep, into scratch.now.force; a status.

    The substep begins at scratch.q, scratch.v.
    """
    work = scratch.work
    inputs = work.inputs
    remembers = inputs.before.size > 0
    state = motion.state
    begun = number * h
    if number > 0:
        predict_strain(arm.strain, scratch.q, scratch.q_last, work.strain, work.spare.stress)
    command = command_at(arm.effects, arrived, motion.state, begun, scratch.acting)
    if remembers and number > 0:
        # states go on from the substep before, the first from those of the motion
        inputs.since[0] = h
        if number == 1:
            copy(motion.xi, inputs.before)
        else:
            state = inputs.state
    time = motion.clock[0] + begun
    status = evaluate_force(arm, method, command, scratch.q, scratch.v, state, time, scratch)
    inputs.since[0] = 0.0
    if remembers and status == OK:
        copy(work.strain.xi, inputs.before)
    return status


@kernel
def complete_row(row, scratch):
    """Extrapolates a row of the table from scratch.q, scratch.v, its first entry.

    The last entry takes their place, with the error estimate; where the tension of an elastic
    tendon has a kink within the step, which cannot be extrapolated, the first one, as of a
    first-order method.
    """
    kept = row
    other = max(row - 1, 0)
    if scratch.kink[0] == KINKED and row > 0:
        kept = 0
        other = 1
    extrapolate(row, kept, other, scratch.table_q, scratch.q, scratch.error_q)
    extrapolate(row, kept, other, scratch.table_v, scratch.v, scratch.error_v)


@kernel
def extrapolate(row, kept, other, table, value, error):
    """Aitken-Neville for the step numbers 1, 2, 3, ...

    from a value (n), the row's first entry: to the entry that is kept, in its place, and its
    difference from another one.
    """
    copy(value, table[row, 0])
    for k in range(1, row + 1):
        # T_jk = T_j,k-1 + (T_j,k-1 - T_j-1,k-1) / (n_j / n_j-k - 1)
        ratio = (row + 1.0) / (row + 1.0 - k) - 1.0
        lefts = table[row, k - 1]
        aboves = table[row - 1, k - 1]
        entries = table[row, k]
        for i in range(value.size):
            left = lefts[i]
            entries[i] = left + (left - aboves[i]) / ratio
    copy(table[row, kept], value)
    others = table[row, other]
    for i in range(value.size):
        error[i] = value[i] - others[i]


@kernel
def step_error(arm, attempt, scratch):
    """Error estimate [m] of an accepted step, as it adds up.

    Where the direction of friction turns within the step, every substep errs by a part of its own
    length, that in which it turns. Extrapolation makes more of that in the last entry than in its
    difference from the one before.
    """
    if not tendons_rub(arm) or scratch.kink[0] == KINKED:
        return attempt.error
    if scratch.sliding.turned[0] <= TURNED:
        return attempt.error
    return attempt.error * growth_of_noise(attempt.rows)


@kernel
def growth_of_noise(rows):
    """Error of the last entry of a row of the table beside its estimate, from independent errors.

    Of first entries with j substeps, j = 1, 2, ..., those are as 1/j.
    """
    entry = 0.0
    estimate = 0.0
    for j in range(1, rows + 1):
        # of the first entry in the last one; in the difference it is weight / j
        weight = 1.0
        for i in range(1, rows + 1):
            if i != j:
                weight *= j / (j - i)
        error = weight / j
        difference = error / j
        entry += error * error
        estimate += difference * difference
    return math.sqrt(entry / estimate)


@kernel
def error_estimate(rod, horizon, scratch):
    """Status and error estimate [m] of the step to scratch.q, scratch.v.

    It is the root mean square displacement of the rod, sqrt(e^T M e / m), that error_q makes at
    once or error_v within a horizon [s], that of a step as a rule.
    """
    M = scratch.work.matrices.M
    error_q = scratch.error_q
    error_v = scratch.error_v
    by_q = 0.0
    by_v = 0.0
    for i in range(scratch.q.size):
        if not (math.isfinite(scratch.q[i]) and math.isfinite(scratch.v[i])):
            return NOT_FINITE, math.inf
        row = M[i]
        by_q += error_q[i] * product(row, error_q)
        by_v += error_v[i] * product(row, error_v)
    if not math.isfinite(by_q + by_v):
        return NOT_FINITE, math.inf
    mass = rod.mass[0]
    moved = math.sqrt(max(by_q, 0.0) / mass)
    moving = math.sqrt(max(by_v, 0.0) / mass)
    return OK, max(moved, horizon * moving)


@kernel
def extrapolated_step(arm, method, demand, arrived, motion, step, scratch):
    """One extrapolated step from motion to scratch.q, scratch.v that meets the tolerance.

    It has as few columns, from demand.least on, as do. It ends early where the estimate, falling as
    it did by the last column, would miss the tolerance by HOPELESS at the end, with that estimate.
    """
    most = method.columns
    tolerance = demand.tolerance
    copy(motion.xi, scratch.work.strain.xi)
    evaluations = 0
    error = math.inf
    for row in range(most):
        rows = row + 1
        status, more = substeps(arm, method, tolerance, arrived, motion, step, row, scratch)
        evaluations += more
        if status != OK:
            return Attempt(status, rows, evaluations, math.inf, rows)
        complete_row(row, scratch)
        if rows < demand.least and rows < most:
            continue
        before = error
        status, error = error_estimate(arm.rod, demand.horizon, scratch)
        if status != OK or error <= tolerance:
            # the error of a first-order method does not fall as a row's would
            columns = rows if scratch.kink[0] == SMOOTH else most
            return Attempt(status, columns, evaluations, error, rows)
        foreseen = error * (error / before) ** (most - rows)
        if foreseen > HOPELESS * tolerance:
            return Attempt(INACCURATE, most, evaluations, foreseen, rows)
    return Attempt(INACCURATE, most, evaluations, error, most)


class Extrapolated(NamedTuple):
    """Extrapolated linearly implicit Euler, from `least` to `columns` columns.

    It takes as many as the error calls for.
    """

    columns: int
    least: int
    with_inertia: bool  # False for quasi-static motion
    freeze_jacobian: bool  # the rod's D and G stay those at the start of a step
    strain_tolerance: float  # of the strain's Newton
