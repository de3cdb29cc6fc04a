"""Tangents of a motion: its derivatives by its inputs at the beginning, carried along with it."""

import numpy as np

from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import zeros_of


class Tangents(Struct):
    """Derivatives of a motion by its inputs at the beginning: coordinates, rates, internal states, commands; in the same order by row."""

    begin: np.ndarray  # (inputs, inputs) where a step begins; the commands that have arrived
    now: np.ndarray  # (inputs, inputs) within it
    command: np.ndarray  # (n_a, inputs) of the commands as they are given
    table: np.ndarray  # (columns, columns, (2 n + m) inputs) extrapolation table
    change: np.ndarray  # (n, inputs) of a
    state: np.ndarray  # (m, inputs) of the internal states after a substep
    system: np.ndarray  # (n, n)
    passed: np.ndarray  # (3, m + n_a) internal states and commands that have arrived: to one side, here, to the other
    passing: np.ndarray  # (m + n_a, m + n_a) their derivatives by states and commands before


def make_tangents(arm: Arm, columns: int) -> Tangents:
    """Zeroed Tangents for one arm and a method with this many columns."""
    n, n_a, m = arm.strain.size, arm.tendons.size, arm.effects.state.size
    inputs = 2 * n + m + n_a
    arrays = zeros_of(
        ((inputs, inputs), "begin now"),
        ((n_a, inputs), "command"),
        ((columns, columns, (2 * n + m) * inputs), "table"),
        ((n, inputs), "change"),
        ((m, inputs), "state"),
        ((n, n), "system"),
        ((3, m + n_a), "passed"),
        ((m + n_a, m + n_a), "passing"),
    )
    return Tangents(**arrays)
