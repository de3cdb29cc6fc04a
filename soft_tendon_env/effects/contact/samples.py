"""Samples of the arm: balls along the cubic Hermite curve through neighbouring nodes, each for its share of the length.

Tangents of the curve are h R e_x for an interval of length h: x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation
from soft_tendon_env.effects.contact.distance import Rotation, distance, in_frame
from soft_tendon_env.effects.contact.rows import EXTENT, H_A, H_B, RADIUS, REACH_A, REACH_B, T, triple
from soft_tendon_env.effects.nodes import motion_before, motion_of, pose_before, pose_of
from soft_tendon_env.mechanics.algebra.lie import cross, dot, minus, plus, times
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Triple as Vector

MOST_SAMPLES = 10_000
"""Places along the arm at which contact is looked for."""
SMOOTHING = 0.01
"""Depth over which the stiffness grows to its full size, in radii of the rod."""
WALL_SPEED, WALL_MASS = 30.0, 8.0
"""Impact that the wall of a sample stops by itself within twice its width or so: this speed [m/s] of so many times the mass of its
share."""


class Ends(NamedTuple):
    """The two nodes of an interval."""

    interval: int  # also the node behind it; the one before is that less 1
    R_a: Rotation
    r_a: Vector
    R_b: Rotation
    r_b: Vector


def make_samples(rod: Discretisation, stiffness: float | None, spacing: float | None) -> tuple[Array, Array, Array]:
    """Rows of `ContactParameters.intervals` and `.samples`, and the samples' arc lengths (samples,) [m], for the keys of the scene."""
    least = rod.length / MOST_SAMPLES
    if spacing is not None and spacing < least:
        text = f"is {spacing:g}: it should be at least {least:g} m, for {MOST_SAMPLES} samples along the arm"
        raise ConfigurationError([Problem(("effects", "contact", "spacing"), text)])
    intervals: list[list[float]] = []
    samples: list[list[float]] = []
    places: list[float] = []
    for start, end in zip(np.concatenate([[0.0], rod.node[:-1]]), rod.node, strict=True):
        h, first = float(end - start), len(samples)
        if h > 0.0:
            apart = spacing or max(float(rod.radius(np.array([0.5 * (start + end)]))[0]), least)
            count = math.ceil(h / apart)
            t = np.arange(1, count + 1) / count
            place = start + t * h
            share = np.full(count, h / count)
            if end >= rod.length * (1.0 - 1e-12):
                share[-1] = 0.5 * h / count + rod.radius(place)[-1]  # the tip's round cap
            samples += _rows(rod, t, h, place, share, stiffness)
            places += place.tolist()
        largest = max((sample[RADIUS] for sample in samples[first:]), default=0.0)
        intervals.append([h, first, len(samples), largest])
    return np.array(intervals), np.array(samples), np.array(places)


def _rows(rod: Discretisation, t: Array, h: float, place: Array, share: Array, stiffness: float | None) -> list[list[float]]:
    """Rows of the samples at t (m,) of an interval."""
    radius = rod.radius(place)
    per_length = rod.elasticity(place)[:, 3] / (2.0 * radius) ** 2 if stiffness is None else np.full(place.size, stiffness)  # [N/m^2]
    wall = WALL_MASS * WALL_SPEED**2 * rod.line_mass(place) * share
    solid = radius if stiffness is None else np.full(place.size, math.inf)
    bases = (1 + 2 * t) * (1 - t) ** 2, h * t * (1 - t) ** 2, t**2 * (3 - 2 * t), h * t**2 * (t - 1)
    rows: list[list[float]] = np.stack([*bases, t, radius, per_length * share, SMOOTHING * radius, wall, solid], axis=1).tolist()
    return rows


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
    a = plus(times(samples[m, H_A], ends.r_a), times(samples[m, REACH_A], tangent(ends.R_a)))
    return plus(a, plus(times(samples[m, H_B], ends.r_b), times(samples[m, REACH_B], tangent(ends.R_b))))


@kernel(inline=True)
def motion_at(samples, m, ends, nodes):
    """Velocity of a sample's middle, and angular velocity, in the world frame."""
    w, v = motion_of(nodes, ends.interval, ends.R_b)
    velocity = plus(times(samples[m, H_B], v), times(samples[m, REACH_B], cross(w, tangent(ends.R_b))))
    turning = times(samples[m, T], w)
    w, v = motion_before(nodes, ends.interval, ends.R_a, ends.r_a)
    velocity = plus(velocity, plus(times(samples[m, H_A], v), times(samples[m, REACH_A], cross(w, tangent(ends.R_a)))))
    turning = plus(turning, times(1.0 - samples[m, T], w))
    return velocity, turning


@kernel
def interval_balls(intervals, nodes, balls):
    """Balls (intervals, 4) around the samples of every interval with their radii: middle and radius [m]; how many intervals have any.

    No point of a curve through a and b is farther from their middle than half of its length, which is at most that of its Bezier polygon.
    """
    R_a, r_a = pose_before(nodes, 0)
    for i in range(intervals.shape[0]):
        h = intervals[i, 0]
        if h == 0.0:
            return i
        R_b, r_b = pose_of(nodes, i)
        inner = minus(minus(r_b, r_a), times(h / 3.0, plus(tangent(R_a), tangent(R_b))))
        for k in range(3):
            balls[i, k] = 0.5 * (r_a[k] + r_b[k])
        balls[i, 3] = h / 3.0 + 0.5 * math.sqrt(dot(inner, inner)) + intervals[i, 3]
        R_a, r_a = R_b, r_b
    return intervals.shape[0]


@kernel(inline=True)
def is_away(body, balls, i):
    """Whether an obstacle touches nothing in a ball: told by that around the obstacle, or else by its signed distance."""
    middle = triple(balls, i, 0)
    x, reach = minus(middle, body.r), balls[i, 3] + body.obstacles[body.j, EXTENT]
    return dot(x, x) >= reach * reach or distance(body, in_frame(body, middle))[0] >= balls[i, 3]
