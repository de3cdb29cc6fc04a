"""Linearly implicit Euler substep of (23), tension held: (M + h D + h^2 G) dv = h (B u - K - C v -
D v + F - h G v), q += h v.

G is the stiffness of the drive to first order, so the substep is stable at any h; elastic tendons
are held to their tensions at its end. M, the forces and the effects' share of D and G are those of
the substep; the rod's D and G may be those at the start of the step, see extrapolation.

The tensions x of elastic tendons at its end are those of the rates y' = B^T v' at which they are
then pulled in, with v' = v + dv + A^-1 h F (x' - x) and F the forces by x: x = clip(k (u' - s - h
y), 0, strength), see tendon_ends. That is implicit Euler of a monotone force, stable however stiff.
The friction of tendons is that of its end too, see sliding.
"""

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import (
    AT_GREATEST,
    AT_LEAST,
    copy,
    copy_matrix,
    product,
    row_stride,
    solve_again,
    solve_positive_definite,
)
from soft_tendon_env.mechanics.motion.scratch import KINKED, SMOOTH
from soft_tendon_env.mechanics.motion.sliding import slide_tendons
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.motion.tendon_ends import add_answers, bound_tensions
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.evaluate import rod_matrices
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.mechanics.terms.tendon_friction import find_borders, tendons_rub
from soft_tendon_env.mechanics.terms.transmission import find_columns, tendons_transmit


@kernel
def start_matrices(arm, scratch):
    """M, D and G with the effects' share, and the force, of the evaluation at the start of the
    step."""
    matrices = scratch.work.matrices
    rod_matrices(arm, scratch.work)
    if arm.effects.count > 0:
        copy_matrix(matrices.D, scratch.rod_damping)
        copy_matrix(matrices.G, scratch.rod_stiffness)
        add_effects(arm, scratch.work, scratch.first.borders)
    copy_balance(arm, scratch.now, scratch.first)


@kernel
def later_matrices(arm, method, scratch):
    """D and G of a later evaluation into work.matrices, where start_matrices() left those of the
    step's start."""
    matrices = scratch.work.matrices
    if not method.freeze_jacobian:
        rod_matrices(arm, scratch.work)
    elif arm.effects.count > 0:
        copy_matrix(scratch.rod_damping, matrices.D)
        copy_matrix(scratch.rod_stiffness, matrices.G)
    if arm.effects.count > 0:
        add_effects(arm, scratch.work, scratch.now.borders)


@kernel
def add_effects(arm, work, borders):
    """The effects' share of D and G, columns of elastic tendons, and borders of those that rub."""
    add_implicit(arm, work)
    if arm.effects.transmission.elastic:
        share = work.ones.tendon
        find_columns(arm, work.strain, share, work.spare.stress, work.tendons.columns)
    if tendons_rub(arm):
        find_borders(arm, work.strain, borders)


@kernel
def copy_balance(arm, source, out):
    """Copies a balance, but for its borders, into another one."""
    own = source.matrices
    copy_matrix(own.M, out.matrices.M)
    copy_matrix(own.D, out.matrices.D)
    copy_matrix(own.G, out.matrices.G)
    copy(source.force, out.force)
    if tendons_transmit(arm):
        tendons = source.tendons
        copy(tendons.tension, out.tendons.tension)
        copy(tendons.shortening, out.tendons.shortening)
        copy_matrix(tendons.columns, out.tendons.columns)


@kernel
def rate_change(with_inertia, balance, h, scratch):
    """Change of the rates scratch.v in a substep of length h, into scratch.delta; without inertia
    they follow from the forces alone."""
    fill_system(with_inertia, balance, h, scratch)
    n = scratch.delta.size
    is_solved = solve_positive_definite(scratch.system, n, scratch.delta)
    return OK if is_solved else NOT_POSITIVE


@kernel
def fill_system(with_inertia, balance, h, scratch):
    """Fills scratch.system with the system of the change of the rates in a substep of length h."""
    # (M + h D + h^2 G) dv = h (f - h G v)
    matrices = balance.matrices
    force = balance.force
    system = scratch.system
    n = force.size
    stride = row_stride(n + 1)
    share = 1.0 if with_inertia else 0.0
    for i in range(n):
        first = i * stride
        row = system[first : first + n]
        m = matrices.M[i]
        d = matrices.D[i]
        g = matrices.G[i]
        # left of the diagonal too, where nothing is read: whole rows are quicker
        for j in range(n):
            row[j] = share * m[j] + h * (d[j] + h * g[j])
        stiff = product(g, scratch.v)
        system[first + n] = h * (force[i] - h * stiff)


@kernel
def answer_tendons(balance, forces, h, scratch):
    """Changes by a unit of each of the forces (n_a, n) over a substep of length h: of rates,
    ends.answer, and of how fast tendons are pulled in, ends.give; and how fast they are at its end
    so far, ends.rate."""
    ends = scratch.ends
    n = scratch.delta.size
    count = len(forces)
    for j in range(count):
        answer = ends.answer[j]
        for a in range(n):
            answer[a] = h * forces[j, a]
        solve_again(scratch.system, n, answer)
    for i in range(count):
        column = balance.tendons.columns[i]
        rate = product(column, scratch.v)
        ends.rate[i] = rate + product(column, scratch.delta)
        for j in range(count):
            ends.give[i, j] = product(column, ends.answer[j])


@phase
def stretch_tendons(arm, command, balance, h, scratch):
    """Changes scratch.delta to what it is with the tensions at the end of a substep.

    The substep of length h has just been solved; a command (n_a) acts at its end.
    """
    path = arm.effects.transmission
    ends = scratch.ends
    tendons = balance.tendons
    answer_tendons(balance, tendons.columns, h, scratch)
    bound_tensions(path, command, tendons.shortening, h, tendons.tension, ends)
    for i in range(command.size):
        ends.change[i] = ends.tension[i] - tendons.tension[i]
    add_answers(ends, scratch.delta)


@kernel
def find_kink(path, command, shortening, substep, scratch):
    """Whether tensions have kinks within the step, into scratch.kink: in the substep that is the
    step alone, where one goes farther to a kink than is near; in others, where they are in another
    part of their range than in that one."""
    ends = scratch.ends
    if substep.is_alone:
        scratch.kink[0] = SMOOTH
    for i in range(command.size):
        if substep.is_alone:
            stretch = command[i] - shortening[i]
            taut = path.stiffness[i] * stretch
            beyond = beyond_kink(ends.part[i], taut, path.strength[i])
            is_kinked = beyond > path.stiffness[i] * substep.near
            ends.first_part[i] = ends.part[i]
        else:
            is_kinked = ends.part[i] != ends.first_part[i]
        if is_kinked:
            scratch.kink[0] = KINKED


@kernel
def beyond_kink(part, taut, strength):
    """How far [N] a tension that would be `taut` [N] without its bounds is from the part of its
    range that it comes to."""
    if part == AT_LEAST:
        return taut
    if part == AT_GREATEST:
        return strength - taut
    return max(-taut, taut - strength, 0.0)


@kernel
def implicit_euler(arm, method, arrived, motion, substep, scratch):
    """One substep from scratch.q, scratch.v, in place, under what has arrived (n_a), from the
    evaluation at its beginning; a status."""
    h = substep.length
    q = scratch.q
    v = scratch.v
    delta = scratch.delta
    balance = scratch.first
    if substep.number > 0:
        later_matrices(arm, method, scratch)
        balance = scratch.now
    path = arm.effects.transmission
    command = arrived
    if path.elastic:
        end = (substep.number + 1) * h
        command = command_at(arm.effects, arrived, motion.state, end, scratch.acting)
    if tendons_rub(arm):
        fill_system(method.with_inertia, balance, h, scratch)
        slide_tendons(arm, command, balance, substep, scratch)
        status = scratch.sliding.status[0]
    else:
        status = rate_change(method.with_inertia, balance, h, scratch)
    if status != OK:
        return status
    if path.elastic:
        if not tendons_rub(arm):
            stretch_tendons(arm, command, balance, h, scratch)
        find_kink(path, command, balance.tendons.shortening, substep, scratch)
    for i in range(q.size):
        v[i] += delta[i]
        q[i] += h * v[i]
    return OK
