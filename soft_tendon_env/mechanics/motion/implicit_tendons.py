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
    """Changes by a unit of each of the forces (n_a, n) over a substep of length h: of rates, held.answer, and of how fast tendons are
    pulled in, held.give; and how fast they are at its end so far, held.rate."""
    held, n = scratch.held, scratch.delta.size
    for j in range(len(forces)):
        for a in range(n):
            held.answer[j, a] = h * forces[j, a]
        solve_again(scratch.system, n, held.answer[j])
    for i in range(len(forces)):
        held.rate[i] = product(balance.columns[i], scratch.v) + product(balance.columns[i], scratch.delta)
        for j in range(len(forces)):
            held.give[i, j] = product(balance.columns[i], held.answer[j])


@kernel
def add_answer(j, more, scratch):
    """Adds what a force that is `more` by so much changes to scratch.delta."""
    for a in range(scratch.delta.size):
        scratch.delta[a] += more * scratch.held.answer[j, a]


@phase
def stretch_tendons(arm, command, balance, h, begins, near, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the tensions at its end under a
    command (n_a) there. `begins` in the first substep of a step, which is smooth as long as no tendon goes farther than `near` [m] to
    where it becomes slack, taut or as tense as can be."""
    path, held = arm.effects.transmission, scratch.held
    answer_tendons(balance, balance.rubbed, h, scratch)
    copy(balance.tension, held.tension)
    for i in range(held.rate.size):
        k = path.stiffness[i]
        held.wanted[i] = k * (command[i] - balance.shortening[i] - h * held.rate[i])
        for j in range(held.rate.size):
            give = k * h * held.give[i, j]
            held.matrix[i, j] = give + (1.0 if i == j else 0.0)
            held.wanted[i] += give * balance.tension[j]
    solve_bounded(held.matrix, held.wanted, held.least, path.strength, held.tension, held.part, held.system)
    kinked = False
    for i in range(held.rate.size):
        add_answer(i, held.tension[i] - balance.tension[i], scratch)
        free, part = path.stiffness[i] * (command[i] - balance.shortening[i]), held.part[i]
        beyond = max(-free, free - path.strength[i], 0.0) if part == 0.0 else free if part < 0.0 else path.strength[i] - free
        kinked = kinked or (beyond > path.stiffness[i] * near if begins else part != held.parts[i])
    if begins:
        scratch.kinked[0] = 0.0
        copy(held.part, held.parts)
    if kinked:
        scratch.kinked[0] = 1.0


@phase
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the friction at its end."""
    held, slow, begun = scratch.held, arm.effects.transmission.stiction_speed, balance.pull_rate
    answer_tendons(balance, balance.rubbing, h, scratch)
    copy(held.rate, held.wanted)
    copy(begun, held.rate)
    for i in range(begun.size):
        held.part[i] = 0.0
        for j in range(begun.size):
            held.wanted[i] += held.give[i, j] * begun[j] / math.hypot(begun[j], slow)
    off = unbalanced(held, slow, held.rate)
    for _ in range(MOST):
        if off <= SAME * slow:
            break
        improve_rates(held, slow, True)
        after = unbalanced(held, slow, held.better)
        if not after < 0.5 * off:
            improve_rates(held, slow, False)
            after = unbalanced(held, slow, held.better)
        copy(held.better, held.rate)
        off = after
    for j in range(begun.size):
        add_answer(j, begun[j] / math.hypot(begun[j], slow) - held.rate[j] / math.hypot(held.rate[j], slow), scratch)


@kernel
def unbalanced(held, slow, rate):
    """The most by which rates (n_a) are off those that their friction leaves."""
    most = 0.0
    for i in range(rate.size):
        off = rate[i] - held.wanted[i]
        for j in range(rate.size):
            off += held.give[i, j] * rate[j] / math.hypot(rate[j], slow)
        most = max(most, abs(off))
    return most


@kernel
def improve_rates(held, slow, is_tangent):
    """Rates held.better of the linear problem with the tangents of z at held.rate, or with its secants."""
    rate = held.rate
    copy(held.wanted, held.tension)
    for j in range(rate.size):
        speed = math.hypot(rate[j], slow)
        slope = (slow / speed) ** 2 / speed if is_tangent else 1.0 / speed
        for i in range(rate.size):
            held.tension[i] -= held.give[i, j] * (1.0 / speed - slope) * rate[j]
            held.matrix[i, j] = held.give[i, j] * slope + (1.0 if i == j else 0.0)
    solve_part(held.matrix, held.tension, held.least, held.least, held.better, held.part, held.system)
