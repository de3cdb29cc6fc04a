"""Forces and clearances of contact in configurations that are known: of one arm by samples, of rows of arms by sections."""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.distance import body_at, distance, in_frame
from soft_tendon_env.effects.contact.friction import touch_of, traction_of
from soft_tendon_env.effects.contact.rows import RADIUS, ContactParameters, triple
from soft_tendon_env.effects.contact.samples import ends_of, position_of
from soft_tendon_env.effects.nodes import nodes_with
from soft_tendon_env.mechanics.algebra.lie import rotate
from soft_tendon_env.mechanics.algebra.structs import struct_at
from soft_tendon_env.mechanics.effect_parameters import parameters_at
from soft_tendon_env.mechanics.effects import EffectTable, kinds_of
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.terms.kinematics import node_twists, poses
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess, strain_rate


class ContactReading(NamedTuple):
    """Contact of every row of arms, by sections of the arm; vectors in the world frame."""

    force: np.ndarray  # (rows, sections, 3) [N] on the arm
    clearance: np.ndarray  # (rows, sections) [m] least between the surfaces of arm and obstacles, negative where they overlap
    load: np.ndarray  # (rows) [N] sum of the sizes of all contact forces


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
        work.xi[:] = rows.xi[row]
        work.clock[0] = rows.clock[row, 0]
        strain_from_guess(own, rows.q[row], STEP_TOLERANCE, work)
        strain_rate(own, rows.q_dot[row], work)
        place_base(own, work)
        poses(own.rod, work)
        node_twists(own.rod, work)
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
