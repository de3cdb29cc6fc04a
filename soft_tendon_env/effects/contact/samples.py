"""Samples of the arm, at which contact is looked for.

They lie evenly along the axis: balls of its outer radius, or outlines of flat sections.

The sample nearest to a spacer disc that stands out is a ball with the radius of the disc, and
stands for its mass too. Each stands for its share of the length, that at the tip for the round cap
too. They lie on the cubic Hermite curve through neighbouring nodes: with tangents h R e_x for an
interval of length h, x(t) = H00 r_a + H10 h R_a e_x + H01 r_b + H11 h R_b e_x.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation
from soft_tendon_env.effects.contact.outline import ELLIPSE, RECTANGLE, ROUND
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    columns_of,
    cross,
    plus,
    rotate,
    times,
    twist_of,
)
from soft_tendon_env.mechanics.effects import BeforeStep, Nodes, make_contact_flags
from soft_tendon_env.mechanics.terms.kinematics import pose_at, pose_of_base, twist_at
from soft_tendon_env.mechanics.types import IntVector
from soft_tendon_env.tools.types import Triple

MOST_SAMPLES = 10_000
SMOOTHING = 0.01  # depth over which the stiffness grows to its full size, in radii of the rod
# an impact that the wall of a sample stops by itself: at a speed [m/s], of so many times the mass
# of its share
WALL_SPEED = 30.0
WALL_MASS = 8.0


@kernel(inline=True)
def pose_of(nodes, node):
    """Pose (R, r) of a node; node -1 is the base."""
    return pose_of_base(nodes.base) if node < 0 else pose_at(nodes.pose, node)


@kernel(inline=True)
def motion_of(nodes, node, R, r):
    """Angular and linear velocity of a node at a pose (R, r), in the world frame.

    Node -1 is the base.
    """
    if node < 0:  # the velocity is that of the point of the base at the world's origin
        w, v = twist_of(nodes.base[12:18])
        return w, plus(v, cross(w, r))
    w, v = twist_at(nodes.twist, node // LANES, node % LANES)
    return rotate(R, w), rotate(R, v)


class Sample(NamedTuple):
    """A piece of the arm at its place t between the nodes a and b of an interval of length h."""

    h_a: float  # H00 [-]
    reach_a: float  # h H10 [m]
    h_b: float
    reach_b: float
    t: float
    radius: float  # [m] of a ball; of a flat section half of its least width
    stiffness: float  # k [N/m]
    smoothing: float  # e [m]
    wall: float  # scale [J] of the wall's energy
    shape: float  # ROUND, ELLIPSE or RECTANGLE
    half_y: float  # [m] half widths of a flat section
    half_z: float


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
    row = contact.samples[m]
    h_a, reach_a, h_b, reach_b = row[0], row[1], row[2], row[3]
    t, radius, stiffness, smoothing, wall = row[4], row[5], row[6], row[7], row[8]
    shape, half_y, half_z = row[9], row[10], row[11]
    return Sample(
        h_a,
        reach_a,
        h_b,
        reach_b,
        t,
        radius,
        stiffness,
        smoothing,
        wall,
        shape,
        half_y,
        half_z,
    )


@kernel(inline=True)
def hermite(sample, a, tangent_a, b, tangent_b):
    """The cubic between vectors a and b, with these tangents, at a sample."""
    of_a = plus(times(sample.h_a, a), times(sample.reach_a, tangent_a))
    of_b = plus(times(sample.h_b, b), times(sample.reach_b, tangent_b))
    return plus(of_a, of_b)


@kernel(inline=True)
def position_of(sample, ends):
    """Position of a sample's middle [m]."""
    tangent_a, _, _ = columns_of(ends.R_a)
    tangent_b, _, _ = columns_of(ends.R_b)
    return hermite(sample, ends.r_a, tangent_a, ends.r_b, tangent_b)


@kernel(inline=True)
def axes_of(sample, ends):
    """Axes y and z of the section at a sample, in the world frame.

    They are means of those of both nodes, so that a point of the section moves linearly with them.
    """
    t = sample.t
    rest = 1.0 - t
    _, y_a, z_a = columns_of(ends.R_a)
    _, y_b, z_b = columns_of(ends.R_b)
    y_axis = plus(times(t, y_b), times(rest, y_a))
    z_axis = plus(times(t, z_b), times(rest, z_a))
    return y_axis, z_axis


@kernel(inline=True)
def motion_at(sample, ends, nodes):
    """Velocity of a sample's middle, and angular velocity, in the world frame."""
    before = ends.interval - 1
    t = sample.t
    w_a, v_a = motion_of(nodes, before, ends.R_a, ends.r_a)
    w_b, v_b = motion_of(nodes, ends.interval, ends.R_b, ends.r_b)
    tangent_a, _, _ = columns_of(ends.R_a)
    tangent_b, _, _ = columns_of(ends.R_b)
    turning_a = cross(w_a, tangent_a)
    turning_b = cross(w_b, tangent_b)
    velocity = hermite(sample, v_a, turning_a, v_b, turning_b)
    turning = plus(times(t, w_b), times(1.0 - t, w_a))
    return velocity, turning


def nodes_with(pose, twist, base, time):
    """Nodes at poses and with twists in the kernels' layout.

    They are for what reads no more of them than that, their base and time.
    """
    none = np.zeros(0)
    return Nodes(
        packs=pose.size // (12 * LANES),
        time=time,
        mass=none,
        inertia=none,
        pose=pose,
        twist=twist,
        base=base,
        wrench=none,
        stiffness=none,
        damping=none,
        before_step=BeforeStep(none, none, none),
        contact=make_contact_flags(),
    )


def make_samples(rod: Discretisation) -> tuple[Array, Array, Array]:
    """Rows of `ContactParameters.intervals` and `.samples`, and the samples' arc lengths.

    These are (samples,) [m], a radius apart at most: of a flat section the geometric mean of its
    half widths.
    """
    start = np.concatenate([[0.0], rod.node[:-1]])
    h = rod.node - start
    # how many to an interval, and where in it
    middle = 0.5 * (start + rod.node)
    half_widths = rod.half_widths(middle)
    spacing = np.sqrt(np.prod(half_widths, axis=0))
    least_apart = rod.length / MOST_SAMPLES
    apart = np.maximum(spacing, least_apart)
    counts = np.ceil(h / apart).astype(int)
    shares = [np.arange(1, count + 1) / count for count in counts if count]
    t = np.concatenate(shares)
    length = np.repeat(h, counts)
    place = np.repeat(start, counts) + t * length
    outline = sample_outlines(rod, place)
    radius = outline.radius
    # the length of rod that each stands for, the last one for the tip's round cap too
    own_length = h / np.maximum(counts, 1)
    share = np.repeat(own_length, counts)
    share[-1] = 0.5 * share[-1] + radius[-1]
    # E A / (2 r)^2 per length and depth: of a flat section across its larger width, the softer way
    axial = rod.elasticity(place)[:, 3]
    width = 2.0 * rod.half_widths(place).max(axis=0)
    stiffness = axial / width**2 * share
    smoothing = SMOOTHING * radius
    # energy of the wall: of the rod, and of the discs at the nearest samples
    unit = WALL_MASS * WALL_SPEED**2
    wall = unit * rod.line_mass(place) * share
    disc_mass = rod.discs[:, 1]
    np.add.at(wall, _nearest(rod, place), unit * disc_mass)
    # in the order of Sample
    columns = [
        *_hermite_columns(t, length),
        t,
        radius,
        stiffness,
        smoothing,
        wall,
        outline.shape,
        *outline.half_widths,
    ]
    last = np.cumsum(counts)
    first = last - counts
    largest = []
    for begin, end in zip(first, last, strict=True):
        of_interval = outline.largest[begin:end]
        largest.append(of_interval.max(initial=0.0))
    intervals = np.stack([h, first, last, largest], axis=1)
    return intervals, np.stack(columns, axis=1), place


def _hermite_columns(t: Array, length: Array) -> list[Array]:
    """Hermite polynomials H00, h H10, H01, h H11 at shares t (m,) of intervals of lengths (m,)."""
    rest = 1 - t
    h_a = (1 + 2 * t) * rest**2
    reach_a = length * t * rest**2
    h_b = t**2 * (3 - 2 * t)
    reach_b = length * t**2 * (t - 1)
    return [h_a, reach_a, h_b, reach_b]


class Outlines(NamedTuple):
    """Outlines of samples."""

    shape: Array  # (m,) ROUND, ELLIPSE or RECTANGLE
    radius: Array  # (m,) [m] of a ball; of a flat section half of its least width
    largest: Array  # (m,) [m] of the circle around the section or disc
    half_widths: Array  # (2, m) [m] along y and z


def sample_outlines(rod: Discretisation, arc_length: Array) -> Outlines:
    """Outlines of samples at arc lengths (m,) [m].

    They are the rod's, or at the sample nearest to a spacer disc that stands out that of the disc.
    """
    half_widths = rod.half_widths(arc_length)
    is_round = half_widths[0] == half_widths[1]
    flat_shape = np.where(rod.has_corners(arc_length), RECTANGLE, ELLIPSE)
    is_circle = is_round & (flat_shape == ELLIPSE)
    shape = np.where(is_circle, ROUND, flat_shape)
    around = rod.radius(arc_length)
    largest = around.copy()
    np.maximum.at(largest, _nearest(rod, arc_length), rod.discs[:, 2])
    is_disc = largest > around
    shape[is_disc] = ROUND
    radius = np.where(shape == ROUND, largest, half_widths.min(axis=0))
    return Outlines(shape, radius, largest, half_widths)


def _nearest(rod: Discretisation, arc_length: Array) -> IntVector:
    """Which of the arc lengths (m,) is nearest to each disc: (d,)."""
    return np.abs(arc_length - rod.discs[:, :1]).argmin(axis=1)
