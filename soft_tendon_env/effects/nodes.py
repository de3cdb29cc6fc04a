"""Places of the arm as plain numbers, for effects that act at places: nodes in the packed layout of `Nodes`, and samples between them.

Samples lie on the cubic Hermite curve through neighbouring nodes. With tangents h R e_x for an interval of length h,
x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, plus, rotate, times
from soft_tendon_env.mechanics.effects import BeforeStep, ContactFlags, Nodes
from soft_tendon_env.tools.types import Triple


@kernel(inline=True)
def vector_at(field, at):
    """Three components of a field, a pack of lanes apart."""
    return field[at], field[at + LANES], field[at + 2 * LANES]


@kernel(inline=True)
def pose_of(nodes, node):
    """Pose (R, r) of a node; node -1 is the base."""
    if node < 0:
        base = nodes.base
        return (base[0], base[1], base[2], base[3], base[4], base[5], base[6], base[7], base[8]), (base[9], base[10], base[11])
    at, pose = (node // LANES) * 12 * LANES + node % LANES, nodes.pose
    x, y, z, r = vector_at(pose, at), vector_at(pose, at + 3 * LANES), vector_at(pose, at + 6 * LANES), vector_at(pose, at + 9 * LANES)
    return (x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]), r


@kernel(inline=True)
def motion_of(nodes, node, R, r):
    """Angular and linear velocity, in the world frame, of a node at a pose (R, r); node -1 is the base."""
    if node < 0:
        w = nodes.base[12], nodes.base[13], nodes.base[14]
        return w, plus((nodes.base[15], nodes.base[16], nodes.base[17]), cross(w, r))
    at, twist = (node // LANES) * 6 * LANES + node % LANES, nodes.twist
    return rotate(R, vector_at(twist, at)), rotate(R, vector_at(twist, at + 3 * LANES))


class Sample(NamedTuple):
    """A ball of the arm at its place t between the nodes a and b of an interval of length h."""

    h_a: float  # H00 [-]
    reach_a: float  # h H10 [m]
    h_b: float
    reach_b: float
    t: float
    radius: float  # [m]
    stiffness: float  # k [N/m]
    smoothing: float  # e [m]
    wall: float  # scale [J] of the wall's energy
    solid: float  # most thickness [m] of obstacles that counts


class Ends(NamedTuple):
    """The two nodes of an interval."""

    interval: int  # also the node behind it; the one before is that less 1
    R_a: tuple[float, ...]
    r_a: Triple
    R_b: tuple[float, ...]
    r_b: Triple


@kernel(inline=True)
def ends_of(nodes, i):
    """The nodes of an interval."""
    R_b, r_b = pose_of(nodes, i)
    R_a, r_a = pose_of(nodes, i - 1)
    return Ends(i, R_a, r_a, R_b, r_b)


@kernel(inline=True)
def hermite(sample, a, tangent_a, b, tangent_b):
    """The cubic between vectors a and b, with these tangents, at a sample."""
    before = plus(times(sample.h_a, a), times(sample.reach_a, tangent_a))
    return plus(before, plus(times(sample.h_b, b), times(sample.reach_b, tangent_b)))


@kernel(inline=True)
def tangent(R):
    """R e_x."""
    return R[0], R[3], R[6]


@kernel(inline=True)
def position_of(sample, ends):
    """Position of a sample's middle [m]."""
    return hermite(sample, ends.r_a, tangent(ends.R_a), ends.r_b, tangent(ends.R_b))


@kernel(inline=True)
def motion_at(sample, ends, nodes):
    """Velocity of a sample's middle, and angular velocity, in the world frame."""
    w, v = motion_of(nodes, ends.interval, ends.R_b, ends.r_b)
    w_a, v_a = motion_of(nodes, ends.interval - 1, ends.R_a, ends.r_a)
    velocity = hermite(sample, v_a, cross(w_a, tangent(ends.R_a)), v, cross(w, tangent(ends.R_b)))
    return velocity, plus(times(sample.t, w), times(1.0 - sample.t, w_a))


def nodes_with(pose, twist, base, time):
    """Nodes at poses and with twists in the kernels' layout, for what reads no more of them than that, their base and time."""
    none = np.zeros(0)
    check = BeforeStep(none, none, none), ContactFlags(none, none, none)
    return Nodes(pose.size // (12 * LANES), time, none, none, pose, twist, base, none, none, none, *check)
