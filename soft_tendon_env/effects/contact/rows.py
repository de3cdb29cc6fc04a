"""Rows of numbers that the kernels of contact read: parameters of the effect, and the columns of a sample."""

from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.effect_parameters import Matrix


class ContactParameters(NamedTuple):
    """The numbers of samples and obstacles; intervals in order from base to tip, the empty ones at the end without samples."""

    intervals: Matrix  # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    samples: Matrix  # (samples, 10): by the columns below
    obstacles: Matrix  # (obstacles, 34): see Obstacle.row


H_A, REACH_A, H_B, REACH_B, T, RADIUS, STIFFNESS, DEPTH, WALL_SCALE, SOLID = range(10)
"""Columns of a sample: Hermite polynomials H00 [-], h H10 [m], H01 [-], h H11 [m] at its place t [-] between the nodes a and b of an
interval of length h; radius [m], stiffness k [N/m], smoothing e [m]; scale [J] of the wall's energy, and most thickness [m] that counts."""

KIND, FRICTION, DISSIPATION, EXTENT, THICKNESS = 0, 30, 31, 32, 33
"""Some columns of an obstacle: kind of signed distance; coefficient mu [-]; c [s/m] of the normal force; radius [m] of a ball around its
position that holds it; half of its least size [m]."""


@kernel(inline=True)
def triple(rows, i, at):
    """Three numbers of a row as a vector."""
    return rows[i, at], rows[i, at + 1], rows[i, at + 2]
