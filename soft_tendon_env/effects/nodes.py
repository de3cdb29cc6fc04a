"""Single nodes in the packed layout of `Nodes`: pose, motion and wrench of one node as plain numbers, for effects that act at places."""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, plus, rotate
from soft_tendon_env.mechanics.effects import BeforeStep, ContactFlags, Nodes


@kernel(inline=True)
def vector_at(field, at):
    """Three components of a field, a pack of lanes apart."""
    return field[at], field[at + LANES], field[at + 2 * LANES]


@kernel(inline=True)
def pose_of(nodes, node):
    """Pose (R, r) of a node."""
    at, pose = (node // LANES) * 12 * LANES + node % LANES, nodes.pose
    x, y, z, r = vector_at(pose, at), vector_at(pose, at + 3 * LANES), vector_at(pose, at + 6 * LANES), vector_at(pose, at + 9 * LANES)
    return (x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]), r


@kernel(inline=True)
def pose_before(nodes, node):
    """Pose (R, r) of the node before this one; of the base before the first."""
    if node > 0:
        return pose_of(nodes, node - 1)
    base = nodes.base
    return (base[0], base[1], base[2], base[3], base[4], base[5], base[6], base[7], base[8]), (base[9], base[10], base[11])


@kernel(inline=True)
def motion_of(nodes, node, R):
    """Angular and linear velocity of a node with rotation R, in the world frame."""
    at, twist = (node // LANES) * 6 * LANES + node % LANES, nodes.twist
    return rotate(R, vector_at(twist, at)), rotate(R, vector_at(twist, at + 3 * LANES))


@kernel(inline=True)
def motion_before(nodes, node, R, r):
    """Angular and linear velocity, in the world frame, of the node before this one, at a pose (R, r); of the base before the first."""
    if node > 0:
        return motion_of(nodes, node - 1, R)
    w = nodes.base[12], nodes.base[13], nodes.base[14]
    return w, plus((nodes.base[15], nodes.base[16], nodes.base[17]), cross(w, r))


def nodes_with(pose, twist, base, time):
    """Nodes at poses and with twists in the kernels' layout, for what reads no more of them than that, their base and time."""
    none = np.zeros(0)
    check = BeforeStep(none, none, none), ContactFlags(none, none, none)
    return Nodes(pose.size // (12 * LANES), time, none, none, pose, twist, base, none, none, none, *check)
