"""Tensions of elastic tendons at the end of a substep, by linear complementarity.

D. E. Stewart and J. C. Trinkle, 1996.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, solve_bounded


@kernel
def bound_tensions(path, command, shortening, h, before, ends):
    """Finds tensions ends.tension at the end of a substep of length h under a command (n_a) there.

    With tensions `before` (n_a) tendons are pulled in at ends.rate, and ends.give faster by a
    newton.
    """
    # x + k h give (x - x_before) = k (u - s - h y) between 0 and the strength
    for i in range(command.size):
        k = path.stiffness[i]
        stretched = command[i] - shortening[i] - h * ends.rate[i]
        ends.right[i] = k * stretched
        for j in range(command.size):
            give = k * h * ends.give[i, j]
            ends.matrix[i, j] = give + (1.0 if i == j else 0.0)
            ends.right[i] += give * before[j]
    copy(before, ends.tension)
    solve_bounded(
        ends.matrix,
        ends.right,
        ends.least,
        path.strength,
        ends.tension,
        ends.part,
        ends.system,
    )


@kernel
def add_answers(ends, delta):
    """Adds to delta (n) what forces change that are ends.change (n_a) more."""
    for j in range(ends.change.size):
        change = ends.change[j]
        answer = ends.answer[j]
        for a in range(delta.size):
            delta[a] += change * answer[a]
