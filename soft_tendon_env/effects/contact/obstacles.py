"""Obstacles as a scene names them: planes, spheres, capsules, cylinders and boxes, fixed or moving along a prescribed path."""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from soft_tendon_env.effects.base import Array, Solid
from soft_tendon_env.effects.contact.distance import BOX, CAPSULE, CYLINDER, PLANE, body_at, rotation_by
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import LEAST, Frequency, Length, NotNegative, Number, Turning
from soft_tendon_env.tools.types import Triple as Vector


class Obstacle(Configuration):
    """A solid that may move: `position` at time 0 [m], constant `velocity` [m/s] and `angular_velocity` [rad/s] about `centre` (None: its
    position), which moves along, and a swing `amplitude` sin(2 pi `frequency` t + `phase`) of its place [m, Hz, degrees]; `friction`
    coefficient mu, None: that of the table."""

    kind: ClassVar[float]  # of signed distance

    position: Vector
    velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: tuple[Turning, Turning, Turning] = (0.0, 0.0, 0.0)
    centre: Vector | None = None
    amplitude: Vector = (0.0, 0.0, 0.0)
    frequency: Frequency = 0.0
    phase: Number = 0.0
    friction: NotNegative | None = None

    @property
    def dimensions(self) -> Vector:
        """Half sizes [m] as the signed distance reads them."""
        raise NotImplementedError

    @property
    def orientation(self) -> Array:
        """Rotation (3, 3) at time 0."""
        return np.eye(3)

    @property
    def extent(self) -> float:
        """Radius [m] of a ball around its position that holds it."""
        return math.hypot(*self.dimensions)

    @property
    def thickness(self) -> float:
        """Half of its least size [m]."""
        return min(filter(None, self.dimensions), default=math.inf)

    @property
    def moves(self) -> bool:
        """Whether its pose depends on time."""
        return any((*self.velocity, *self.angular_velocity, *self.amplitude))

    @property
    def edges(self) -> tuple[float, ...]:
        """Sizes [m] of the solid that pictures show, see `Solid`."""
        raise NotImplementedError

    def solid(self, time: float) -> Solid:
        """The solid as pictures show it at a time [s]."""
        pose, body = np.eye(4), body_at(np.array([self.row(0.0, 0.0)]), 0, time)
        pose[:3, :3], pose[:3, 3] = np.array(body.R).reshape(3, 3), body.r
        return Solid(self.type, self.edges, pose)  # type: ignore[attr-defined] # a field of every class below

    def row(self, friction: float, dissipation: float) -> list[float]:
        """Numbers of the obstacle, in the order in which `body_at` reads them."""
        centre = self.position if self.centre is None else self.centre
        swing = 2.0 * math.pi * self.frequency, math.radians(self.phase)
        own = friction if self.friction is None else self.friction
        return [
            self.kind, *self.dimensions, *self.position, *self.orientation.ravel().tolist(), *self.velocity, *self.angular_velocity,
            *centre, *self.amplitude, *swing, own, dissipation, self.extent, self.thickness,
        ]  # fmt: skip


class Directed(Obstacle):
    """Base of the obstacles with an axis, a vector of any length but zero."""

    axis: Vector = (0.0, 0.0, 1.0)

    @field_validator("axis")
    @classmethod
    def _is_a_direction(cls, axis: Vector) -> Vector:
        if max(map(abs, axis)) < LEAST:
            raise ValueError("should be a direction, not zero")
        return axis

    @property
    def orientation(self) -> Array:
        z = np.array(self.axis) / np.linalg.norm(self.axis)
        x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


class Plane(Directed):
    """Half-space below the plane through `position` with outward normal `axis`."""

    kind = PLANE
    type: Literal["plane"] = "plane"

    @property
    def dimensions(self) -> Vector:
        return 0.0, 0.0, 0.0

    @property
    def extent(self) -> float:
        return math.inf

    @property
    def edges(self) -> tuple[float, ...]:
        return ()


class Sphere(Obstacle):
    """Sphere of a `radius` [m] about `position`."""

    kind = CAPSULE  # without length
    type: Literal["sphere"] = "sphere"
    radius: Length

    @property
    def dimensions(self) -> Vector:
        return self.radius, 0.0, 0.0

    @property
    def edges(self) -> tuple[float, ...]:
        return (self.radius,)


class Round(Directed):
    """Base of the solids of revolution: of a `radius` and a `length` [m] along `axis`, about `position`."""

    radius: Length
    length: Length

    @property
    def dimensions(self) -> Vector:
        return self.radius, 0.5 * self.length, 0.0

    @property
    def edges(self) -> tuple[float, ...]:
        return self.radius, self.length


class Capsule(Round):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along `axis`."""

    kind = CAPSULE
    type: Literal["capsule"] = "capsule"

    @property
    def extent(self) -> float:
        return self.radius + 0.5 * self.length

    @property
    def thickness(self) -> float:
        return self.radius


class Cylinder(Round):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    kind = CYLINDER
    type: Literal["cylinder"] = "cylinder"


class Box(Obstacle):
    """Box about `position` with edges of `size` (x, y, z) [m], turned by `rotation` (x, y, z): angle [degrees] times axis."""

    kind = BOX
    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length]
    rotation: Vector = (0.0, 0.0, 0.0)

    @property
    def dimensions(self) -> Vector:
        x, y, z = self.size
        return 0.5 * x, 0.5 * y, 0.5 * z

    @property
    def orientation(self) -> Array:
        x, y, z = np.radians(self.rotation).tolist()
        return np.array(rotation_by((x, y, z))).reshape(3, 3)

    @property
    def edges(self) -> tuple[float, ...]:
        return self.size


AnyObstacle = Annotated[Plane | Sphere | Capsule | Cylinder | Box, Field(discriminator="type")]
