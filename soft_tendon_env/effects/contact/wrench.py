"""Wrenches of contact on the nodes: forces, stiffness and damping by virtual work, and the internal states of friction.

Also forces and clearances in configurations that are known: of one arm by samples, of rows of arms by sections.

By virtual work a force f on a sample is the force H00 f and the moment H10 h R_a e_x x f on the node before it, and likewise on the one
behind: without friction contact has a potential of the nodes' poses.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.distance import body_at, distance, in_frame
from soft_tendon_env.effects.contact.forces import stored_energy, touch_of, traction_of
from soft_tendon_env.effects.contact.rows import H_A, H_B, RADIUS, REACH_A, REACH_B, ContactParameters, T, triple
from soft_tendon_env.effects.contact.samples import ends_of, interval_balls, is_away, position_of
from soft_tendon_env.effects.nodes import add_wrench, nodes_with
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, minus, rotate, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import struct_at
from soft_tendon_env.mechanics.effect_parameters import parameters_at
from soft_tendon_env.mechanics.effects import EffectTable, adds_wrench, kinds_of
from soft_tendon_env.mechanics.motion.batch import place_nodes


class ContactReading(NamedTuple):
    """Contact of every row of arms, by sections of the arm; vectors in the world frame."""

    force: np.ndarray  # (rows, sections, 3) [N] on the arm
    clearance: np.ndarray  # (rows, sections) [m] least between the surfaces of arm and obstacles, negative where they overlap
    load: np.ndarray  # (rows) [N] sum of the sizes of all contact forces


class Share(NamedTuple):
    """Motion of a sample with one node: its surface moves by share dp + dtheta x (reach e_x - turn radius n) in the node's frame."""

    share: float
    reach: float  # [m]
    turn: float
    part: float  # of the sample's stiffness that is this node's: those of both add up to one


@kernel(inline=True)
def add_block(field, node, lever, share, n, along, across):
    """B^T (along n n^T + across (I - n n^T)) B, B u = share u + theta x lever, added to the block of a node."""
    x, y, z = n
    more = along - across
    q_x = across + more * x * x, more * x * y, more * x * z
    q_y = q_x[1], across + more * y * y, more * y * z
    q_z = q_x[2], q_y[2], across + more * z * z
    a, b, c = cross(lever, q_x), cross(lever, q_y), cross(lever, q_z)  # columns of lever~ Q
    m_x, m_y, m_z = cross(lever, (a[0], b[0], c[0])), cross(lever, (a[1], b[1], c[1])), cross(lever, (a[2], b[2], c[2]))
    whole = share * share
    at = (node // LANES) * 21 * LANES + node % LANES
    field[at] += m_x[0]
    field[at + LANES] += m_y[0]
    field[at + 2 * LANES] += m_y[1]
    for i in range(3):
        field[at + (3 + i) * LANES] += m_z[i]
        field[at + (6 + i) * LANES] += share * a[i]
        field[at + (10 + i) * LANES] += share * b[i]
        field[at + (15 + i) * LANES] += share * c[i]
        field[at + (18 + i) * LANES] += whole * q_z[i]
    field[at + 9 * LANES] += whole * q_x[0]
    field[at + 13 * LANES] += whole * q_y[0]
    field[at + 14 * LANES] += whole * q_y[1]


@kernel(inline=True)
def add_to_node(nodes, node, R, own, radius, touch, traction):
    """The wrench of a sample's force on one node, with the derivatives, each side of them as if the other stood still.

    The blocks between both nodes of an interval are left out, so each gets 1 / part times its own: no motion then meets less stiffness
    than there is.
    """
    n = rotate_back(R, touch.normal)
    lever, force = minus((own.reach, 0.0, 0.0), times(own.turn * radius, n)), rotate_back(R, traction.force)
    add_wrench(nodes, node, cross(lever, force), force, own.share)
    add_block(nodes.stiffness, node, lever, own.share, n, touch.stiffness / own.part, traction.stiffness / own.part)
    if touch.damping > 0.0 or traction.damping > 0.0:
        add_block(nodes.damping, node, lever, own.share, n, touch.damping / own.part, traction.damping / own.part)


@adds_wrench(ContactParameters)
@kernel(counted=True)
def contact_wrench(contact, nodes):
    """Wrenches of all contacts, with their stiffness and damping."""
    intervals, samples = contact.intervals, contact.samples
    balls = np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(count):
            if is_away(body, balls, i):
                continue
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                x = position_of(samples, m, ends)
                away, out = distance(body, in_frame(body, x))
                depth = samples[m, RADIUS] - away
                if depth <= 0.0:
                    continue
                touch = touch_of(body, samples, m, ends, nodes, x, depth, rotate(body.R, out))
                traction = traction_of(body, samples, m, touch, nodes.state, 3 * (j * samples.shape[0] + m))
                if touch.stiffness > 0.0 or traction.stiffness > 0.0:
                    nodes.touched[0] = 1.0
                t = samples[m, T]
                behind = Share(samples[m, H_B], samples[m, REACH_B], t, t if i > 0 else 1.0)
                add_to_node(nodes, i, ends.R_b, behind, samples[m, RADIUS], touch, traction)
                if i > 0 and t < 1.0:
                    before = Share(samples[m, H_A], samples[m, REACH_A], 1.0 - t, 1.0 - t)
                    add_to_node(nodes, i - 1, ends.R_a, before, samples[m, RADIUS], touch, traction)


@kernel(counted=True)
def contact_energy(contact, nodes, energy):
    """Potential energy [J] of the normal forces without damping, added to energy (1,)."""
    intervals, samples = contact.intervals, contact.samples
    balls = np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(count):
            if is_away(body, balls, i):
                continue
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                away, _ = distance(body, in_frame(body, position_of(samples, m, ends)))
                if away < samples[m, RADIUS]:
                    energy[0] += stored_energy(body, samples, m, samples[m, RADIUS] - away)


def number_of_contact(effects: EffectTable) -> int | None:
    """Index of contact among an arm's effects; None: it has none."""
    kinds = kinds_of(effects)
    return kinds.index(ContactParameters) if ContactParameters in kinds else None


def contact_parameters(effects: EffectTable, number: int) -> ContactParameters:
    """Parameters of an arm's contact, which is the effect of that `number`."""
    own: ContactParameters = parameters_at(ContactParameters, effects.values[effects.first_value[number] : effects.first_value[number + 1]])
    return own


@kernel(counted=True)
def read_contacts(contact, nodes, gap, position, force):
    """Position of every sample (samples, 3) [m]; for every obstacle its gap (obstacles, samples) [m] and its force
    (obstacles, samples, 3) [N] in the world frame."""
    intervals, samples = contact.intervals, contact.samples
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact.obstacles, j, nodes.time)
        for i in range(intervals.shape[0]):
            ends = ends_of(nodes, i)
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                x = position_of(samples, m, ends)
                away, out = distance(body, in_frame(body, x))
                gap[j, m] = away - samples[m, RADIUS]
                total = 0.0, 0.0, 0.0
                if gap[j, m] < 0.0:
                    touch = touch_of(body, samples, m, ends, nodes, x, -gap[j, m], rotate(body.R, out))
                    total = traction_of(body, samples, m, touch, nodes.state, 3 * (j * samples.shape[0] + m)).force
                for k in range(3):
                    position[m, k], force[j, m, k] = x[k], total[k]


@kernel(counted=True)
def read_contact_rows(arm, rows, members, number, section, work, reading):
    """Contact of the rows named in `members` into `reading`; contact is the effect of that `number`, sample m lies in section[m]."""
    effects = arm.effects
    first, last = effects.first_value[number], effects.first_value[number + 1]
    begin, end = effects.first_state[number], effects.first_state[number + 1]
    for row in members:
        own = struct_at(arm, rows.arm, row)
        place_nodes(own, rows, row, work)
        contact = parameters_at(ContactParameters, rows.effects[row][first:last])
        obstacles, samples = contact.obstacles.shape[0], contact.samples.shape[0]
        gap, position, force = np.empty((obstacles, samples)), np.empty((samples, 3)), np.empty((obstacles, samples, 3))
        nodes = nodes_with(work.pose, work.eta, work.base, rows.state[row][begin:end], rows.clock[row, 0])
        read_contacts(contact, nodes, gap, position, force)
        reading.force[row] = 0.0
        reading.clearance[row] = math.inf
        reading.load[row] = 0.0
        for j in range(obstacles):
            for m in range(samples):
                part = section[m]
                reading.clearance[row, part] = min(reading.clearance[row, part], gap[j, m])
                x, y, z = triple(force[j], m, 0)
                reading.force[row, part, 0] += x
                reading.force[row, part, 1] += y
                reading.force[row, part, 2] += z
                reading.load[row] += math.sqrt(x * x + y * y + z * z)
