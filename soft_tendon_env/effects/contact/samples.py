"""Samples of the arm, at which contact is looked for: balls of its outer radius, evenly along the
axis.

The ball nearest to a spacer disc has the radius of the disc, and stands for its mass too.
Each stands for its share of the length, that at the tip for the round cap too. They lie on the
cubic Hermite curve through neighbouring nodes: with tangents h R e_x for an interval of length h,
x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import cross, plus, rotate, times
from soft_tendon_env.mechanics.effects import BeforeStep, Nodes, make_contact_flags
from soft_tendon_env.mechanics.terms.kinematics import pose_at, pose_of_base, twist_at
from soft_tendon_env.mechanics.types import IntVector
from soft_tendon_env.tools.types import Triple

MOST_SAMPLES = 10_000
SMOOTHING = 0.01  # depth over which the stiffness grows to its full size, in radii of the rod
WALL_SPEED, WALL_MASS = (
    30.0,
    8.0,
    # [m/s] of so many times the mass of its share: an impact that the wall of a sample stops by
    # itself
)


@kernel(inline=True)
def pose_of(nodes, node):
    """Pose (R, r) of a node; node -1 is the base."""
    return pose_of_base(nodes.base) if node < 0 else pose_at(nodes.pose, node)


@kernel(inline=True)
def motion_of(nodes, node, R, r):
    """Angular and linear velocity, in the world frame, of a node at a pose (R, r); node -1 is the
    base."""
    if node < 0:
        w = nodes.base[12], nodes.base[13], nodes.base[14]
        return w, plus((nodes.base[15], nodes.base[16], nodes.base[17]), cross(w, r))
    w, v = twist_at(nodes.twist, node // LANES, node % LANES)
    return rotate(R, w), rotate(R, v)


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
    R_a, r_a = pose_of(nodes, i - 1)
    return Ends(i, R_a, r_a, R_b, r_b)


@kernel(inline=True)
def sample_at(contact, m):
    """The sample of a row."""
    s = contact.samples
    return Sample(s[m, 0], s[m, 1], s[m, 2], s[m, 3], s[m, 4], s[m, 5], s[m, 6], s[m, 7], s[m, 8])


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
    w, v = motion_of(nodes, ends.interval, ends.R_b, ends.r_b)
    w_a, v_a = motion_of(nodes, ends.interval - 1, ends.R_a, ends.r_a)
    velocity = hermite(sample, v_a, cross(w_a, tangent(ends.R_a)), v, cross(w, tangent(ends.R_b)))
    return velocity, plus(times(sample.t, w), times(1.0 - sample.t, w_a))


def nodes_with(pose, twist, base, time):
    """Nodes at poses and with twists in the kernels' layout, for what reads no more of them than
    that, their base and time."""
    none = np.zeros(0)
    check = BeforeStep(none, none, none), make_contact_flags()
    return Nodes(
        pose.size // (12 * LANES), time, none, none, pose, twist, base, none, none, none, *check
    )


def make_samples(rod: Discretisation) -> tuple[Array, Array, Array]:
    """Rows of `ContactParameters.intervals` and `.samples`, and the samples' arc lengths (samples,)
    [m], a radius apart at most."""
    start = np.concatenate([[0.0], rod.node[:-1]])
    h = rod.node - start
    counts = np.ceil(
        h / np.maximum(rod.radius(0.5 * (start + rod.node)), rod.length / MOST_SAMPLES)
    ).astype(int)
    last = np.cumsum(counts)
    t = np.concatenate([np.arange(1, count + 1) / count for count in counts if count])
    length, share = np.repeat(h, counts), np.repeat(h / np.maximum(counts, 1), counts)
    place = np.repeat(start, counts) + t * length
    radius = sample_radius(rod, place)
    share[-1] = 0.5 * share[-1] + radius[-1]  # the tip's round cap
    stiffness = (
        rod.elasticity(place)[:, 3] / (2.0 * rod.radius(place)) ** 2 * share
    )  # E A / (2 r)^2 per length and depth
    wall = WALL_MASS * WALL_SPEED**2 * rod.line_mass(place) * share
    np.add.at(wall, _nearest(rod, place), WALL_MASS * WALL_SPEED**2 * rod.discs[:, 1])
    bases = (
        (1 + 2 * t) * (1 - t) ** 2,
        length * t * (1 - t) ** 2,
        t**2 * (3 - 2 * t),
        length * t**2 * (t - 1),
    )
    samples = np.stack(
        [*bases, t, radius, stiffness, SMOOTHING * radius, wall], axis=1
    )  # in the order of Sample
    largest = [
        radius[end - count : end].max(initial=0.0) for end, count in zip(last, counts, strict=True)
    ]
    return np.stack([h, last - counts, last, largest], axis=1), samples, place


def sample_radius(rod: Discretisation, arc_length: Array) -> Array:
    """Radius (m,) [m] of the balls at arc lengths (m,) [m]: the rod's, or at the ball nearest to a
    spacer disc that of the disc."""
    radius = rod.radius(arc_length)
    np.maximum.at(radius, _nearest(rod, arc_length), rod.discs[:, 2])
    return radius


def _nearest(rod: Discretisation, arc_length: Array) -> IntVector:
    """Which of the arc lengths (m,) is nearest to each disc: (d,)."""
    return np.abs(arc_length - rod.discs[:, :1]).argmin(axis=1)
