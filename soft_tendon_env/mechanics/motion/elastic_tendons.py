"""Elastic tendons in a substep: their tensions at its end, each between nothing and the strength of its actuator.

With the change of rates dv of the tensions T that the force has, those at the end are T' = clip(k (u' - s - h B^T v'), 0, strength) with
v' = v + dv + h A^-1 B (T' - T): implicit Euler of a force that is monotone, stable however stiff tendons are, and a complementarity
problem of the tendons alone (D. E. Stewart and J. C. Trinkle 1996). B of the forces has what friction leaves.
"""

from soft_tendon_env.compiler.compilation import phase
from soft_tendon_env.mechanics.algebra.bounded import solve_bounded
from soft_tendon_env.mechanics.algebra.linear import copy, product, solve_again


@phase
def stretch_tendons(arm, command, balance, h, begins, near, scratch):
    """Changes scratch.delta, of the substep of length h that has just been solved, to what it is with the tensions at its end under a
    command (n_a) there. `begins` in the first substep of a step, which is smooth as long as no tendon goes farther than `near` [m] to
    where it becomes slack, taut or as tense as can be."""
    path, held, n_a = arm.effects.transmission, scratch.held, arm.tendons.size
    for j in range(n_a):
        for a in range(scratch.delta.size):
            held.answer[j, a] = h * balance.rubbed[j, a]
        solve_again(scratch.system, scratch.delta.size, held.answer[j])
    copy(balance.tension, held.tension)
    for i in range(n_a):
        k, column = path.stiffness[i], balance.columns[i]
        pulled_in = product(column, scratch.v) + product(column, scratch.delta)
        held.wanted[i] = k * (command[i] - balance.shortening[i] - h * pulled_in)
        for j in range(n_a):
            give = k * h * product(column, held.answer[j])
            held.matrix[i, j] = give + (1.0 if i == j else 0.0)
            held.wanted[i] += give * balance.tension[j]
    solve_bounded(held.matrix, held.wanted, held.least, path.strength, held.tension, held.part, held.system)
    for j in range(n_a):
        for a in range(scratch.delta.size):
            scratch.delta[a] += (held.tension[j] - balance.tension[j]) * held.answer[j, a]
    if begins:
        scratch.kinked[0] = 0.0
    for i in range(n_a):
        if begins:
            free = path.stiffness[i] * (command[i] - balance.shortening[i])
            far = max(held.least[i] - free, free - path.strength[i], 0.0) if held.part[i] == 0.0 else 0.0
            far = free - held.least[i] if held.part[i] < 0.0 else path.strength[i] - free if held.part[i] > 0.0 else far
            changed = far > path.stiffness[i] * near
        else:
            changed = held.part[i] != held.parts[i]
        if changed:
            scratch.kinked[0] = 1.0
    if begins:
        copy(held.part, held.parts)
