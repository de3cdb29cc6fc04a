"""Single nodes in the packed layout of `Nodes`: pose, motion and wrench of one node as plain numbers, for effects that act at places."""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, plus, rotate
from soft_tendon_env.mechanics.effects import Nodes


@kernel(inline=True)
def pose_of(nodes, node):
    """Pose (R, r) of a node."""
    at, pose = (node // LANES) * 12 * LANES + node % LANES, nodes.pose
    x = pose[at], pose[at + LANES], pose[at + 2 * LANES]
    y = pose[at + 3 * LANES], pose[at + 4 * LANES], pose[at + 5 * LANES]
    z = pose[at + 6 * LANES], pose[at + 7 * LANES], pose[at + 8 * LANES]
    return (*x, *y, *z), (pose[at + 9 * LANES], pose[at + 10 * LANES], pose[at + 11 * LANES])


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
    w = twist[at], twist[at + LANES], twist[at + 2 * LANES]
    return rotate(R, w), rotate(R, (twist[at + 3 * LANES], twist[at + 4 * LANES], twist[at + 5 * LANES]))


@kernel(inline=True)
def motion_before(nodes, node, R, r):
    """Angular and linear velocity, in the world frame, of the node before this one, at a pose (R, r); of the base before the first."""
    if node > 0:
        return motion_of(nodes, node - 1, R)
    w = nodes.base[12], nodes.base[13], nodes.base[14]
    return w, plus((nodes.base[15], nodes.base[16], nodes.base[17]), cross(w, r))


@kernel(inline=True)
def add_wrench(nodes, node, moment, force):
    """Add a body-frame wrench to a node."""
    at = (node // LANES) * 6 * LANES + node % LANES
    for i in range(3):
        nodes.wrench[at + i * LANES] += moment[i]
        nodes.wrench[at + (3 + i) * LANES] += force[i]


@kernel(counted=True)
def nodes_with(pose, twist, base, time):
    """Nodes at poses and with twists in the kernels' layout, for what reads no more of them than that, their base and time."""
    none = np.zeros(0)
    return Nodes(pose.size // (12 * LANES), time, none, none, none, pose, twist, base, none, none, none, none)
