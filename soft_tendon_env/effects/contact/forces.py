"""Forces of contact: normal force by a smooth penalty with damping, and regularised Coulomb friction, as wrenches on the nodes.

With d = radius - signed distance of a sample's middle, k = stiffness ds and a smoothing depth e, N = p(d) max(0, 1 + c d_dot),
p = k d^2 / 2 e up to d = e, k (d - e / 2) beyond: Hunt and Crossley (1975), here of a force that begins smoothly. It never pulls, and what
it takes out of the motion, p c d_dot^2, is never negative.

Friction opposes the slip velocity v of the surfaces with mu N |v| / sqrt(|v|^2 + v_s^2), v_s the stiction speed. So what friction holds
creeps: with a share s of mu N, at v_s s / sqrt(1 - s^2). The implicit step gets the secant mu N / sqrt(|v|^2 + v_s^2) as damping.

By virtual work a force f on a sample is the force H00 f and the moment H10 h R_a e_x x f on the node before it, and likewise on the one
behind: without friction contact has a potential of the nodes' poses.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact import columns as at
from soft_tendon_env.effects.contact.bodies import body_at, distance, in_frame
from soft_tendon_env.effects.contact.samples import ends_of, find_pairs, motion_at, position_of
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, rotate, rotate_back, times
from soft_tendon_env.tools.types import Triple

FREE, WALL = 0.2, 0.45
"""Depths in radii of the rod between which the wall stops what would go through: a wire between two samples a radius apart is half a radius
deep in both."""
WALL_DISSIPATION = 1.0
"""The least c [s/m] of the wall: what begins within an obstacle leaves it at 1 m/s at most."""
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Touch(NamedTuple):
    """Contact of a sample with an obstacle; vectors in the world frame."""

    position: Triple  # [m] of the sample's middle
    gap: float  # [m] between the surfaces, negative where they overlap
    normal: Triple  # out of the obstacle
    force: Triple  # [N] on the sample
    stiffness: float  # [N/m] along the normal
    damping: float  # [N s/m] along the normal
    drag: float  # [N s/m] of friction, across the normal
    energy: float  # [J] that the normal force has stored


@kernel(inline=True)
def penalty(samples, m, depth):
    """Penalty force p(d) [N] of a sample, its derivative and its integral."""
    stiffness, smoothing = samples[m, at.STIFFNESS], samples[m, at.DEPTH]
    if depth < smoothing:
        slope = stiffness * depth / smoothing
        return 0.5 * slope * depth, slope, slope * depth * depth / 6.0
    beyond = depth - 0.5 * smoothing
    return stiffness * beyond, stiffness, 0.5 * stiffness * (beyond * beyond + smoothing * smoothing / 12.0)


@kernel(inline=True)
def wall(body, samples, m, depth):
    """Force of the wall that stops what would go through, its derivative and its integral.

    S x^3 / width, with x from 0 at FREE to 1 at WALL, deeper by half of the obstacle's thickness and by all of it. Without a stiffness of
    the ground's own, thickness counts up to the rod's radius.
    """
    radius, thick = samples[m, at.RADIUS], 0.5 * min(samples[m, at.SOLID], body.contact.obstacles[body.j, at.THICKNESS])
    x, width = depth - FREE * radius - thick, (WALL - FREE) * radius + thick
    if not x > 0.0:  # nor is it for what is infinitely thick
        return 0.0, 0.0, 0.0
    x /= width
    energy = samples[m, at.WALL_SCALE] * x * x
    return energy * x / width, 3.0 * energy / (width * width), 0.25 * energy * x * x


@kernel(inline=True)
def damped(law, dissipation, approach):
    """The force p max(0, 1 + c d_dot) of a law, with its derivatives by depth and approach."""
    factor = 1.0 + dissipation * approach
    return (law[0] * factor, law[1] * factor, law[0] * dissipation) if factor > 0.0 else (0.0, 0.0, 0.0)


@kernel(inline=True)
def touch_of(body, ends, m, nodes):
    """The contact of a sample between two nodes with an obstacle, without forces where they do not touch."""
    samples, rows, j = body.contact.samples, body.contact.obstacles, body.j
    x = position_of(samples, m, ends)
    away, out = distance(body, in_frame(body, x))
    gap, normal = away - samples[m, at.RADIUS], rotate(body.R, out)
    if not gap < 0.0:
        return Touch(x, gap, normal, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)
    velocity, turning = motion_at(samples, m, ends, nodes)
    slip = minus(plus(velocity, cross(turning, times(-samples[m, at.RADIUS], normal))), body.velocity)
    approach = -dot(slip, normal)
    slip = plus(slip, times(approach, normal))
    law, backstop, c = penalty(samples, m, -gap), wall(body, samples, m, -gap), rows[j, at.DISSIPATION]
    force, stop = damped(law, c, approach), damped(backstop, max(c, WALL_DISSIPATION), approach)
    pressure = force[0] + stop[0]
    drag = rows[j, at.FRICTION] * pressure / math.sqrt(dot(slip, slip) + body.contact.stiction_speed * body.contact.stiction_speed)
    total = minus(times(pressure, normal), times(drag, slip))
    return Touch(x, gap, normal, total, force[1] + stop[1], force[2] + stop[2], drag, law[2] + backstop[2])


@kernel(inline=True)
def add_along(field, node, lever, share, n, k):
    """k w w^T, w = (lever x n, share n), added to the block of a node: of what resists motion along n."""
    moment, begin = cross(lever, n), (node // LANES) * 21 * LANES + node % LANES
    w = moment[0], moment[1], moment[2], share * n[0], share * n[1], share * n[2]
    for i in range(6):
        for j in range(i + 1):
            field[begin + (i * (i + 1) // 2 + j) * LANES] += k * w[i] * w[j]


@kernel(inline=True)
def add_to_node(nodes, node, R, weights, radius, touch):
    """The wrench of a sample's force on one node, with the derivatives, each side of them as if the other stood still.

    weights: share, reach [m], turn and part: the sample's surface moves by share dp + dtheta x (reach e_x - turn radius n) in the node's
    frame. The blocks between both nodes of an interval are left out, so each gets 1 / part times its own, with parts that add up to 1: no
    motion then meets less stiffness than there is.
    """
    share, reach, turn, part = weights
    n, force = rotate_back(R, touch.normal), rotate_back(R, touch.force)
    lever = minus((reach, 0.0, 0.0), times(turn * radius, n))
    moment, at_node = cross(lever, force), (node // LANES) * 6 * LANES + node % LANES
    for k in range(3):
        nodes.wrench[at_node + k * LANES] += moment[k]
        nodes.wrench[at_node + (3 + k) * LANES] += share * force[k]
    add_along(nodes.stiffness, node, lever, share, n, touch.stiffness / part)
    add_along(nodes.damping, node, lever, share, n, (touch.damping - touch.drag) / part)
    if touch.drag > 0.0:
        for axis in AXES:
            add_along(nodes.damping, node, lever, share, axis, touch.drag / part)


@kernel(refcount=True)
def contact_wrench(contact, nodes):
    """Wrenches of all contacts, with their stiffness and damping."""
    samples = contact.samples
    pairs = np.empty((contact.obstacles.shape[0] * samples.shape[0], 3), dtype=np.int64)
    for pair in range(find_pairs(contact, nodes, True, pairs)):
        j, i, m = pairs[pair, 0], pairs[pair, 1], pairs[pair, 2]
        ends, t = ends_of(nodes, i), samples[m, at.T]
        touch = touch_of(body_at(contact, j, nodes.time), ends, m, nodes)
        nodes.contact.touched[0] = 1.0
        behind = samples[m, at.H_B], samples[m, at.REACH_B], t, t if i > 0 else 1.0
        add_to_node(nodes, i, ends.R_b, behind, samples[m, at.RADIUS], touch)
        if i > 0 and t < 1.0:
            before = samples[m, at.H_A], samples[m, at.REACH_A], 1.0 - t, 1.0 - t
            add_to_node(nodes, i - 1, ends.R_a, before, samples[m, at.RADIUS], touch)


@kernel(refcount=True)
def read_contacts(contact, nodes, gap, position, force):
    """Position of every sample (samples, 3) [m]; for every obstacle its gap (obstacles, samples) [m] and its force
    (obstacles, samples, 3) [N] in the world frame. Returns the potential energy [J] of the normal forces."""
    pairs, energy = np.empty((gap.size, 3), dtype=np.int64), 0.0
    for pair in range(find_pairs(contact, nodes, False, pairs)):
        j, i, m = pairs[pair, 0], pairs[pair, 1], pairs[pair, 2]
        touch = touch_of(body_at(contact, j, nodes.time), ends_of(nodes, i), m, nodes)
        gap[j, m], energy = touch.gap, energy + touch.energy
        for k in range(3):
            position[m, k], force[j, m, k] = touch.position[k], touch.force[k]
    return energy
