"""Rewards of rows of arms: terms between 0 and 1 of errors and commands, and their weighted mean."""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import FloatVector, IntVector

EFFORT, SMOOTHNESS = -1, -2
"""What terms are of that no error makes."""


class TermTable(Struct):
    """The terms of a reward."""

    of: IntVector  # (terms) the number of an error, EFFORT or SMOOTHNESS
    first: IntVector  # (terms + 1) where the scales of each begin
    scale: FloatVector  # the errors that halve the terms, side by side
    weight: FloatVector  # (terms) that sum up to 1
    strongest: FloatVector  # (n_a) the largest commands that are allowed
    most_change: FloatVector  # (n_a) the largest changes of the action: twos


def closeness(error, scale):
    """1 / (1 + (error / scale)^2), of a number or an array."""
    part = error / scale
    return 1.0 / (1.0 + part * part)


_closeness = kernel(inline=True)(closeness)


@kernel
def economy(values, most):
    """1 less the mean square of values (n,) as parts of the largest, most (n,)."""
    total = 0.0
    for i in range(values.size):
        part = values[i] / most[i]
        total += min(part * part, 1.0)  # an actuator's error can exceed the limits
    return 1.0 - total / values.size


@kernel
def reward_terms(table, errors, command, action_change, terms, reward):
    """Terms (terms, rows) and reward (rows,) of errors (rows, errors), commands (rows, n_a) as applied and changes of the action."""
    for row in range(reward.size):
        total = 0.0
        for i in range(table.of.size):
            of = table.of[i]
            if of == EFFORT:
                value = economy(command[row], table.strongest)
            elif of == SMOOTHNESS:
                value = economy(action_change[row], table.most_change)
            else:
                value = 0.0
                for k in range(table.first[i], table.first[i + 1]):
                    value += _closeness(errors[row, of], table.scale[k])
                value /= table.first[i + 1] - table.first[i]
            terms[i, row] = value
            total += table.weight[i] * value
        reward[row] = total
