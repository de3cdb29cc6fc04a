"""Obstacles as the kernels see them: place at a time, signed distance by the kernel of the shape, and collisions on a way."""

import math
from typing import Any, NamedTuple

from numba.extending import overload, register_jitable

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.contact import columns as at
from soft_tendon_env.effects.contact.obstacle import Obstacle
from soft_tendon_env.effects.contact.shapes import Box, Capsule, Cylinder, Plane, Sphere
from soft_tendon_env.mechanics.algebra.lie import dot, minus, plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.tools.types import Array, Triple

CUTS, SAME = 64, 1e-3
"""Most places at which the way of a sample is looked at, and the share of that within which it comes up to what is allowed."""


class ContactParameters(Struct):
    """The numbers of samples and obstacles; intervals in order from base to tip, the empty ones at the end without samples."""

    intervals: Array  # (nodes, 4): length h [m], first sample, one past the last, largest radius [m]
    samples: Array  # (samples, 10): see columns.py
    obstacles: Array  # (obstacles, 29)
    stiction_speed: float  # [m/s]


SHAPES_OF: dict[type, tuple[type[Obstacle], ...]] = {ContactParameters: (Plane, Sphere, Capsule, Cylinder, Box)}
"""Shapes, by the numbers in the obstacles' rows, of every class of parameters."""


class Body(NamedTuple):
    """An obstacle at a time; vectors in the world frame."""

    contact: ContactParameters
    j: int  # its row among the obstacles
    R: tuple[float, ...]
    r: Triple
    velocity: Triple


@kernel(inline=True)
def triple(rows, i, first):
    """Three numbers of a row as a vector."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


@kernel(refcount=True)
def body_at(contact, j, time):
    """The obstacle of a row at a time [s]."""
    rows = contact.obstacles
    r, v, amplitude = triple(rows, j, at.PLACE), triple(rows, j, at.VELOCITY), triple(rows, j, at.AMPLITUDE)
    x, y, z = triple(rows, j, at.FRAME), triple(rows, j, at.FRAME + 3), triple(rows, j, at.FRAME + 6)
    rate, angle = rows[j, at.RATE], rows[j, at.RATE] * time + rows[j, at.PHASE]
    r = plus(plus(r, times(time, v)), times(math.sin(angle), amplitude))
    v = plus(v, times(rate * math.cos(angle), amplitude))
    return Body(contact, j, (x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]), r, v)


@kernel(inline=True)
def in_frame(body, x):
    """A position [m] in the frame of a body."""
    return rotate_back(body.R, minus(x, body.r))


def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, negative inside, and its gradient: outwards, of length 1."""
    row = body.contact.obstacles[body.j]
    return SHAPES_OF[type(body.contact)][int(row[at.KIND])].distance(tuple(row[at.SIZES : at.SIZES + at.MOST_SIZES].tolist()), x)


@overload(distance)
def _distance_overload(body, x):
    """Calls the kernel of the body's shape, among those that the class of the parameters names."""
    choose = _choice([shape.distance for shape in SHAPES_OF[body.types[0].instance_class]])

    def implementation(body, x):
        rows, j = body.contact.obstacles, body.j
        return choose(rows[j, at.KIND], (rows[j, at.SIZES], rows[j, at.SIZES + 1], rows[j, at.SIZES + 2], rows[j, at.SIZES + 3]), x)

    return implementation


def _choice(kernels: list[Any]) -> Any:
    """A kernel (kind, sizes, x) that calls one of these, by its number."""
    first = kernels[0]
    if len(kernels) == 1:
        return register_jitable(lambda kind, sizes, x: first(sizes, x))
    others = _choice(kernels[1:])
    return register_jitable(lambda kind, sizes, x: first(sizes, x) if kind == 0.0 else others(kind - 1.0, sizes, x))


@kernel
def goes_through(body, start, end, allowed):
    """Whether the distance from a body falls below `allowed` [m] on the straight way between two points in its frame.

    It falls no faster than the way goes on, and that from a convex body no faster than along its tangent.
    """
    way, s, convex = minus(end, start), 0.0, body.contact.obstacles[body.j, at.CONVEX] != 0.0
    length = math.sqrt(dot(way, way))
    if distance(body, end)[0] < allowed:
        return True
    for _ in range(CUTS):
        away, out = distance(body, plus(start, times(s, way)))
        room, fall = away - allowed, -dot(out, way) if convex else length
        if room > fall * (1.0 - s):
            return False
        if room < SAME * length:
            return True
        s += room / fall
    return True


@kernel(refcount=True)
def read_distances(contact, positions, time, out):
    """Signed distance out (obstacles, m) of positions (m, 3) at a time."""
    for j in range(contact.obstacles.shape[0]):
        body = body_at(contact, j, time)
        for m in range(positions.shape[0]):
            out[j, m] = distance(body, in_frame(body, triple(positions, m, 0)))[0]
