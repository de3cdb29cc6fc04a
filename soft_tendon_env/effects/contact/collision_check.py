"""Continuous collision check between the poses before and after a step, and how long the next step may be.

Steps end where a contact begins; those that went through something, or too deep into it, are tried again at half of their length.
"""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact import columns as at
from soft_tendon_env.effects.contact.bodies import Body, body_at, distance, goes_through, in_frame, triple
from soft_tendon_env.effects.contact.samples import Ends, ends_of, motion_at, position_of, reach_of
from soft_tendon_env.effects.nodes import motion_before, motion_of, pose_of
from soft_tendon_env.mechanics.algebra.lie import dot, minus, rotate
from soft_tendon_env.mechanics.effects import allow_turning

OVERRUN, THROUGH = 0.1, 0.15
"""Shares of the radius: how much deeper a step in contact may lead, and what turns out to be so deep that it is tried again shorter."""
LANDED, IDLE = 0.01, 0.05
"""Share of the arm's kinetic energy, the most that a sample may store where a step ends in what it comes upon, and the speed, in lengths of
the arm per second, that counts as such besides: at rest steps need not end where a contact begins."""


class SweptBody(NamedTuple):
    """An obstacle, and the nodes of an interval, before and after a step."""

    before: Body
    after: Body
    ends_before: Ends
    ends: Ends
    energy: float  # [J] that a sample may store where the step ends


@kernel
def limit_contact(contact, nodes, longest):
    """Steps are short beside the periods of obstacles that swing, and end where something is met."""
    for j in range(contact.obstacles.shape[0]):
        amplitude = triple(contact.obstacles, j, at.AMPLITUDE)
        if dot(amplitude, amplitude) > 0.0:
            allow_turning(contact.obstacles[j, at.RATE], longest)
    check_collisions(contact, nodes, longest)


@kernel
def landing_energy(nodes, intervals):
    """Energy [J] that a sample may store where a step ends in what it comes upon."""
    energy, mass, length = 0.0, 0.0, 0.0
    for i in range(intervals.shape[0]):
        _, v = motion_of(nodes, i, pose_of(nodes, i)[0])
        energy, mass, length = energy + 0.5 * nodes.mass[i] * dot(v, v), mass + nodes.mass[i], length + intervals[i, 0]
    return LANDED * (energy + 0.5 * mass * (IDLE * length) ** 2)


@kernel
def is_far(swept, contact, nodes, longest):
    """Whether no sample of the interval can have met the obstacle, nor does within a step: the Hermite polynomials of tangents stay below
    4/27, and the signed distance changes no faster than a point moves."""
    body, ends, i = swept.after, swept.ends, swept.ends.interval
    away, reach = distance(body, in_frame(body, ends.r_b))[0], reach_of(contact.intervals, i, ends)
    w, v = motion_of(nodes, i, ends.R_b)
    w_a, v_a = motion_before(nodes, i, ends.R_a, ends.r_a)
    turning = contact.intervals[i, 0] * (math.sqrt(dot(w, w)) + math.sqrt(dot(w_a, w_a)))
    speed = math.sqrt(max(dot(v, v), dot(v_a, v_a))) + 4.0 / 27.0 * turning + math.sqrt(dot(body.velocity, body.velocity))
    moved = minus(in_frame(swept.before, swept.ends_before.r_b), in_frame(body, ends.r_b))
    was = reach_of(contact.intervals, i, swept.ends_before) + math.sqrt(dot(moved, moved))
    return away >= max(was, reach + speed * longest[0])


@kernel(refcount=True)
def check_sample(m, swept, nodes, longest, flags):
    """`check_collisions` for a sample and an obstacle, straight ahead as seen by the obstacle."""
    body, samples = swept.after, swept.after.contact.samples
    radius, smoothing = samples[m, at.RADIUS], samples[m, at.DEPTH]
    landing = min(smoothing, (6.0 * smoothing * swept.energy / samples[m, at.STIFFNESS]) ** (1.0 / 3.0))
    start, end = (
        in_frame(swept.before, position_of(samples, m, swept.ends_before)),
        in_frame(body, position_of(samples, m, swept.ends)),
    )
    was = distance(swept.before, start)[0] - radius
    away, out = distance(body, end)
    velocity, _ = motion_at(samples, m, swept.ends, nodes)
    gap, approach = away - radius, -dot(minus(velocity, body.velocity), rotate(body.R, out))
    too_deep = was > 0.0 and gap < -2.0 * landing and approach > 0.0
    if too_deep or goes_through(body, start, end, min(was, 0.0) + (1.0 - THROUGH) * radius):
        flags.tunnelled[0] = 1.0
    room = gap + landing if gap > 0.0 else OVERRUN * radius
    if gap < 0.0 or approach * longest[0] > room:
        flags.active[0] = 1.0
        if approach * longest[0] > room:
            longest[0] = room / approach


@kernel(refcount=True)
def check_collisions(contact, nodes, longest):
    """The next step ends where something is met; the last one was too long if a sample went through something on its way, or came to be
    so deep in it at once that it stores more than a share of the arm's energy."""
    energy, before, flags = landing_energy(nodes, contact.intervals), nodes.before_step, nodes.contact
    for j in range(contact.obstacles.shape[0]):
        body_before, body = body_at(contact, j, before.time[0]), body_at(contact, j, nodes.time)
        for i in range(contact.intervals.shape[0]):
            swept = SweptBody(body_before, body, ends_of(before, i), ends_of(nodes, i), energy)
            if not is_far(swept, contact, nodes, longest):
                for m in range(int(contact.intervals[i, 1]), int(contact.intervals[i, 2])):
                    check_sample(m, swept, nodes, longest, flags)
