"""Tendons at the end of a substep: their friction, and the tensions of elastic ones, however stiff they are.

The substep has the friction and the tensions of its beginning, which gave a change of rates dv. Those x of the end are those of the rates
y' = B^T v' at which tendons are then pulled in, with v' = v + dv + A^-1 h F (x' - x) and F the forces by x. That is implicit Euler of a
monotone force, stable however stiff, and a problem of the tendons alone: n_a unknowns.

- x = -z(y) of tendons that rub, z = y / sqrt(y^2 + v_s^2): by Newton's method, and where that comes no nearer by the secants of z.
- x = clip(k (u' - s - h y), 0, strength) of elastic ones, a complementarity problem (D. E. Stewart and J. C. Trinkle 1996).
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.bounded import solve_bounded, solve_part
from soft_tendon_env.mechanics.algebra.linear import copy, product, solve_again

MOST = 30  # linear problems
SAME = 1e-6  # of the stiction speed, what rates may be off


@kernel
def answer_tendons(balance, forces, h, scratch):
    """Changes by a unit of each of the forces (n_a, n) over a substep of length h: of rates, ends.answer, and of how fast tendons are
    pulled in, ends.give; and how fast they are at its end so far, ends.rate."""
    ends, n = scratch.ends, scratch.delta.size
    for j in range(len(forces)):
        for a in range(n):
            ends.answer[j, a] = h * forces[j, a]
        solve_again(scratch.system, n, ends.answer[j])
    for i in range(len(forces)):
        ends.rate[i] = product(balance.columns[i], scratch.v) + product(balance.columns[i], scratch.delta)
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
    """Changes scratch.delta, of the substep that has just been solved, to what it is with the tensions at its end under a command (n_a)
    there. The substep that is a step alone tells whether the step is smooth."""
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
    solve_bounded(ends.matrix, ends.wanted, ends.least, path.strength, ends.tension, ends.part, ends.system)
    is_kinked = scratch.is_kinked[0] != 0.0 and not substep.is_alone
    for i in range(command.size):
        ends.wanted[i] = ends.tension[i] - balance.tension[i]
        free, part = path.stiffness[i] * (command[i] - balance.shortening[i]), ends.part[i]
        beyond = max(-free, free - path.strength[i], 0.0) if part == 0.0 else free if part < 0.0 else path.strength[i] - free
        is_kinked = is_kinked or (beyond > path.stiffness[i] * substep.near if substep.is_alone else part != ends.parts[i])
    add_answers(ends, scratch.delta)
    if substep.is_alone:
        copy(ends.part, ends.parts)
    scratch.is_kinked[0] = 1.0 if is_kinked else 0.0


@phase
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the friction at its end."""
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
        ends.wanted[j] = begun[j] / math.hypot(begun[j], slow) - ends.rate[j] / math.hypot(ends.rate[j], slow)
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
    """Rates ends.better of the linear problem with the tangents of z at ends.rate, or with its secants."""
    rate = ends.rate
    copy(ends.wanted, ends.tension)
    for j in range(rate.size):
        speed = math.hypot(rate[j], slow)
        slope = (slow / speed) ** 2 / speed if is_tangent else 1.0 / speed
        for i in range(rate.size):
            ends.tension[i] -= ends.give[i, j] * (1.0 / speed - slope) * rate[j]
            ends.matrix[i, j] = ends.give[i, j] * slope + (1.0 if i == j else 0.0)
    solve_part(ends.matrix, ends.tension, ends.least, ends.least, ends.better, ends.part, ends.system)
