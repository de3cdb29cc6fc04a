"""Tendons that rub in a substep: their friction by the rates at its end, however steep it is at rest.

With the change of rates dv of the friction at the rates v that the force has, those at the end are v' = v + dv - A^-1 h R (z(y') - z(y)),
with y = B^T v the rates at which tendons are pulled in and -R the derivative of the force by their directions of sliding z. That is
implicit Euler of a monotone force, for the tendons alone: by Newton's method, and where that does not come nearer with the secants of z.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.bounded import solve_part
from soft_tendon_env.mechanics.algebra.linear import copy, product, solve_again

MOST = 30  # linear problems
SAME = 1e-6  # of the stiction speed, what rates may be off


@phase
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the friction at its end."""
    held, n_a, slow = scratch.held, arm.tendons.size, arm.effects.transmission.stiction_speed
    for j in range(n_a):
        for a in range(scratch.delta.size):
            held.answer[j, a] = h * balance.rubbing[j, a]
        solve_again(scratch.system, scratch.delta.size, held.answer[j])
    for i in range(n_a):
        held.part[i] = 0.0
        held.rate[i] = balance.pull_rate[i]
        held.wanted[i] = product(balance.columns[i], scratch.v) + product(balance.columns[i], scratch.delta)
        for j in range(n_a):
            held.give[i, j] = product(balance.columns[i], held.answer[j])
            held.wanted[i] += held.give[i, j] * balance.pull_rate[j] / math.hypot(balance.pull_rate[j], slow)
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
    for j in range(n_a):
        more = held.rate[j] / math.hypot(held.rate[j], slow) - balance.pull_rate[j] / math.hypot(balance.pull_rate[j], slow)
        for a in range(scratch.delta.size):
            scratch.delta[a] -= more * held.answer[j, a]


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
