"""Obstacles: the shapes, where they are at a time, and signed distances from them.

A shape is a class at the end of this file: by its `kind` of signed distance and its `sizes` kernels
know where it is, and pictures show it.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import (
    coefficients,
    dot,
    exp_se3,
    minus,
    plus,
    rotate,
    rotate_back,
    times,
)
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array, Direction, Frequency, Length, Number, Triple

PLANE, BOX, CYLINDER = (
    0.0,
    1.0,
    2.0,
)  # kinds of signed distances, see `distance`: spheres and capsules are boxes with rounded edges


@kernel(inline=True)
def from_box(sizes, x):
    """Distance from the box of half sizes (a, b, c) with edges rounded outwards by a radius,
    `sizes`: from spheres and capsules too."""
    a, b, c = abs(x[0]) - sizes[0], abs(x[1]) - sizes[1], abs(x[2]) - sizes[2]
    away = max(a, b, c)
    n = (1.0, 0.0, 0.0) if a == away else (0.0, 1.0, 0.0) if b == away else (0.0, 0.0, 1.0)
    if away > 0.0:
        out = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        away = math.sqrt(dot(out, out))
        n = times(1.0 / away, out)
    return away - sizes[3], (
        math.copysign(n[0], x[0]),
        math.copysign(n[1], x[1]),
        math.copysign(n[2], x[2]),
    )


@kernel(inline=True)
def from_cylinder(sizes, x):
    """Distance from the cylinder about z that is, along its radius, the box of half sizes (radius,
    radius, half length)."""
    size = math.sqrt(x[0] * x[0] + x[1] * x[1])
    out_x, out_y = (x[0] / size, x[1] / size) if size > 0.0 else (1.0, 0.0)
    away, n = from_box(sizes, (size, 0.0, x[2]))
    return away, (out_x * n[0], out_y * n[0], n[2])


class Body(NamedTuple):
    """An obstacle at a time; vectors in the world frame."""

    shape: float  # PLANE, BOX or CYLINDER
    thickness: float  # [m] half of its least size: nothing is deeper in it
    friction: float  # mu [-]
    dissipation: float  # c [s/m]
    sizes: tuple[float, ...]  # [m] half sizes, radius of the edges
    R: tuple[float, ...]
    r: Triple
    velocity: Triple


@kernel(inline=True)
def triple(rows, i, first):
    """Three numbers of a row as a vector."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


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
def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, negative inside, and its
    gradient: outwards, of length 1."""
    if body.shape == PLANE:
        return x[2], (0.0, 0.0, 1.0)
    return from_box(body.sizes, x) if body.shape == BOX else from_cylinder(body.sizes, x)


@kernel(inline=True)
def place_in(body, x):
    """A position [m] in the frame of a body, the signed distance [m] from it, and the gradient of
    that."""
    place = rotate_back(body.R, minus(x, body.r))
    away, out = distance(body, place)
    return place, away, out


@kernel
def read_distances(obstacles, positions, time, out, nearest):
    """Signed distances out (obstacles, m) of positions (m, 3) at a time, and the nearest points
    (obstacles, m, 3) of the surfaces."""
    for j in range(obstacles.shape[0]):
        body = body_at(obstacles, j, time)
        for m in range(positions.shape[0]):
            x = triple(positions, m, 0)
            _, away, normal = place_in(body, x)
            surface, out[j, m] = minus(x, times(away, rotate(body.R, normal))), away
            for k in range(3):
                nearest[j, m, k] = surface[k]


class Obstacle(Configuration):
    """Base of the shapes: a rigid solid, fixed or moving without turning."""

    kind: ClassVar[float] = BOX

    type: str
    position: Triple = Field(description="place at time 0 [m], but for the amplitude, world frame")
    velocity: Triple = Field((0.0, 0.0, 0.0), description="constant velocity [m/s]")
    amplitude: Triple = Field(
        (0.0, 0.0, 0.0), description="amplitude of a sinusoidal motion that comes to it [m]"
    )
    frequency: Frequency = Field(0.0, description="frequency of that motion [Hz]")
    phase: Number = Field(0.0, description="phase of that motion [deg]")

    def sizes(self) -> tuple[float, float, float, float]:
        """Half sizes [m] along the axes of its frame, without the radius [m] of its edges, and
        that."""
        raise NotImplementedError(f"{type(self).__name__} needs a method sizes")

    @property
    def orientation(self) -> Array:
        """Rotation (3, 3) of its frame."""
        return np.eye(3)

    @property
    def moves(self) -> bool:
        """Whether its place depends on time."""
        return any((*self.velocity, *self.amplitude))

    @property
    def is_endless(self) -> bool:
        """Whether it is a half-space."""
        return math.isinf(self.sizes()[0])

    def row(self, friction: float, dissipation: float) -> list[float]:
        """Numbers for `body_at`."""
        sizes, motion = self.sizes(), (2.0 * math.pi * self.frequency, math.radians(self.phase))
        numbers = (
            self.kind,
            min(sizes[:3]) + sizes[3],
            friction,
            dissipation,
            *motion,
            *sizes,
            *self.position,
        )
        return [*numbers, *self.orientation.ravel().tolist(), *self.velocity, *self.amplitude]

    def pose(self, time: float) -> Array:
        """Pose (4, 4) of its frame at a time [s]."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = (
            self.orientation,
            body_at(np.array([self.row(0.0, 0.0)]), 0, time).r,
        )
        return pose


class Directed(Obstacle):
    """Base of the shapes with an axis, the z axis of their frame."""

    axis: Direction = Field(
        (0.0, 0.0, 1.0), description="direction of the axis [-], of any length but zero"
    )

    @property
    def orientation(self) -> Array:
        z = np.array(self.axis) / np.linalg.norm(self.axis)
        x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


class Plane(Directed):
    """Half-space below the plane through `position` with outward normal `axis`."""

    kind: ClassVar[float] = PLANE
    type: Literal["plane"] = "plane"

    def sizes(self) -> tuple[float, float, float, float]:
        return math.inf, math.inf, math.inf, 0.0


class Sphere(Obstacle):
    """Sphere of a `radius` [m] about `position`."""

    type: Literal["sphere"] = "sphere"
    radius: Length = Field(description="radius [m]")

    def sizes(self) -> tuple[float, float, float, float]:
        return 0.0, 0.0, 0.0, self.radius


class Box(Obstacle):
    """Box about `position` with edges of `size` (x, y, z) [m], turned by `rotation` (x, y, z):
    angle [deg] times axis."""

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length] = Field(description="edges along the axes of its frame [m]")
    rotation: Triple = Field((0.0, 0.0, 0.0), description="rotation vector of its frame [deg]")

    def sizes(self) -> tuple[float, float, float, float]:
        return 0.5 * self.size[0], 0.5 * self.size[1], 0.5 * self.size[2], 0.0

    @property
    def orientation(self) -> Array:
        x, y, z = np.radians(self.rotation).tolist()
        return np.array(
            exp_se3(((x, y, z), (0.0, 0.0, 0.0)), coefficients(x * x + y * y + z * z))[0]
        ).reshape(3, 3)


class Capsule(Directed):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along
    `axis`."""

    type: Literal["capsule"] = "capsule"
    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis without the caps [m]")

    def sizes(self) -> tuple[float, float, float, float]:
        return 0.0, 0.0, 0.5 * self.length, self.radius


class Cylinder(Directed):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    kind: ClassVar[float] = CYLINDER
    type: Literal["cylinder"] = "cylinder"
    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis [m]")

    def sizes(self) -> tuple[float, float, float, float]:
        return self.radius, self.radius, 0.5 * self.length, 0.0


AnyObstacle = Annotated[Plane | Sphere | Box | Capsule | Cylinder, Field(discriminator="type")]
