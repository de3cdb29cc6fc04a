"""Step size near obstacles: steps end where a contact begins, and those that went through something or too deep are tried again."""

import math
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact.distance import Body, body_at, distance, goes_through, in_frame, velocity_at
from soft_tendon_env.effects.contact.rows import DEPTH, RADIUS, STIFFNESS, ContactParameters, triple
from soft_tendon_env.effects.contact.samples import ends_of, interval_balls, motion_at, position_of
from soft_tendon_env.effects.nodes import motion_before, motion_of, pose_of
from soft_tendon_env.mechanics.algebra.lie import dot, minus, rotate, times
from soft_tendon_env.mechanics.effects import allow_turning, limits_step, sweeps_motion

OVERRUN, THROUGH = 0.1, 0.15
"""Shares of the radius: how much deeper a step in contact may lead, and what turns out to be so deep that it is tried again shorter."""
LANDED = 0.01
"""Share of the arm's kinetic energy: the most that a sample may store where a step ends in what it comes upon."""
IDLE = 0.05
"""Speed, in lengths of the arm per second, with which it counts as energy besides: at rest steps need not end where a contact begins."""


class Way(NamedTuple):
    """An obstacle and the nodes before and after a step."""

    body_before: Body
    body: Body
    before: Any  # mechanics.effects.Before
    nodes: Any  # mechanics.effects.Nodes
    energy: float  # [J] that a sample may store where the step ends


@limits_step(ContactParameters)
@kernel
def limit_step(contact, nodes, longest):
    """Steps are short beside the periods of obstacles that swing or turn."""
    obstacles = contact.obstacles
    for j in range(obstacles.shape[0]):
        w, amplitude = triple(obstacles, j, 19), triple(obstacles, j, 25)
        allow_turning(math.sqrt(dot(w, w)), longest)
        if dot(amplitude, amplitude) > 0.0:
            allow_turning(obstacles[j, 28], longest)


@kernel
def speed_near(body, x, radius):
    """Bound on the speed [m/s] of a body's points in a ball about x."""
    v, w, lever = body.velocity, body.angular_velocity, minus(x, body.centre)
    return math.sqrt(dot(v, v)) + math.sqrt(dot(w, w)) * (math.sqrt(dot(lever, lever)) + radius)


@kernel
def speed_bound(nodes, intervals, i):
    """Bound on the speed [m/s] of an interval's samples: the Hermite polynomials of tangents stay below 4/27."""
    ends = ends_of(nodes, i)
    w_b, v_b = motion_of(nodes, i, ends.R_b)
    w_a, v_a = motion_before(nodes, i, ends.R_a, ends.r_a)
    turning = math.sqrt(dot(w_a, w_a)) + math.sqrt(dot(w_b, w_b))
    return math.sqrt(max(dot(v_a, v_a), dot(v_b, v_b))) + 4.0 / 27.0 * intervals[i, 0] * turning


@kernel
def landing_energy(nodes, intervals, count):
    """Energy [J] that a sample may store where a step ends in what it comes upon: a share of the kinetic energy of the arm."""
    energy, mass, length = 0.0, 0.0, 0.0
    for i in range(count):
        R, _ = pose_of(nodes, i)
        _, v = motion_of(nodes, i, R)
        m = nodes.mass[i]
        energy, mass, length = energy + 0.5 * m * dot(v, v), mass + m, length + intervals[i, 0]
    idle = IDLE * length
    return LANDED * (energy + 0.5 * mass * idle * idle)


@kernel(refcount=True)
def sweep_interval(contact, i, way, longest, meeting):
    """`contact_sweep` for the samples of one interval and one obstacle."""
    samples, body, ends, ends_before = contact.samples, way.body, ends_of(way.nodes, i), ends_of(way.before, i)
    for m in range(int(contact.intervals[i, 1]), int(contact.intervals[i, 2])):
        radius, x = samples[m, RADIUS], position_of(samples, m, ends)
        start, end = in_frame(way.body_before, position_of(samples, m, ends_before)), in_frame(body, x)
        was = distance(body, start)[0] - radius
        if goes_through(body, start, end, min(was, 0.0) + (1.0 - THROUGH) * radius):
            meeting[0] = 1.0
            return
        away, out = distance(body, end)
        gap, normal = away - radius, rotate(body.R, out)
        velocity, _ = motion_at(samples, m, ends, way.nodes)
        velocity = minus(velocity, velocity_at(body, minus(x, times(away, normal))))
        landing = min(samples[m, DEPTH], (6.0 * samples[m, DEPTH] * way.energy / samples[m, STIFFNESS]) ** (1.0 / 3.0))
        approach, room = -dot(velocity, normal), (gap + landing if gap > 0.0 else OVERRUN * radius)
        if was > 0.0 and gap < -2.0 * landing and approach > 0.0:
            meeting[0] = 1.0
            return
        if gap < 0.0 or approach * longest[0] > room:
            meeting[1] = 1.0
            if approach * longest[0] > room:
                longest[0] = room / approach


@sweeps_motion(ContactParameters)
@kernel(refcount=True)
def contact_sweep(contact, before, nodes, longest, meeting):
    """The next step ends where something is met; the last one was too long if a sample went through something on its way, or came to be
    so deep in it that it stores more than a share of the arm's energy. Samples go straight ahead, as seen by the obstacle."""
    obstacles, intervals = contact.obstacles, contact.intervals
    balls, balls_before = np.empty((intervals.shape[0], 4)), np.empty((intervals.shape[0], 4))
    count = interval_balls(intervals, nodes, balls)
    interval_balls(intervals, before, balls_before)
    energy = landing_energy(nodes, intervals, count)
    for j in range(obstacles.shape[0]):
        body, body_before = body_at(obstacles, j, nodes.time), body_at(obstacles, j, before.time)
        for i in range(count):
            middle = in_frame(body, triple(balls, i, 0))
            moved = minus(in_frame(body_before, triple(balls_before, i, 0)), middle)
            reach = max(balls[i, 3], balls_before[i, 3] + math.sqrt(dot(moved, moved)))
            speed = speed_bound(nodes, intervals, i) + speed_near(body, triple(balls, i, 0), balls[i, 3])
            if distance(body, middle)[0] < max(reach, balls[i, 3] + speed * longest[0]):
                sweep_interval(contact, i, Way(body_before, body, before, nodes, energy), longest, meeting)
