"""Arm and obstacles as the kernels of contact see them: samples along the arm, bodies at a time, and collisions on a way.

Samples are balls along the cubic Hermite curve through neighbouring nodes, each for its share of the length. With tangents h R e_x for an
interval of length h, x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation
from soft_tendon_env.effects.contact.obstacles import distance
from soft_tendon_env.effects.nodes import motion_before, motion_of, pose_before, pose_of
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.tools.types import Triple

CUTS, SAME = 64, 1e-3
"""Most places at which the way of a sample is looked at, and the share of that within which it comes up to what is allowed."""
MOST_SAMPLES = 10_000
SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""Impact that the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its
share."""


class ContactParameters(Struct):
    """The numbers of samples and obstacles; intervals in order from base to tip, the empty ones at the end without samples."""

    intervals: Array  # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    samples: Array  # (samples, 10): see Sample
    obstacles: Array  # (obstacles, 28): see Obstacle.row
    stiction_speed: float  # [m/s]


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


class Body(NamedTuple):
    """An obstacle at a time; vectors in the world frame."""

    shape: float  # number of its shape
    thickness: float  # [m]
    friction: float  # mu [-]
    dissipation: float  # c [s/m]
    sizes: tuple[float, ...]  # [m]
    R: tuple[float, ...]
    r: Triple
    velocity: Triple


class Ends(NamedTuple):
    """The two nodes of an interval."""

    interval: int  # also the node behind it; the one before is that less 1
    R_a: tuple[float, ...]
    r_a: Triple
    R_b: tuple[float, ...]
    r_b: Triple


def make_samples(rod: Discretisation, stiffness: float | None) -> tuple[Array, Array, Array]:
    """Rows of `ContactParameters.intervals` and `.samples`, and the samples' arc lengths (samples,) [m], a radius apart at most."""
    start = np.concatenate([[0.0], rod.node[:-1]])
    h = rod.node - start
    counts = np.ceil(h / np.maximum(rod.radius(0.5 * (start + rod.node)), rod.length / MOST_SAMPLES)).astype(int)
    last = np.cumsum(counts)
    t = np.concatenate([np.arange(1, count + 1) / count for count in counts if count])
    own, share = np.repeat(h, counts), np.repeat(h / np.maximum(counts, 1), counts)
    place = np.repeat(start, counts) + t * own
    radius = rod.radius(place)
    share[-1] = 0.5 * share[-1] + radius[-1]  # the tip's round cap
    per_length = rod.elasticity(place)[:, 3] / (2.0 * radius) ** 2 if stiffness is None else np.full(place.size, stiffness)  # [N/m^2]
    wall = WALL_MASS * WALL_SPEED**2 * rod.line_mass(place) * share
    solid = radius if stiffness is None else np.full(place.size, math.inf)
    bases = (1 + 2 * t) * (1 - t) ** 2, own * t * (1 - t) ** 2, t**2 * (3 - 2 * t), own * t**2 * (t - 1)
    samples = np.stack([*bases, t, radius, per_length * share, SMOOTHING * radius, wall, solid], axis=1)  # in the order of Sample
    largest = [radius[end - count : end].max(initial=0.0) for end, count in zip(last, counts, strict=True)]
    return np.stack([h, last - counts, last, largest], axis=1), samples, place


@kernel(inline=True)
def sample_at(contact, m):
    """The sample of a row."""
    s = contact.samples
    return Sample(s[m, 0], s[m, 1], s[m, 2], s[m, 3], s[m, 4], s[m, 5], s[m, 6], s[m, 7], s[m, 8], s[m, 9])


@kernel(inline=True)
def triple(rows, i, first):
    """Three numbers of a row as a vector."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


@kernel
def swing_rate(obstacles, j):
    """Rate [rad/s] of the sinusoidal motion of an obstacle, 0 where it does not swing."""
    return obstacles[j, 4] if size(triple(obstacles, j, 25)) > 0.0 else 0.0


@kernel
def body_at(obstacles, j, time):
    """The obstacle of a row at a time [s]."""
    o, rate = obstacles[j], obstacles[j, 4]
    angle, v, amplitude = rate * time + o[5], triple(obstacles, j, 22), triple(obstacles, j, 25)
    r = plus(plus(triple(obstacles, j, 10), times(time, v)), times(math.sin(angle), amplitude))
    v = plus(v, times(rate * math.cos(angle), amplitude))
    R = o[13], o[14], o[15], o[16], o[17], o[18], o[19], o[20], o[21]
    return Body(o[0], o[1], o[2], o[3], (o[6], o[7], o[8], o[9]), R, r, v)


@kernel(inline=True)
def in_frame(body, x):
    """A position [m] in the frame of a body."""
    return rotate_back(body.R, minus(x, body.r))


@kernel(inline=True)
def size(x):
    """Euclidean norm."""
    return math.sqrt(dot(x, x))


@kernel(inline=True)
def ends_of(nodes, i):
    """The nodes of an interval."""
    R_b, r_b = pose_of(nodes, i)
    R_a, r_a = pose_before(nodes, i)
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
    w, v = motion_of(nodes, ends.interval, ends.R_b)
    w_a, v_a = motion_before(nodes, ends.interval, ends.R_a, ends.r_a)
    velocity = hermite(sample, v_a, cross(w_a, tangent(ends.R_a)), v, cross(w, tangent(ends.R_b)))
    return velocity, plus(times(sample.t, w), times(1.0 - sample.t, w_a))


@kernel(inline=True)
def reach_of(intervals, i, ends):
    """No point of an interval's samples is farther [m] from its end: the polygon of the curve's Bezier points holds it."""
    return size(minus(ends.r_b, ends.r_a)) + intervals[i, 0] / 3.0 + intervals[i, 3]


@kernel
def goes_through(body, start, end, allowed):
    """Whether the distance from a body falls below `allowed` [m] on the straight way between two points in its frame: it falls no faster
    than the way goes on."""
    way, s = minus(end, start), 0.0
    length = size(way)
    if distance(body, end)[0] < allowed:
        return True
    for _ in range(CUTS):
        room = distance(body, plus(start, times(s, way)))[0] - allowed
        if room > length * (1.0 - s):
            return False
        if room < SAME * length:
            return True
        s += room / length
    return True


@kernel
def read_distances(obstacles, positions, time, out):
    """Signed distance out (obstacles, m) of positions (m, 3) at a time."""
    for j in range(obstacles.shape[0]):
        body = body_at(obstacles, j, time)
        for m in range(positions.shape[0]):
            out[j, m] = distance(body, in_frame(body, triple(positions, m, 0)))[0]
