"""Parts of a step: force at a state, prediction of the strain, what is asked of a step and what comes of it."""

from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread, store
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces

STEP_TOLERANCE = 1e-6  # of the strain's Newton: quadratic, so the strain itself is good to the square of it


@kernel
def predict_strain(strain, q, q_last, work):
    """Predicts the strain at coordinates q in work.xi: to first order along the columns of the last evaluation, and to second order as far
    as q lies where its rates lead, along its bias, the second derivative there; never further along the bias than along the columns.
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
    """Force on the coordinates, drive - C v + F, or without inertia drive + F, under the command u that acts, into scratch.force; a status.
    state: internal states of the effects, at this time or that of work.since before it."""
    work = scratch.work
    copy(state, work.state)
    work.clock[0] = time
    work.u_is_command[0] = 1.0
    if evaluate_forces(arm, u, q, v, method.strain_tolerance, work) >= 0:
        return NO_STRAIN
    copy(q, scratch.q_last)
    for i in range(q.size):
        scratch.force[i] = work.drive[i] - (work.bias[i] if method.with_inertia else 0.0) + work.load[i]
    return OK


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
    near: float  # [m] how far elastic tendons may go to where they become slack, taut or as tense as can be in a smooth step


class Attempt(NamedTuple):
    """Outcome of one attempted step."""

    status: int
    columns: int  # that `error` belongs to
    evaluations: int
    error: float  # [m] estimate
    rows: int  # of the table that were taken
