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
    AT_GREATEST,
    AT_LEAST,
    BETWEEN,
    copy,
    copy_matrix,
    product,
    row_stride,
    solve_again,
    solve_bounded,
    solve_part,
    solve_positive_definite,
)
from soft_tendon_env.mechanics.motion.scratch import KINKED, SMOOTH
from soft_tendon_env.mechanics.motion.status import NOT_POSITIVE, OK
from soft_tendon_env.mechanics.terms.command_filter import command_at
from soft_tendon_env.mechanics.terms.evaluate import rod_matrices
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.mechanics.terms.transmission import (
    find_columns,
    tendons_rub,
    tendons_transmit,
)

MOST = 30  # linear problems for the friction of tendons
SAME = 1e-6  # of the stiction speed, what rates may be off


@kernel
def start_matrices(arm, scratch):
    """M, D and G with the effects' share, and the force, of the evaluation at the start of the
    step."""
    matrices = scratch.work.matrices
    rod_matrices(arm, scratch.work)
    if arm.effects.count > 0:
        copy_matrix(matrices.D, scratch.rod_damping)
        copy_matrix(matrices.G, scratch.rod_stiffness)
        add_effects(arm, scratch.work)
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
        add_effects(arm, scratch.work)


@kernel
def add_effects(arm, work):
    """The effects' share of D and G, and columns of tendons that are elastic or rub."""
    add_implicit(arm, work)
    if tendons_transmit(arm):
        find_columns(arm, work.strain, work.friction, work.ones, work.spare.stress, work.tendons)


@kernel
def copy_balance(arm, source, out):
    """Copies a balance into another one."""
    copy_matrix(source.matrices.M, out.matrices.M)
    copy_matrix(source.matrices.D, out.matrices.D)
    copy_matrix(source.matrices.G, out.matrices.G)
    copy(source.force, out.force)
    if tendons_transmit(arm):
        copy(source.tendons.tension, out.tendons.tension)
        copy(source.tendons.shortening, out.tendons.shortening)
        copy(source.tendons.pull_rate, out.tendons.pull_rate)
        copy_matrix(source.tendons.columns, out.tendons.columns)
        copy_matrix(source.tendons.rubbed, out.tendons.rubbed)
        copy_matrix(source.tendons.rubbing, out.tendons.rubbing)


@kernel
def rate_change(with_inertia, balance, h, scratch):
    """Change of the rates scratch.v in a substep of length h, into scratch.delta; without inertia
    they follow from the forces alone."""
    # (M + h D + h^2 G) dv = h (f - h G v)
    matrices = balance.matrices
    force = balance.force
    system = scratch.system
    n = force.size
    stride = row_stride(n + 1)
    share = 1.0 if with_inertia else 0.0
    for i in range(n):
        row = system[i * stride : i * stride + n]
        m = matrices.M[i]
        d = matrices.D[i]
        g = matrices.G[i]
        # left of the diagonal too, where nothing is read: whole rows are quicker
        for j in range(n):
            row[j] = share * m[j] + h * (d[j] + h * g[j])
        stiff = product(g, scratch.v)
        system[i * stride + n] = h * (force[i] - h * stiff)
    return OK if solve_positive_definite(system, n, scratch.delta) else NOT_POSITIVE


@kernel
def answer_tendons(balance, forces, h, scratch):
    """Changes by a unit of each of the forces (n_a, n) over a substep of length h: of rates,
    ends.answer, and of how fast tendons are pulled in, ends.give; and how fast they are at its end
    so far, ends.rate."""
    ends = scratch.ends
    n = scratch.delta.size
    for j in range(len(forces)):
        for a in range(n):
            ends.answer[j, a] = h * forces[j, a]
        solve_again(scratch.system, n, ends.answer[j])
    for i in range(len(forces)):
        column = balance.tendons.columns[i]
        ends.rate[i] = product(column, scratch.v) + product(column, scratch.delta)
        for j in range(len(forces)):
            ends.give[i, j] = product(column, ends.answer[j])


@kernel
def add_answers(ends, delta):
    """Adds to delta (n) what forces change that are ends.change (n_a) more."""
    for j in range(ends.change.size):
        for a in range(delta.size):
            delta[a] += ends.change[j] * ends.answer[j, a]


@phase
def stretch_tendons(arm, command, balance, substep, scratch):
    """Changes scratch.delta, of the substep that has just been solved, to what it is with the
    tensions at its end under a command (n_a) there. The substep that is a step alone tells whether
    the step is smooth."""
    path = arm.effects.transmission
    ends = scratch.ends
    tendons = balance.tendons
    h = substep.length
    answer_tendons(balance, tendons.rubbed, h, scratch)
    # x + k h give (x - x_before) = k (u - s - h y) between 0 and the strength
    for i in range(command.size):
        k = path.stiffness[i]
        stretched = command[i] - tendons.shortening[i] - h * ends.rate[i]
        ends.right[i] = k * stretched
        for j in range(command.size):
            give = k * h * ends.give[i, j]
            ends.matrix[i, j] = give + (1.0 if i == j else 0.0)
            ends.right[i] += give * tendons.tension[j]
    copy(tendons.tension, ends.tension)
    solve_bounded(
        ends.matrix,
        ends.right,
        ends.least,
        path.strength,
        ends.tension,
        ends.part,
        ends.system,
    )
    for i in range(command.size):
        ends.change[i] = ends.tension[i] - tendons.tension[i]
    add_answers(ends, scratch.delta)
    find_kink(path, command, tendons.shortening, substep, scratch)


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
            taut = path.stiffness[i] * (command[i] - shortening[i])
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


@phase
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is
    with the friction at its end."""
    ends = scratch.ends
    slow = arm.effects.transmission.stiction_speed
    begun = balance.tendons.pull_rate
    answer_tendons(balance, balance.tendons.rubbing, h, scratch)
    # rates without the friction of the beginning, z(begun)
    for i in range(begun.size):
        free = ends.rate[i]
        for j in range(begun.size):
            free += ends.give[i, j] * begun[j] / math.hypot(begun[j], slow)
        ends.free_rate[i] = free
    # y + give z(y) = free_rate, from y = begun
    copy(begun, ends.rate)
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
        before = begun[j] / math.hypot(begun[j], slow)
        ends.change[j] = before - ends.rate[j] / math.hypot(ends.rate[j], slow)
    add_answers(ends, scratch.delta)


@kernel
def imbalance(ends, slow, rate):
    """The most by which rates (n_a) are off those that their friction leaves."""
    most = 0.0
    for i in range(rate.size):
        off = rate[i] - ends.free_rate[i]
        for j in range(rate.size):
            off += ends.give[i, j] * rate[j] / math.hypot(rate[j], slow)
        most = max(most, abs(off))
    return most


@kernel
def improve_rates(ends, slow, is_tangent):
    """Rates ends.better of the linear problem with the tangents of z at ends.rate, or with its
    secants."""
    rate = ends.rate
    copy(ends.free_rate, ends.right)
    for j in range(rate.size):
        speed = math.hypot(rate[j], slow)
        secant = 1.0 / speed
        slope = (slow / speed) ** 2 / speed if is_tangent else secant
        for i in range(rate.size):
            ends.right[i] -= ends.give[i, j] * (secant - slope) * rate[j]
            ends.matrix[i, j] = ends.give[i, j] * slope + (1.0 if i == j else 0.0)
    for i in range(rate.size):
        ends.part[i] = BETWEEN
    solve_part(
        ends.matrix,
        ends.right,
        ends.least,
        ends.least,
        ends.better,
        ends.part,
        ends.system,
    )


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
    status = rate_change(method.with_inertia, balance, h, scratch)
    if status != OK:
        return status
    if tendons_rub(arm):
        slide_tendons(arm, balance, h, scratch)
    if arm.effects.transmission.elastic:
        end = (substep.number + 1) * h
        command = command_at(arm.effects, arrived, motion.state, end, scratch.acting)
        stretch_tendons(arm, command, balance, substep, scratch)
    for i in range(q.size):
        v[i] += delta[i]
        q[i] += h * v[i]
    return OK
