"""Tendons that rub in a substep: their friction by the rates at its end, however steep it is at rest.

With the change of rates dv of the friction at the rates v that the force has, those at the end are v' = v + dv - A^-1 h R (z(y') - z(y)),
with y = B^T v the rates at which tendons are pulled in and -R the derivative of the force by their directions of sliding z. That is
implicit Euler of a monotone force, for the tendons alone: a fixed point of linear problems with the secants of z, which only come down.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.bounded import solve_part
from soft_tendon_env.mechanics.algebra.linear import product, solve_factored
from soft_tendon_env.mechanics.late_kernels import late
from soft_tendon_env.mechanics.motion.scratch import make_scratch

MOST = 30  # linear problems
SAME = 1e-6  # change of a direction of sliding that ends them


def _example(arm):
    """Examples of the arguments of slide_tendons()."""
    scratch = make_scratch(arm, 1)
    return arm, scratch.now, 0.0, scratch


@late(lambda effects: effects.transmission.friction > 0.0, _example)
@kernel
def slide_tendons(arm, balance, h, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the friction at its end."""
    held, n_a, slow = scratch.held, arm.tendons.size, arm.effects.transmission.stiction_speed
    for j in range(n_a):
        for a in range(scratch.delta.size):
            held.answer[j, a] = h * balance.rubbing[j, a]
        solve_factored(scratch.system, scratch.delta.size, held.answer[j])
    for i in range(n_a):
        held.part[i] = 0.0
        held.rate[i] = balance.pull_rate[i]
        held.wanted[i] = product(balance.columns[i], scratch.v) + product(balance.columns[i], scratch.delta)
        for j in range(n_a):
            held.give[i, j] = product(balance.columns[i], held.answer[j])
            held.wanted[i] += held.give[i, j] * balance.pull_rate[j] / math.hypot(balance.pull_rate[j], slow)
    for _ in range(MOST):
        for j in range(n_a):
            secant = 1.0 / math.hypot(held.rate[j], slow)
            held.tension[j] = held.rate[j] * secant
            for i in range(n_a):
                held.matrix[i, j] = held.give[i, j] * secant + (1.0 if i == j else 0.0)
        solve_part(held.matrix, held.wanted, held.least, held.least, held.rate, held.part, held.system)
        change = 0.0
        for j in range(n_a):
            change = max(change, abs(held.rate[j] / math.hypot(held.rate[j], slow) - held.tension[j]))
        if change < SAME:
            break
    for j in range(n_a):
        more = held.rate[j] / math.hypot(held.rate[j], slow) - balance.pull_rate[j] / math.hypot(balance.pull_rate[j], slow)
        for a in range(scratch.delta.size):
            scratch.delta[a] -= more * held.answer[j, a]
