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
    angle_coefficients,
    dot,
    exp_se3,
    minus,
    plus,
    rotate,
    rotate_back,
    times,
)
from soft_tendon_env.mechanics.terms.kinematics import triple
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array, Direction, Frequency, Length, Number, Triple

PLANE = 0.0
BOX = 1.0
CYLINDER = 2.0
"""Kinds of signed distances, see `distance`: spheres and capsules are boxes with rounded edges."""

# columns of Obstacle.row
OMEGA = 4  # [rad/s] of the sinusoidal motion
PHASE = 5  # [rad]
SIZES = 6  # to 9 [m]
POSITION = 10  # to 12 [m]
ORIENTATION = 13  # to 21, rows of the rotation
VELOCITY = 22  # to 24 [m/s]
AMPLITUDE = 25  # to 27 [m]


@kernel(inline=True)
def from_box(sizes, x):
    """Distance from the box of half sizes (a, b, c) with edges rounded outwards by a radius.

    All are `sizes`; it serves spheres and capsules too.
    """
    # in the octant where all coordinates are positive
    a = abs(x[0]) - sizes[0]
    b = abs(x[1]) - sizes[1]
    c = abs(x[2]) - sizes[2]
    away = max(a, b, c)
    if away > 0.0:  # outside: from the nearest point of face, edge or corner
        out = (max(a, 0.0), max(b, 0.0), max(c, 0.0))
        away = math.sqrt(dot(out, out))
        n = times(1.0 / away, out)
    elif a == away:
        n = (1.0, 0.0, 0.0)
    elif b == away:
        n = (0.0, 1.0, 0.0)
    else:
        n = (0.0, 0.0, 1.0)
    normal = (
        math.copysign(n[0], x[0]),
        math.copysign(n[1], x[1]),
        math.copysign(n[2], x[2]),
    )
    return away - sizes[3], normal


@kernel(inline=True)
def from_cylinder(sizes, x):
    """Distance from the cylinder about z of a radius and a half length.

    Along its radius it is the box of half sizes (radius, radius, half length).
    """
    radius = math.sqrt(x[0] * x[0] + x[1] * x[1])
    out_x = 1.0
    out_y = 0.0
    if radius > 0.0:
        out_x = x[0] / radius
        out_y = x[1] / radius
    away, normal = from_box(sizes, (radius, 0.0, x[2]))
    out, _, out_z = normal
    return away, (out_x * out, out_y * out, out_z)


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


@kernel
def body_at(obstacles, j, time):
    """The obstacle of a row at a time [s]."""
    row = obstacles[j]
    shape = row[0]
    thickness = row[1]
    friction = row[2]
    dissipation = row[3]
    sizes = (row[SIZES], row[SIZES + 1], row[SIZES + 2], row[SIZES + 3])
    # r(t) = r(0) + v t + amplitude sin(omega t + phase)
    omega = row[OMEGA]
    angle = omega * time + row[PHASE]
    amplitude = triple(obstacles, j, AMPLITUDE)
    constant = triple(obstacles, j, VELOCITY)
    start = triple(obstacles, j, POSITION)
    carried = plus(start, times(time, constant))
    r = plus(carried, times(math.sin(angle), amplitude))
    swing_rate = omega * math.cos(angle)
    velocity = plus(constant, times(swing_rate, amplitude))
    first = triple(obstacles, j, ORIENTATION)
    second = triple(obstacles, j, ORIENTATION + 3)
    third = triple(obstacles, j, ORIENTATION + 6)
    R = first + second + third
    return Body(shape, thickness, friction, dissipation, sizes, R, r, velocity)


@kernel(inline=True)
def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, and its gradient.

    The distance is negative inside; the gradient points outwards and has length 1.
    """
    if body.shape == PLANE:
        return x[2], (0.0, 0.0, 1.0)
    if body.shape == BOX:
        return from_box(body.sizes, x)
    return from_cylinder(body.sizes, x)


@kernel(inline=True)
def in_frame_of(body, x):
    """Position [m] in the frame of a body."""
    return rotate_back(body.R, minus(x, body.r))


@kernel(inline=True)
def place_in(body, x):
    """Position [m] in the frame of a body, the signed distance [m] from it, and its gradient."""
    place = in_frame_of(body, x)
    away, out = distance(body, place)
    return place, away, out


@kernel
def read_distances(obstacles, positions, time, out, nearest):
    """Writes signed distances and nearest points of the surfaces to positions at a time.

    Distances out are (obstacles, m), positions (m, 3), nearest points (obstacles, m, 3).
    """
    for j in range(obstacles.shape[0]):
        body = body_at(obstacles, j, time)
        for m in range(positions.shape[0]):
            x = triple(positions, m, 0)
            _, away, out_there = place_in(body, x)
            out[j, m] = away
            normal = rotate(body.R, out_there)
            surface = minus(x, times(away, normal))
            for k in range(3):
                nearest[j, m, k] = surface[k]


class Obstacle(Configuration):
    """Base of the shapes: a rigid solid, fixed or moving without turning."""

    kind: ClassVar[float] = BOX

    type: str  # shape: "plane", "sphere", "box", "capsule" or "cylinder"
    position: Triple = Field(description="place at time 0 [m], but for the amplitude, world frame")
    velocity: Triple = Field((0.0, 0.0, 0.0), description="constant velocity [m/s]")
    amplitude: Triple = Field(
        (0.0, 0.0, 0.0), description="amplitude of a sinusoidal motion that comes to it [m]"
    )
    frequency: Frequency = Field(0.0, description="frequency of that motion [Hz]")
    phase: Number = Field(0.0, description="phase of that motion [deg]")

    def sizes(self) -> tuple[float, float, float, float]:
        """Half sizes [m] along the axes of its frame, and the radius [m] of its edges.

        The half sizes are without that radius.
        """
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
        sizes = self.sizes()
        thickness = min(sizes[:3]) + sizes[3]
        return [
            self.kind,
            thickness,
            friction,
            dissipation,
            2.0 * math.pi * self.frequency,
            math.radians(self.phase),
            *sizes,
            *self.position,
            *self.orientation.ravel().tolist(),
            *self.velocity,
            *self.amplitude,
        ]

    def pose(self, time: float) -> Array:
        """Pose (4, 4) of its frame at a time [s]."""
        row = self.row(0.0, 0.0)
        body = body_at(np.array([row]), 0, time)
        pose = np.eye(4)
        pose[:3, :3] = self.orientation
        pose[:3, 3] = body.r
        return pose


class Directed(Obstacle):
    """Base of the shapes with an axis, the z axis of their frame."""

    axis: Direction = Field(
        (0.0, 0.0, 1.0), description="direction of the axis [-], of any length but zero"
    )

    @property
    def orientation(self) -> Array:
        length = np.linalg.norm(self.axis)
        z = np.array(self.axis) / length
        # across it, from the world axis that is farthest from it
        along_world_axes = np.abs(z)
        farthest = np.argmin(along_world_axes)
        world_axis = np.zeros(3)
        world_axis[farthest] = 1.0
        x = np.cross(world_axis, z)
        x /= np.linalg.norm(x)
        y = np.cross(z, x)
        return np.stack([x, y, z], axis=1)


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
    """Box about `position` with edges of `size` (x, y, z) [m].

    It is turned by `rotation` (x, y, z): angle [deg] times axis.
    """

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length] = Field(description="edges along the axes of its frame [m]")
    rotation: Triple = Field((0.0, 0.0, 0.0), description="rotation vector of its frame [deg]")

    def sizes(self) -> tuple[float, float, float, float]:
        return 0.5 * self.size[0], 0.5 * self.size[1], 0.5 * self.size[2], 0.0

    @property
    def orientation(self) -> Array:
        turn = tuple(np.radians(self.rotation).tolist())
        twist = (turn, (0.0, 0.0, 0.0))
        R, _ = exp_se3(twist, angle_coefficients(twist))
        return np.array(R).reshape(3, 3)


class Capsule(Directed):
    """Capsule about `position`: points up to `radius` [m] from a line.

    The line has this `length` [m] along `axis`.
    """

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
