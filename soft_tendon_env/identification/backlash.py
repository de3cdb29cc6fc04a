"""Backlash of commands: play of gears, and of cables that stick in their guides.

What arrives follows the command only once the play is taken up (play operator of Krasnoselskii and
Pokrovskii 1989): it depends on the commands before, so that a hold knows the others of its file.
"""

import numpy as np

from soft_tendon_env.tools.types import Array


def after_play(command: Array, half_width: Array) -> Array:
    """Commands after a play, which begins in its middle.

    Args:
        command: (rows, n_a), in the order in which they were given.
        half_width: (n_a,) of the play, in the unit of the commands.

    Returns:
        What arrives (rows, n_a): the value before, while it is within half_width of the command.
    """
    arriving = command.copy()
    least = command - half_width
    greatest = command + half_width
    for row in range(1, len(command)):
        before = arriving[row - 1]
        # an end of the play pushes it along
        pushed_up = np.maximum(before, least[row])
        arriving[row] = np.minimum(pushed_up, greatest[row])
    return arriving
