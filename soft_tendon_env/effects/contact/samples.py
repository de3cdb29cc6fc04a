"""Samples of the arm: balls along the cubic Hermite curve through neighbouring nodes, each for its share of the length.

Tangents of the curve are h R e_x for an interval of length h: x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation
from soft_tendon_env.effects.contact import columns as at
from soft_tendon_env.effects.contact.bodies import body_at, distance, in_frame
from soft_tendon_env.effects.nodes import motion_before, motion_of, pose_before, pose_of
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, times
from soft_tendon_env.tools.types import Triple

MOST_SAMPLES = 10_000
"""Places along the arm at which contact is looked for, at most."""
SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""Impact that the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its
share."""


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
    samples = np.stack([*bases, t, radius, per_length * share, SMOOTHING * radius, wall, solid], axis=1)
    largest = [radius[end - count : end].max(initial=0.0) for end, count in zip(last, counts, strict=True)]
    return np.stack([h, last - counts, last, largest], axis=1), samples, place


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
    R_a, r_a = pose_before(nodes, i)
    return Ends(i, R_a, r_a, R_b, r_b)


@kernel(inline=True)
def tangent(R):
    """R e_x."""
    return R[0], R[3], R[6]


@kernel(inline=True)
def position_of(samples, m, ends):
    """Position of a sample's middle [m]."""
    a = plus(times(samples[m, at.H_A], ends.r_a), times(samples[m, at.REACH_A], tangent(ends.R_a)))
    return plus(a, plus(times(samples[m, at.H_B], ends.r_b), times(samples[m, at.REACH_B], tangent(ends.R_b))))


@kernel(inline=True)
def motion_at(samples, m, ends, nodes):
    """Velocity of a sample's middle, and angular velocity, in the world frame."""
    w, v = motion_of(nodes, ends.interval, ends.R_b)
    w_a, v_a = motion_before(nodes, ends.interval, ends.R_a, ends.r_a)
    behind = plus(times(samples[m, at.H_B], v), times(samples[m, at.REACH_B], cross(w, tangent(ends.R_b))))
    before = plus(times(samples[m, at.H_A], v_a), times(samples[m, at.REACH_A], cross(w_a, tangent(ends.R_a))))
    return plus(behind, before), plus(times(samples[m, at.T], w), times(1.0 - samples[m, at.T], w_a))


@kernel(inline=True)
def reach_of(intervals, i, ends):
    """No point of an interval's samples is farther [m] from its end: the polygon of the curve's Bezier points holds it."""
    chord = minus(ends.r_b, ends.r_a)
    return math.sqrt(dot(chord, chord)) + intervals[i, 0] / 3.0 + intervals[i, 3]


@kernel(refcount=True)
def find_pairs(contact, nodes, touching, pairs):
    """Pairs of obstacle and sample, all or those that touch, into pairs (pairs, 3): numbers of obstacle, interval and sample. How many."""
    intervals, samples, count = contact.intervals, contact.samples, 0
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact, j, nodes.time)
        for i in range(intervals.shape[0]):
            ends = ends_of(nodes, i)
            if touching and distance(body, in_frame(body, ends.r_b))[0] >= reach_of(intervals, i, ends):
                continue
            for m in range(int(intervals[i, 1]), int(intervals[i, 2])):
                if not touching or distance(body, in_frame(body, position_of(samples, m, ends)))[0] < samples[m, at.RADIUS]:
                    pairs[count, 0], pairs[count, 1], pairs[count, 2] = j, i, m
                    count += 1
    return count
