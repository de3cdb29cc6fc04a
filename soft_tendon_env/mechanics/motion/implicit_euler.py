"""Linearly implicit Euler substep of (23), tension held: (M + h D + h^2 G) dv = h (B u - K - C v -
D v + F - h G v), q += h v.

G is the stiffness of the drive to first order, so the substep is stable at any h; elastic tendons
are held to their tensions at its end. M, the forces and the effects' share of D and G are those of
the substep; the rod's D and G may be those at the start of the step, see extrapolation.

The friction and the tensions x of tendons at its end are those of the rates y' = B^T v' at which
they are then pulled in, with v' = v + dv + A^-1 h F (x' - x) and F the forces by x. That is
implicit Euler of a monotone force, stable however stiff: a problem of n_a unknowns.

- x = -z(y) of tendons that rub, z = y / sqrt(y^2 + v_s^2): by Newton's method, and where that comes
no nearer by the secants of z.
- x = clip(k (u' - s - h y), 0, strength) of elastic ones, a complementarity problem (D. E. Stewart
and J. C. Trinkle 1996).
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import (
    copy,
    copy_matrix,
    product,
    row_stride,
    solve_again,
    solve_bounded,
    solve_part,
    solve_positive_definite,
)
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.mechanics.terms.parametrisation import strain_matrices

MOST = 30  # linear problems for the friction of tendons
SAME = 1e-6  # of the stiction speed, what rates may be off


@kernel
def start_matrices(arm, scratch):
    """M, D and G with the effects' share, and the force, of the evaluation at the start of the
    step."""
    work = scratch.work
    strain_matrices(arm, work)
    if arm.effects.count > 0:
        copy_matrix(work.D, scratch.rod_damping)
        copy_matrix(work.G, scratch.rod_stiffness)
        add_implicit(arm, work)
    now, first = scratch.now, scratch.first
    for matrix, out in (
        (now.mass, first.mass),
        (now.damping, first.damping),
        (now.stiffness, first.stiffness),
    ):
        copy_matrix(matrix, out)
    copy(now.force, first.force)
    if arm.effects.transmission.elastic or arm.effects.transmission.friction > 0.0:
        for matrix, out in (
            (now.columns, first.columns),
            (now.rubbed, first.rubbed),
            (now.rubbing, first.rubbing),
        ):
            copy_matrix(matrix, out)
        for vector, out in (
            (now.tension, first.tension),
            (now.shortening, first.shortening),
            (now.pull_rate, first.pull_rate),
        ):
            copy(vector, out)


@kernel
def later_matrices(arm, method, scratch):
    """D and G of a later evaluation into work.D and work.G, where start_matrices() left those of
    the step's start."""
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
    """Change of the rates scratch.v in a substep of length h, into scratch.delta; without inertia
    they follow from the forces alone."""
    mass, damping, stiffness, force = (
        balance.mass,
        balance.damping,
        balance.stiffness,
        balance.force,
    )
    n = force.size
    system, delta, v = scratch.system, scratch.delta, scratch.v
    stride = row_stride(n + 1)
    share = 1.0 if with_inertia else 0.0
    for i in range(n):
        row, m, d, g = system[i * stride : i * stride + n], mass[i], damping[i], stiffness[i]
        for j in range(
            n
        ):  # left of the diagonal too, where nothing is read: whole rows are quicker
            row[j] = share * m[j] + h * (d[j] + h * g[j])
        system[i * stride + n] = h * (force[i] - h * product(g, v))
    return OK if solve_positive_definite(system, n, delta) else NOT_POSITIVE


@kernel
def answer_tendons(balance, forces, h, scratch):
    """Changes by a unit of each of the forces (n_a, n) over a substep of length h: of rates,
    ends.answer, and of how fast tendons are pulled in, ends.give; and how fast they are at its end
    so far, ends.rate."""
    ends, n = scratch.ends, scratch.delta.size
    for j in range(len(forces)):
        for a in range(n):
            ends.answer[j, a] = h * forces[j, a]
        solve_again(scratch.system, n, ends.answer[j])
    for i in range(len(forces)):
        ends.rate[i] = product(balance.columns[i], scratch.v) + product(
            balance.columns[i], scratch.delta
        )
        for j in range(len(forces)):
            ends.give[i, j] = product(balance.columns[i], ends.answer[j])


@kernel
def add_answers(ends, delta):
    """Adds to delta (n) what forces change that are ends.wanted (n_a) more."""
    for j in range(ends.wanted.size):
        for a in range(delta.size):
            delta[a] += ends.wanted[j] * ends.answer[j, a]


@phase
def stretch_tendons(arm, command, balance, substep, scratch):
    """Changes scratch.delta, of the substep that has just been solved, to what it is with the
    tensions at its end under a command (n_a) there. The substep that is a step alone tells whether
    the step is smooth."""
    path, ends, h = arm.effects.transmission, scratch.ends, substep.length
    answer_tendons(balance, balance.rubbed, h, scratch)
    copy(balance.tension, ends.tension)
    for i in range(command.size):
        k = path.stiffness[i]
        ends.wanted[i] = k * (command[i] - balance.shortening[i] - h * ends.rate[i])
        for j in range(command.size):
            give = k * h * ends.give[i, j]
            ends.matrix[i, j] = give + (1.0 if i == j else 0.0)
            ends.wanted[i] += give * balance.tension[j]
    solve_bounded(
        ends.matrix, ends.wanted, ends.least, path.strength, ends.tension, ends.part, ends.system
    )
    is_kinked = scratch.is_kinked[0] != 0.0 and not substep.is_alone
    for i in range(command.size):
        ends.wanted[i] = ends.tension[i] - balance.tension[i]
        free, part = path.stiffness[i] * (command[i] - balance.shortening[i]), ends.part[i]
        beyond = (
            max(-free, free - path.strength[i], 0.0)
            if part == 0.0
            else free
            if part < 0.0
            else path.strength[i] - free
        )
        is_kinked = is_kinked or (
            beyond > path.stiffness[i] * substep.near if substep.is_alone else part != ends.parts[i]
        )
    add_answers(ends, scratch.delta)
    if substep.is_alone:
        copy(ends.part, ends.parts)
    scratch.is_kinked[0] = 1.0 if is_kinked else 0.0


@phase
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is
    with the friction at its end."""
    ends, slow, begun = scratch.ends, arm.effects.transmission.stiction_speed, balance.pull_rate
    answer_tendons(balance, balance.rubbing, h, scratch)
    copy(ends.rate, ends.wanted)
    copy(begun, ends.rate)
    for i in range(begun.size):
        ends.part[i] = 0.0
        for j in range(begun.size):
            ends.wanted[i] += ends.give[i, j] * begun[j] / math.hypot(begun[j], slow)
    off = imbalance(ends, slow, ends.rate)
    for _ in range(MOST):
        if off <= SAME * slow:
            break
        improve_rates(ends, slow, True)
        after = imbalance(ends, slow, ends.better)
        if not after < 0.5 * off:
            improve_rates(ends, slow, False)
            after = imbalance(ends, slow, ends.better)
        copy(ends.better, ends.rate)
        off = after
    for j in range(begun.size):
        ends.wanted[j] = begun[j] / math.hypot(begun[j], slow) - ends.rate[j] / math.hypot(
            ends.rate[j], slow
        )
    add_answers(ends, scratch.delta)


@kernel
def imbalance(ends, slow, rate):
    """The most by which rates (n_a) are off those that their friction leaves."""
    most = 0.0
    for i in range(rate.size):
        off = rate[i] - ends.wanted[i]
        for j in range(rate.size):
            off += ends.give[i, j] * rate[j] / math.hypot(rate[j], slow)
        most = max(most, abs(off))
    return most


@kernel
def improve_rates(ends, slow, is_tangent):
    """Rates ends.better of the linear problem with the tangents of z at ends.rate, or with its
    secants."""
    rate = ends.rate
    copy(ends.wanted, ends.tension)
    for j in range(rate.size):
        speed = math.hypot(rate[j], slow)
        slope = (slow / speed) ** 2 / speed if is_tangent else 1.0 / speed
        for i in range(rate.size):
            ends.tension[i] -= ends.give[i, j] * (1.0 / speed - slope) * rate[j]
            ends.matrix[i, j] = ends.give[i, j] * slope + (1.0 if i == j else 0.0)
    solve_part(
        ends.matrix, ends.tension, ends.least, ends.least, ends.better, ends.part, ends.system
    )


@kernel
def implicit_euler(arm, method, u, motion, substep, scratch):
    """One substep from scratch.q, scratch.v, in place, under what has arrived, u (n_a), from the
    evaluation at its beginning; a status."""
    h, q, v, delta, balance = substep.length, scratch.q, scratch.v, scratch.delta, scratch.first
    if substep.number > 0:
        later_matrices(arm, method, scratch)
        balance = scratch.now
    status = rate_change(method.with_inertia, balance, h, scratch)
    if status == OK:
        if arm.effects.transmission.friction > 0.0:
            slide_tendons(arm, balance, h, scratch)
        if arm.effects.transmission.elastic:
            command = command_at(
                arm.effects, u, motion.state, (substep.number + 1) * h, scratch.command
            )
            stretch_tendons(arm, command, balance, substep, scratch)
        for i in range(q.size):
            v[i] += delta[i]
            q[i] += h * v[i]
    return status
