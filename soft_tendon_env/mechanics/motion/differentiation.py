"""Derivatives of the substeps of an integrator step by where they begin: the equation that each solves, differentiated term by term.

A substep solves r = 0 for the change a of the rates, see residual. The derivative of a follows from that of r at a held a. r is
differentiated by central differences: by the coordinates with the strain found anew, by rates, internal states and commands at the strain
that is there. So the physics stands once, in the kernels of the motion, effects of users included.

Where a kernel jumps between the two sides of a difference, as where friction sticks, the side on which it does not is taken.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.motion.rate_slopes import write_rate_slopes
from soft_tendon_env.mechanics.motion.residual import write_kept_residual, write_residuals, write_states_after
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.terms.kinematics import poses
from soft_tendon_env.mechanics.terms.parametrisation import (
    strain_bias,
    strain_columns,
    strain_drive,
    strain_from_guess,
    strain_matrices,
    strain_rate,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_column
from soft_tendon_env.mechanics.terms.transmission import makes_tensions, transmitted

HERE, PREDICTED = 1e-12, 1e-3
"""Tolerances of the strain's Newton, where inputs are as they are and beside it: there one correction of what the columns predict, on
either side, leaves errors that cancel."""
JUMP = 1e3
"""One side's change over the other's, above which the function is taken to jump there."""


@kernel
def slope(before, here, after, unit):
    """Derivative of a function by its values at -unit, 0 and unit: central, or that of the side on which it does not jump."""
    left, right = here - before, after - here
    if abs(right) > JUMP * abs(left):
        return left / unit
    if abs(left) > JUMP * abs(right):
        return right / unit
    return (after - before) / (2.0 * unit)


@kernel
def respond(arm, stiffens, own, later, scratch, difference, side):
    """Responses to a side of the substeps `own` that begin at an evaluation, and of those `later` whose D and G are kept from it."""
    course, place, response = difference.course, difference.place, difference.response[side]
    n, m = course.v.shape[1], course.state.shape[1]
    write_residuals(arm, stiffens, own, course.v[own[0]], scratch, difference, response)
    for k in later:
        write_kept_residual(arm, course.equation[k], course.change[k], course.v[k], scratch, difference.residual, response[k, n : 2 * n])
    write_states_after(arm, own, place[n : 2 * n], place[2 * n : 2 * n + m], scratch, difference, response)


@kernel
def evaluate_moved(arm, stiffens, side, own, later, scratch, difference):
    """Evaluation at coordinates that may be moved to a side, 0 or 2, with the strain found anew from the guess in work.xi: responses of all
    its substeps; a status."""
    work, course, place, at = scratch.work, difference.course, difference.place, own[0]
    n, m = course.v.shape[1], course.state.shape[1]
    q, v, u = place[:n], place[n : 2 * n], place[2 * n + m :]
    copy(course.rate[at], work.xi_dot)
    copy(place[2 * n : 2 * n + m], work.state)
    work.clock[0] = course.time[at]
    place_base(arm, work)
    if strain_from_guess(arm, q, HERE if side == 1 else PREDICTED, work) >= 0:
        return NO_STRAIN
    if side == 1:
        strain_columns(arm, transmitted(arm, u, work), q, v, work)
        keep_strain(work, difference)
    else:
        strain_drive(arm, transmitted(arm, u, work), q, v, work)
    poses(arm.rod, work)
    respond(arm, stiffens, own, later, scratch, difference, side)
    return OK


@kernel
def evaluate_moved_input(arm, stiffens, side, own, later, scratch, difference):
    """Evaluation at an internal state or command, or rates, that are moved, at the strain that is there: responses of its substeps."""
    work, course, place = scratch.work, difference.course, difference.place
    n, m = course.v.shape[1], course.state.shape[1]
    copy(course.rate[own[0]], work.xi_dot)
    copy(place[2 * n : 2 * n + m], work.state)
    strain_drive(arm, transmitted(arm, place[2 * n + m :], work), place[:n], place[n : 2 * n], work)
    respond(arm, stiffens, own, later, scratch, difference, side)


@kernel
def evaluate_moved_rates(arm, stiffens, side, own, later, scratch, difference):
    """Evaluation at rates that are moved, where nothing lies between commands and tensions, as evaluate_moved_input()."""
    work, n, m = scratch.work, difference.course.v.shape[1], difference.course.state.shape[1]
    copy(difference.place[2 * n : 2 * n + m], work.state)
    strain_rate(arm, difference.place[n : 2 * n], work)
    strain_bias(arm, work)
    respond(arm, stiffens, own, later[:0], scratch, difference, side)


@kernel
def write_slopes(i, own, later, difference):
    """Writes the derivatives by the i-th input, of the responses on both sides."""
    response, slopes, unit = difference.response, difference.slopes, difference.unit[i]
    n, m = slopes.force.shape[1], slopes.state.shape[1]
    for k in own:
        for j in range(n):
            slopes.force[k, j, i] = slope(response[0, k, j], response[1, k, j], response[2, k, j], unit)
        for j in range(m):
            at = 2 * n + j
            slopes.state[k, j, i] = slope(response[0, k, at], response[1, k, at], response[2, k, at], unit)
    for k in later:
        for j in range(n):
            slopes.kept[k, j, i] = slope(response[0, k, n + j], response[1, k, n + j], response[2, k, n + j], unit)


@kernel
def write_actuation(arm, own, scratch, difference):
    """Writes the derivatives by commands that are tensions: of forces, the actuation matrix."""
    slopes, column, inputs = difference.slopes, scratch.ahead, difference.unit.size
    for i in range(arm.tendons.size):
        actuation_column(arm.rod, arm.tendons, arm.strain, i, scratch.work, column)
        for k in own:
            for j in range(column.size):
                slopes.force[k, j, inputs - arm.tendons.size + i] = -difference.course.equation[k, 2] * column[j]


@kernel
def keep_strain(work, difference):
    """Keeps the strain that was found, and its columns."""
    copy(work.Phi, difference.Phi)
    copy(work.xi, difference.xi)


@kernel
def add_rate_stiffness(own, difference):
    """Adds to the derivatives by the rates that of the rod's G v."""
    n = difference.stiffness.shape[0]
    for k in own:
        share = difference.course.equation[k, 0] * difference.course.equation[k, 2]
        for i in range(n):
            for j in range(n):
                difference.slopes.force[k, i, n + j] += share * difference.stiffness[i, j]


@kernel
def predict_along(column, way, difference, xi):
    """Strain (points x 6) a way along one column from where it is."""
    for m in range(0, xi.size, LANES):
        store(xi, m, load(difference.xi, m) + way * load(difference.Phi, column * xi.size + m))


@kernel
def differentiate_inputs(arm, stiffens, own, later, scratch, difference):
    """Derivatives by internal states and commands, and by rates where effects act, at the strain that is there."""
    place, unit, n = difference.place, difference.unit, arm.strain.size
    between = makes_tensions(arm.effects, scratch.work)
    for i in range(n if arm.effects.count > 0 else 2 * n, unit.size - difference.direct):
        here, of_rates = place[i], i < 2 * n and not between
        for side in range(0, 3, 2):
            place[i] = here + (side - 1) * unit[i]
            if of_rates:
                evaluate_moved_rates(arm, stiffens, side, own, later, scratch, difference)
            else:
                evaluate_moved_input(arm, stiffens, side, own, later, scratch, difference)
        place[i] = here
        write_slopes(i, own, later[:0] if of_rates else later, difference)


@kernel
def differentiate(arm, keeps, u, own, later, scratch, difference):
    """Derivatives of the substeps `own` that begin at the evaluation of the first of them, and of those `later` whose D and G are kept from
    it; a status."""
    work, course, place, unit, at = scratch.work, difference.course, difference.place, difference.unit, own[0]
    n, m, stiffens = course.v.shape[1], course.state.shape[1], at == 0 or not keeps
    copy(course.q[at], place[:n])
    copy(course.v[at], place[n : 2 * n])
    copy(course.state[at], place[2 * n : 2 * n + m])
    copy(u, place[2 * n + m :])
    copy(course.xi[at], work.xi)
    work.driven[0] = 1.0
    status = evaluate_moved(arm, stiffens, 1, own, later, scratch, difference)
    if status == OK:
        if stiffens:
            strain_matrices(arm, work)
            copy_matrix(work.G, difference.stiffness)
        differentiate_inputs(arm, stiffens, own, later, scratch, difference)
        if difference.direct > 0:
            write_actuation(arm, own, scratch, difference)
        if arm.effects.count > 0:
            add_rate_stiffness(own, difference)
        else:
            status = write_rate_slopes(arm, u, PREDICTED, own, scratch, difference)
    for i in range(n):
        here = place[i]
        for side in range(0, 3, 2):
            way = (side - 1) * unit[i]
            place[i] = here + way
            predict_along(i, way, difference, work.xi)
            if status == OK:
                status = evaluate_moved(arm, stiffens, side, own, later, scratch, difference)
        place[i] = here
        write_slopes(i, own, later, difference)
    return status
