"""Obstacles: what every shape has, and the table of shapes by which scenes name them.

A shape is one class under `@register_shape`, in shapes.py or in a user's own file: its keys, its `geometry`, and the kernel `distance`,
which gives the signed distance and its gradient in the obstacle's frame.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, field_validator

from soft_tendon_env.effects.base import Array, Solid
from soft_tendon_env.effects.contact.columns import MOST_SIZES
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, shown
from soft_tendon_env.tools.types import LEAST, Frequency, NotNegative, Number, Triple


class Geometry(NamedTuple):
    """A shape in its own frame."""

    sizes: tuple[float, ...]  # [m] at most MOST_SIZES, which its distance reads
    thickness: float  # [m] half of its least size: nothing is deeper in it
    solids: tuple[tuple[Literal["plane", "sphere", "capsule", "cylinder", "box"], tuple[float, ...]], ...]  # kind and size, see `Solid`


class Obstacle(Configuration):
    """Base of the shapes: a rigid solid, fixed or moving without turning.

    Attributes:
        convex: whether the solid is convex, of which the check for collisions makes use.
        distance: kernel (sizes, x) of the signed distance [m] from the surface to x (3) in the obstacle's frame, negative inside, and its
            gradient: outwards, of length 1. sizes are those of its geometry, and zeros up to MOST_SIZES.
    """

    convex: ClassVar[bool] = True
    distance: ClassVar[Any]

    type: str
    position: Triple = Field(description="place at time 0 [m], but for the amplitude, world frame")
    velocity: Triple = Field((0.0, 0.0, 0.0), description="constant velocity [m/s]")
    amplitude: Triple = Field((0.0, 0.0, 0.0), description="amplitude of a sinusoidal motion that comes to it [m]")
    frequency: Frequency = Field(0.0, description="frequency of that motion [Hz]")
    phase: Number = Field(0.0, description="phase of that motion [deg]")
    friction: NotNegative | None = Field(None, description="coefficient of friction mu [-]; by default that of the table")

    def geometry(self) -> Geometry:
        """Return what the kernels and pictures need of the shape."""
        raise NotImplementedError(f"{type(self).__name__} needs a method geometry()")

    @property
    def orientation(self) -> Array:
        """Rotation (3, 3) of its frame."""
        return np.eye(3)

    @property
    def moves(self) -> bool:
        """Whether its place depends on time."""
        return any((*self.velocity, *self.amplitude))

    def solids(self, time: float) -> list[Solid]:
        """Solids that show it at a time [s]."""
        pose, angle = np.eye(4), 2.0 * np.pi * self.frequency * time + np.radians(self.phase)
        pose[:3, :3] = self.orientation
        pose[:3, 3] = np.array(self.position) + time * np.array(self.velocity) + np.sin(angle) * np.array(self.amplitude)
        return [Solid(kind, size, pose) for kind, size in self.geometry().solids]

    def row(self, kind: int, friction: float, dissipation: float) -> list[float]:
        """Numbers of the obstacle, see columns.py; its shape is that of the number `kind` among those of the parameters."""
        own, shape = friction if self.friction is None else self.friction, self.geometry()
        sizes = [*shape.sizes, *[0.0] * (MOST_SIZES - len(shape.sizes))]
        swing = 2.0 * math.pi * self.frequency, math.radians(self.phase)
        numbers = [float(kind), float(self.convex), shape.thickness, own, dissipation, *swing, *sizes]
        return [*numbers, *self.position, *self.orientation.ravel().tolist(), *self.velocity, *self.amplitude]


class Directed(Obstacle):
    """Base of the shapes with an axis, the z axis of their frame."""

    axis: Triple = Field((0.0, 0.0, 1.0), description="direction of the axis [-], of any length but zero")

    @field_validator("axis")
    @classmethod
    def _is_a_direction(cls, axis: Triple) -> Triple:
        if max(map(abs, axis)) < LEAST:
            raise ValueError("should be a direction, not zero")
        return axis

    @property
    def orientation(self) -> Array:
        z = np.array(self.axis) / np.linalg.norm(self.axis)
        x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z], axis=1)


Class = TypeVar("Class", bound=type[Obstacle])

SHAPES: dict[str, type[Obstacle]] = {}
"""Every registered shape by its name."""


def register_shape(shape: Class) -> Class:
    """Class decorator: make an `Obstacle` with a field such as `type: Literal["torus"] = "torus"` available to scenes by that name.

    Registering a class of the same module and name again replaces it. Raises ValueError for a name that is taken.
    """
    (name,) = get_args(shape.__pydantic_fields__["type"].annotation)
    present = SHAPES.get(name, shape)
    if (present.__module__, present.__qualname__) != (shape.__module__, shape.__qualname__):
        raise ValueError(f"the shape {name!r} is registered twice: {present.__module__}, {shape.__module__}")
    SHAPES[name] = shape
    return shape


def _obstacle(value: object) -> object:
    """The obstacle of a table. Raises ConfigurationError."""
    if not isinstance(value, Mapping):
        return value
    name = value.get("type")
    if name not in SHAPES:
        raise ConfigurationError([Problem(("type",), f"is {shown(name)}: {not_among(str(name), SHAPES)}")])
    return SHAPES[name](**value)


AnyObstacle = Annotated[SerializeAsAny[Obstacle], BeforeValidator(_obstacle)]
