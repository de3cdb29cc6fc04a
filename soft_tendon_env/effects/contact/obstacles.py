"""Obstacles: what every shape has, the shapes of the package, and the table by which scenes name them.

A shape is one class under `@register_shape`, here or in a user's own file: its keys, its `geometry`, and the kernel `distance`, which gives
the signed distance and its gradient in the obstacle's frame. Kernels of the package are compiled into what calls them; others are called
at their addresses, so that nothing else is compiled for them.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic, overload
from pydantic import BeforeValidator, Field, SerializeAsAny, field_validator

from soft_tendon_env.compiler.compilation import OPTIONS, Kernel, address_of, emit_call_at, kernel
from soft_tendon_env.effects.base import Array, Solid
from soft_tendon_env.mechanics.algebra.lie import coefficients, dot, exp_se3, minus, plus, rotate_back, times
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, shown
from soft_tendon_env.tools.types import LEAST, Frequency, Length, NotNegative, Number, Triple

MOST_SIZES = 4


class Geometry(NamedTuple):
    """A shape in its own frame."""

    sizes: tuple[float, ...]  # [m] at most MOST_SIZES, which its distance reads
    thickness: float  # [m] half of its least size: nothing is deeper in it
    solids: tuple[tuple[Literal["plane", "sphere", "capsule", "cylinder", "box"], tuple[float, ...]], ...]  # kind and size, see `Solid`


@kernel(inline=True)
def above_plane(sizes, x):
    """Height above the plane."""
    return x[2], (0.0, 0.0, 1.0)


@kernel(inline=True)
def from_box(sizes, x):
    """Distance from the box of half sizes (a, b, c) with edges rounded outwards by a radius, `sizes`: from spheres and capsules too."""
    a, b, c = abs(x[0]) - sizes[0], abs(x[1]) - sizes[1], abs(x[2]) - sizes[2]
    away = max(a, b, c)
    n = (1.0, 0.0, 0.0) if a == away else (0.0, 1.0, 0.0) if b == away else (0.0, 0.0, 1.0)
    if away > 0.0:
        out = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        away = math.sqrt(dot(out, out))
        n = times(1.0 / away, out)
    return away - sizes[3], (math.copysign(n[0], x[0]), math.copysign(n[1], x[1]), math.copysign(n[2], x[2]))


@kernel(inline=True)
def from_cylinder(sizes, x):
    """Distance from the cylinder about z that is, along its radius, the box of half sizes (radius, infinity, half length)."""
    size = math.sqrt(x[0] * x[0] + x[1] * x[1])
    out_x, out_y = (x[0] / size, x[1] / size) if size > 0.0 else (1.0, 0.0)
    away, n = from_box(sizes, (size, 0.0, x[2]))
    return away, (out_x * n[0], out_y * n[0], n[2])


OF_PACKAGE = above_plane, from_box, from_cylinder
_OTHERS: list[Any] = []  # kernels of other shapes
_KINDS = types.UniTuple(types.float64, MOST_SIZES), types.UniTuple(types.float64, 3)


@intrinsic
def _call_at(typingctx, number, sizes, x):
    returned = types.Tuple((types.float64, _KINDS[1]))

    def emit(context, builder, signature, given):
        address = builder.fptosi(given[0], ir.IntType(64))
        return emit_call_at(context, builder, address, returned, _KINDS, given[1:])

    return returned(number, sizes, x), emit


def other_distance(number, sizes, x):
    """Distance and gradient by the kernel of a shape that is not among the package's: its number is the kernel's address."""
    return _OTHERS[int(number) - len(OF_PACKAGE)](sizes, x)


@overload(other_distance)
def _other_distance_overload(number, sizes, x):
    return lambda number, sizes, x: _call_at(number, sizes, x)


@kernel(inline=True)
def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, negative inside, and its gradient: outwards, of length 1."""
    if body.shape == 0.0:
        return above_plane(body.sizes, x)
    if body.shape == 1.0:
        return from_box(body.sizes, x)
    return from_cylinder(body.sizes, x) if body.shape == 2.0 else other_distance(body.shape, body.sizes, x)


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
def place_in(body, x):
    """A position [m] in the frame of a body, the signed distance [m] from it, and the gradient of that."""
    place = rotate_back(body.R, minus(x, body.r))
    away, out = distance(body, place)
    return place, away, out


@kernel
def read_distances(obstacles, positions, time, out):
    """Signed distance out (obstacles, m) of positions (m, 3) at a time."""
    for j in range(obstacles.shape[0]):
        body = body_at(obstacles, j, time)
        for m in range(positions.shape[0]):
            out[j, m] = place_in(body, triple(positions, m, 0))[1]


class Obstacle(Configuration):
    """Base of the shapes: a rigid solid, fixed or moving without turning.

    Attributes:
        distance: kernel (sizes, x) of the signed distance [m] from the surface to x (3) in the obstacle's frame, negative inside, and its
            gradient: outwards, of length 1. sizes are those of its geometry, and zeros up to MOST_SIZES.
    """

    distance: ClassVar[Any]
    number: ClassVar[float]

    type: str
    position: Triple = Field(description="place at time 0 [m], but for the amplitude, world frame")
    velocity: Triple = Field((0.0, 0.0, 0.0), description="constant velocity [m/s]")
    amplitude: Triple = Field((0.0, 0.0, 0.0), description="amplitude of a sinusoidal motion that comes to it [m]")
    frequency: Frequency = Field(0.0, description="frequency of that motion [Hz]")
    phase: Number = Field(0.0, description="phase of that motion [deg]")
    friction: NotNegative | None = Field(None, description="coefficient of friction mu [-]; by default that of the table")

    def geometry(self) -> Geometry:
        """Sizes, thickness and solids of the shape, for kernels and pictures."""
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

    def row(self, friction: float, dissipation: float) -> list[float]:
        """Numbers of the obstacle for `body_at`."""
        own, shape = friction if self.friction is None else self.friction, self.geometry()
        sizes = [*shape.sizes, *[0.0] * (MOST_SIZES - len(shape.sizes))]
        swing = 2.0 * math.pi * self.frequency, math.radians(self.phase)
        numbers = [self.number, shape.thickness, own, dissipation, *swing, *sizes]
        return [*numbers, *self.position, *self.orientation.ravel().tolist(), *self.velocity, *self.amplitude]


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
    shape.number = float(OF_PACKAGE.index(shape.distance) if shape.distance in OF_PACKAGE else _place(shape.distance))
    SHAPES[name] = shape
    return shape


def _place(function: Any) -> int:
    """Number by which `other_distance` finds a kernel in this process: its address."""

    def enter(sizes, x):
        away, n = function(sizes, x)
        return float(away), (float(n[0]), float(n[1]), float(n[2]))

    _OTHERS.append(enter if config.DISABLE_JIT else Kernel(enter, OPTIONS, keep=False))
    return len(OF_PACKAGE) + len(_OTHERS) - 1 if config.DISABLE_JIT else address_of(_OTHERS[-1].compiled(_KINDS))


def _obstacle(value: object) -> object:
    """The obstacle of a table. Raises ConfigurationError."""
    if not isinstance(value, Mapping):
        return value
    name = value.get("type")
    if name not in SHAPES:
        raise ConfigurationError([Problem(("type",), f"is {shown(name)}: {not_among(str(name), SHAPES)}")])
    return SHAPES[name](**value)


AnyObstacle = Annotated[SerializeAsAny[Obstacle], BeforeValidator(_obstacle)]


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


@register_shape
class Plane(Directed):
    """Half-space below the plane through `position` with outward normal `axis`."""

    type: Literal["plane"] = "plane"
    distance = above_plane

    def geometry(self) -> Geometry:
        return Geometry((), math.inf, (("plane", ()),))


@register_shape
class Sphere(Obstacle):
    """Sphere of a `radius` [m] about `position`."""

    type: Literal["sphere"] = "sphere"
    radius: Length = Field(description="radius [m]")
    distance = from_box

    def geometry(self) -> Geometry:
        return Geometry((0.0, 0.0, 0.0, self.radius), self.radius, (("sphere", (self.radius,)),))


@register_shape
class Box(Obstacle):
    """Box about `position` with edges of `size` (x, y, z) [m], turned by `rotation` (x, y, z): angle [deg] times axis."""

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length] = Field(description="edges along the axes of its frame [m]")
    rotation: Triple = Field((0.0, 0.0, 0.0), description="rotation vector of its frame [deg]")
    distance = from_box

    @property
    def orientation(self) -> Array:
        x, y, z = np.radians(self.rotation).tolist()
        return np.array(exp_se3(((x, y, z), (0.0, 0.0, 0.0)), coefficients(x * x + y * y + z * z))[0]).reshape(3, 3)

    def geometry(self) -> Geometry:
        sizes = tuple(0.5 * edge for edge in self.size)
        return Geometry(sizes, min(sizes), (("box", self.size),))


@register_shape
class Capsule(Directed):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along `axis`."""

    type: Literal["capsule"] = "capsule"
    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis without the caps [m]")
    distance = from_box

    def geometry(self) -> Geometry:
        return Geometry((0.0, 0.0, 0.5 * self.length, self.radius), self.radius, (("capsule", (self.radius, self.length)),))


@register_shape
class Cylinder(Directed):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    type: Literal["cylinder"] = "cylinder"
    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis [m]")
    distance = from_cylinder

    def geometry(self) -> Geometry:
        sizes = self.radius, math.inf, 0.5 * self.length, 0.0
        return Geometry(sizes, min(sizes[0], sizes[2]), (("cylinder", (self.radius, self.length)),))
