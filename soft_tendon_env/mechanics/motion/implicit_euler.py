"""Linearly implicit Euler substep of (23), tension held: (M + h D + h^2 G) dv = h (B u - K - C v - D v + F - h G v), q += h v.

G is the stiffness of the drive to first order, so the substep is stable at any h; elastic tendons are held to their tensions at its end.
M, the forces and the effects' share of D and G are those of the substep; the rod's own D and G may be those at the start of the step, see
extrapolation.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix, product, row_stride, solve_positive_definite
from soft_tendon_env.mechanics.motion.implicit_tendons import slide_tendons, stretch_tendons
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.mechanics.terms.parametrisation import strain_matrices
from soft_tendon_env.mechanics.terms.transmission import add_tendon_matrices

NEAR = 0.05  # of a step's tolerance: how far a tendon may go to a kink of its tension in a step that is extrapolated


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
    if arm.effects.transmission.elastic or arm.effects.transmission.friction > 0.0:
        copy(now.tension, first.tension)
        copy(now.shortening, first.shortening)
        copy(now.pull_rate, first.pull_rate)
        copy_matrix(now.columns, first.columns)
        copy_matrix(now.rubbed, first.rubbed)
        copy_matrix(now.rubbing, first.rubbing)


@kernel
def linear_matrices(arm, scratch):
    """start_matrices(), with elastic tendons and those that rub: for what is linear in the motion."""
    start_matrices(arm, scratch)
    add_tendon_matrices(arm, scratch.work, scratch.first.damping, scratch.first.stiffness)


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
    mass, damping, stiffness, force = balance.mass, balance.damping, balance.stiffness, balance.force
    n = force.size
    system, delta, v = scratch.system, scratch.delta, scratch.v
    stride = row_stride(n + 1)
    share = 1.0 if with_inertia else 0.0
    for i in range(n):
        row, m, d, g = system[i * stride : i * stride + n], mass[i], damping[i], stiffness[i]
        for j in range(n):  # left of the diagonal too, where nothing is read: whole rows are quicker
            row[j] = share * m[j] + h * (d[j] + h * g[j])
        system[i * stride + n] = h * (force[i] - h * product(g, v))
    return OK if solve_positive_definite(system, n, delta) else NOT_POSITIVE


@kernel
def move(h, scratch):
    """Take the change of rates that was found over a substep of length h, from scratch.q, scratch.v, in place."""
    delta, q, v = scratch.delta, scratch.q, scratch.v
    for i in range(q.size):
        v[i] += delta[i]
        q[i] += h * v[i]


@kernel
def implicit_euler(arm, method, tolerance, u, motion, step, row, substep, scratch):
    """One substep from scratch.q, scratch.v, in place, under what has arrived, u (n_a): the first of a row from the evaluation at the start
    of the step."""
    h = step / (row + 1)
    if substep > 0:
        later_matrices(arm, method, scratch)
    balance = scratch.now if substep > 0 else scratch.first
    status = rate_change(method.with_inertia, balance, h, scratch)
    if status == OK:
        if arm.effects.transmission.friction > 0.0:
            slide_tendons(arm, balance, h, scratch)
        if arm.effects.transmission.elastic:
            command = command_at(arm.effects, u, motion.state, (substep + 1) * h, scratch.command)
            stretch_tendons(arm, command, balance, h, row == 0, NEAR * tolerance, scratch)
        move(h, scratch)
    return status
