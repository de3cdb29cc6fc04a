"""Derivatives of the substeps of an integrator step by where they begin: the equation that each solves, differentiated term by term.

A substep of linearly implicit Euler solves r = (M + h D + h^2 G) a - h (f + h (drift - G v)) = 0 for the change a of the rates, a stage of
Runge-Kutta r = M a - f = 0 for the acceleration. The derivative of a follows from that of r at a held a. r is differentiated by central
differences of forces and matrices: by the coordinates with the strain found anew, by rates, internal states and commands at the strain
that is there. So the physics stands once, in the kernels of the motion, effects of users included.

Where a kernel jumps between the two sides of a difference, as where friction sticks, the side on which it does not is taken.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix, product
from soft_tendon_env.mechanics.late_kernels import call_late
from soft_tendon_env.mechanics.motion.stages import sum_forces
from soft_tendon_env.mechanics.motion.status import NO_STRAIN, OK
from soft_tendon_env.mechanics.terms.evaluate import evaluate_forces, forces_at_rates, forces_at_strain
from soft_tendon_env.mechanics.terms.external_forces import add_implicit, advance_states, rates_of
from soft_tendon_env.mechanics.terms.parametrisation import strain_matrices
from soft_tendon_env.mechanics.terms.tendons import actuation_column
from soft_tendon_env.mechanics.terms.transmission import makes_tensions, put_on_part

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
def add_system_product(h, mass_share, work, x, out):
    """Adds (mass_share M + h D + h^2 G) x to out (n), of the upper triangle of the matrices, as the linear system has them."""
    for i in range(x.size):
        for j in range(i, x.size):
            entry = mass_share * work.M[i, j] + h * (work.D[i, j] + h * work.G[i, j])
            out[i] += entry * x[j]
            if j > i:
                out[j] += entry * x[i]


@kernel
def write_residual(equation, v, a, scratch, out):
    """Writes r for the forces and matrices that an evaluation has left, into out (n)."""
    work, h, weight = scratch.work, equation[0], equation[2]
    for i in range(a.size):
        out[i] = -weight * (scratch.force[i] + h * (work.drift[i] - product(work.G[i], v)))
    add_system_product(h, equation[1], work, a, out)


@kernel
def write_kept_residual(equation, v, a, work, out):
    """Writes the share in r of the rod's D and G in work, into out (n)."""
    h, weight = equation[0], equation[2]
    for i in range(a.size):
        out[i] = weight * h * product(work.G[i], v)
    add_system_product(h, 0.0, work, a, out)


@kernel
def hold_parts(part, scratch):
    """Puts tensions with bounds on given parts (n_a) of their laws, in the forces and matrices that an evaluation has left."""
    work = scratch.work
    for i in range(part.size):
        if work.bounded.stiffness[i] != 0.0:
            put_on_part(work.bounded, i, part[i], work.tendon_columns[i], work.G, scratch.force)


@kernel
def respond(arm, own, v, state, scratch, course, response):
    """Writes r, and the internal states after, of the substeps `own` that begin at an evaluation, where v and state may be moved."""
    work, n = scratch.work, v.size
    for k in own:
        if work.bounded.any[0] != 0.0:
            hold_parts(course.part[k], scratch)
        write_residual(course.equation[k], v, course.change[k], scratch, response[k])
    for k in own:
        if state.size > 0 and course.equation[k, 3] > 0.0:
            for j in range(n):
                scratch.ahead[j] = course.ahead[k, j] + (v[j] - course.v[own[0], j])
            rates_of(arm.strain, scratch.ahead, work)
            copy(state, work.state)
            call_late(advance_states, arm.effects.late, (arm, course.equation[k, 3], work))
            copy(work.state, response[k, 2 * n :])


@kernel
def respond_at_strain(arm, keeps, own, later, scratch, difference, response):
    """Responses of all substeps of an evaluation, with the rod's D and G at its strain, or those that are kept."""
    work, course, at, n, m = scratch.work, difference.course, own[0], difference.course.v.shape[1], difference.course.state.shape[1]
    if at == 0 or not keeps:
        strain_matrices(arm, work)
        for k in later:
            write_kept_residual(course.equation[k], course.v[k], course.change[k], work, response[k, n : 2 * n])
    else:
        copy_matrix(difference.rod_damping, work.D)
        copy_matrix(difference.rod_stiffness, work.G)
    copy_matrix(work.D, difference.damping)
    copy_matrix(work.G, difference.stiffness)
    if arm.effects.count > 0:
        call_late(add_implicit, arm.effects.late, (arm, work))
    respond(arm, own, difference.place[n : 2 * n], difference.place[2 * n : 2 * n + m], scratch, course, response)


@kernel
def evaluate_moved(arm, method, keeps, side, own, later, scratch, difference):
    """Evaluation at coordinates that may be moved to a side, 0 or 2, with the strain found anew from the guess in work.xi: responses of all
    its substeps; a status."""
    work, course, place, at = scratch.work, difference.course, difference.place, own[0]
    n, m = course.v.shape[1], course.state.shape[1]
    copy(course.rate[at], work.xi_dot)
    copy(place[2 * n : 2 * n + m], work.state)
    work.clock[0] = course.time[at]
    if evaluate_forces(arm, place[2 * n + m :], place[:n], place[n : 2 * n], HERE if side == 1 else PREDICTED, work) >= 0:
        return NO_STRAIN
    sum_forces(method, scratch)
    if side == 1:
        keep_strain(arm.rod, work, difference)
    respond_at_strain(arm, keeps, own, later, scratch, difference, difference.response[side])
    return OK


@kernel
def evaluate_moved_input(arm, method, keeps, side, own, later, scratch, difference):
    """Evaluation at an internal state or command, or rates, that are moved, at the strain that is there: responses of its substeps."""
    work, course, place = scratch.work, difference.course, difference.place
    n, m = course.v.shape[1], course.state.shape[1]
    copy(course.rate[own[0]], work.xi_dot)
    copy(place[2 * n : 2 * n + m], work.state)
    forces_at_strain(arm, place[2 * n + m :], place[:n], place[n : 2 * n], work)
    sum_forces(method, scratch)
    respond_at_strain(arm, keeps, own, later, scratch, difference, difference.response[side])


@kernel
def evaluate_moved_rates(arm, method, side, own, scratch, difference):
    """Evaluation at rates that are moved, where nothing lies between commands and tensions, as evaluate_moved_input()."""
    work, course, place = scratch.work, difference.course, difference.place
    n, m = course.v.shape[1], course.state.shape[1]
    v, state = place[n : 2 * n], place[2 * n : 2 * n + m]
    copy(state, work.state)
    forces_at_rates(arm, v, difference.mismatch, work)
    sum_forces(method, scratch)
    if arm.effects.count > 0:
        copy_matrix(difference.damping, work.D)
        copy_matrix(difference.stiffness, work.G)
        call_late(add_implicit, arm.effects.late, (arm, work))
    respond(arm, own, v, state, scratch, course, difference.response[side])


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
def keep_strain(rod, work, difference):
    """Keeps the strain that was found, its columns, and the mismatch without the viscous one."""
    copy(work.Phi, difference.Phi)
    for m in range(0, work.xi.size, LANES):
        store(difference.xi, m, load(work.xi, m))
        store(difference.mismatch, m, load(work.mismatch, m) + load(rod.viscosity, m) * load(work.xi_dot, m))


@kernel
def predict_along(column, way, difference, xi):
    """Strain (points x 6) a way along one column from where it is."""
    for m in range(0, xi.size, LANES):
        store(xi, m, load(difference.xi, m) + way * load(difference.Phi, column * xi.size + m))


@kernel
def differentiate(arm, method, keeps, u, own, later, scratch, difference):
    """Derivatives of the substeps `own` that begin at the evaluation of the first of them, and of those `later` whose D and G are kept from
    it; a status."""
    work, course, place, unit, at = scratch.work, difference.course, difference.place, difference.unit, own[0]
    n, m = course.v.shape[1], course.state.shape[1]
    copy(course.q[at], place[:n])
    copy(course.v[at], place[n : 2 * n])
    copy(course.state[at], place[2 * n : 2 * n + m])
    copy(u, place[2 * n + m :])
    copy(course.xi[at], work.xi)
    work.driven[0] = 1.0
    status = evaluate_moved(arm, method, keeps, 1, own, later, scratch, difference)
    if at == 0:
        copy_matrix(difference.damping, difference.rod_damping)
        copy_matrix(difference.stiffness, difference.rod_stiffness)
    between = makes_tensions(arm.effects, work)
    for i in range(n, (unit.size - difference.direct) if status == OK else n):
        here, of_rates = place[i], i < 2 * n and not between
        for side in range(0, 3, 2):
            place[i] = here + (side - 1) * unit[i]
            if of_rates:
                evaluate_moved_rates(arm, method, side, own, scratch, difference)
            else:
                evaluate_moved_input(arm, method, keeps, side, own, later, scratch, difference)
        place[i] = here
        write_slopes(i, own, later[:0] if of_rates else later, difference)
    if difference.direct > 0:
        write_actuation(arm, own, scratch, difference)
    for i in range(n):
        here = place[i]
        for side in range(0, 3, 2):
            way = (side - 1) * unit[i]
            place[i] = here + way
            predict_along(i, way, difference, work.xi)
            if status == OK:
                status = evaluate_moved(arm, method, keeps, side, own, later, scratch, difference)
        place[i] = here
        write_slopes(i, own, later, difference)
    return status
