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
    for matrix, out in ((now.mass, first.mass), (now.damping, first.damping), (now.stiffness, first.stiffness)):
        copy_matrix(matrix, out)
    copy(now.force, first.force)
    if arm.effects.transmission.elastic or arm.effects.transmission.friction > 0.0:
        for matrix, out in ((now.columns, first.columns), (now.rubbed, first.rubbed), (now.rubbing, first.rubbing)):
            copy_matrix(matrix, out)
        for vector, out in ((now.tension, first.tension), (now.shortening, first.shortening), (now.pull_rate, first.pull_rate)):
            copy(vector, out)


@kernel
def later_matrices(arm, method, scratch):
    """D and G of a later evaluation into work.D and work.G, where start_matrices() left those of the step's start."""
    work = scratch.work
    if not method.freeze_jacobian:
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
def implicit_euler(arm, method, u, motion, substep, scratch):
    """One substep from scratch.q, scratch.v, in place, under what has arrived, u (n_a), from the evaluation at its beginning; a status."""
    h, q, v, delta, balance = substep.length, scratch.q, scratch.v, scratch.delta, scratch.first
    if substep.number > 0:
        later_matrices(arm, method, scratch)
        balance = scratch.now
    status = rate_change(method.with_inertia, balance, h, scratch)
    if status == OK:
        if arm.effects.transmission.friction > 0.0:
            slide_tendons(arm, balance, h, scratch)
        if arm.effects.transmission.elastic:
            command = command_at(arm.effects, u, motion.state, (substep.number + 1) * h, scratch.command)
            stretch_tendons(arm, command, balance, substep, scratch)
        for i in range(q.size):
            v[i] += delta[i]
            q[i] += h * v[i]
    return status
