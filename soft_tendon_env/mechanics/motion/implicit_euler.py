"""Linearly implicit Euler substep of (23), tension held: (M + h D + h^2 G) dv = h (B u - K - C v - D v + F - h G v), q += h v.

G is the stiffness of the drive to first order, so the substep is stable at any h. Tensions of tendons that hang slack stay within bounds
(`hold_bounds`). M, the forces and the effects' share of D and G are those of the substep; the rod's own D and G may be those at the
start of the step, see extrapolation.
"""

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix, product, row_stride, solve_positive_definite
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.mechanics.terms.parametrisation import strain_matrices
from soft_tendon_env.mechanics.terms.transmission import change_parts, way_to_part

MOST_AT_ONCE, MOST_ONE_BY_ONE = 8, 64  # solutions of a substep with bounded tensions, all of which or one of which change in each
NEAR = 0.05  # of a step's tolerance, the way of a tendon to a bound of its tension that it may go in a step that is extrapolated


@kernel
def start_matrices(arm, scratch):
    """M, D and G with the effects' share, and the force, of the evaluation at the start of the step."""
    work = scratch.work
    strain_matrices(arm, work)
    if arm.effects.count > 0:
        copy_matrix(work.D, scratch.rod_damping)
        copy_matrix(work.G, scratch.rod_stiffness)
        add_implicit(arm, work)
    now, first = scratch.now, scratch.first
    copy_matrix(now.mass, first.mass)
    copy_matrix(now.damping, first.damping)
    copy_matrix(now.stiffness, first.stiffness)
    copy(now.force, first.force)
    copy(now.drift, first.drift)
    if work.bounded.any[0] != 0.0:
        keep_bounded(scratch)


@phase
def keep_bounded(scratch):
    """Keeps the tensions with bounds at the start of the step, and their columns."""
    source, kept = scratch.now.bounded, scratch.first.bounded
    copy(source.free, kept.free)
    copy(source.stiffness, kept.stiffness)
    copy(source.least, kept.least)
    copy(source.greatest, kept.greatest)
    copy(source.part, kept.part)
    copy_matrix(scratch.now.columns, scratch.first.columns)


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
        add_implicit(arm, work)


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


@phase
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
    if substep > 0:
        later_matrices(arm, method, scratch)
    balance = scratch.now if substep > 0 else scratch.first
    status = rate_change(with_inertia, balance, h, scratch)
    if status == OK and work.bounded.any[0] != 0.0:
        hold_bounds(row == 0, NEAR * tolerance, with_inertia, balance, h, scratch)
        status = int(scratch.held[0])
    if status == OK:
        move(h, scratch)
    return status
