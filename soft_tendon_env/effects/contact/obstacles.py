"""Obstacles: what every shape has, the shapes of the package, and the table by which scenes name them.

A shape is one class under `@register_shape`, here or in a user's own file: its keys, its `geometry`, and the kernel `distance`, which gives
the signed distance and its gradient in the obstacle's frame. Kernels of the package are compiled into what calls them; others are called
at their addresses, so that nothing else is compiled for them.
"""

import math
import zlib
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic
from pydantic import BeforeValidator, Field, SerializeAsAny, field_validator

from soft_tendon_env.compiler.compilation import OPTIONS, Kernel, address_of, emit_call_at, kernel
from soft_tendon_env.effects.base import Array, Solid
from soft_tendon_env.mechanics.algebra.lie import coefficients, dot, exp_se3, times
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, shown
from soft_tendon_env.tools.types import LEAST, Frequency, Length, NotNegative, Number, Triple

MOST_SIZES = 4
NUMBERS = 2**20
"""Numbers of shapes: the first are those of `OF_PACKAGE`, the others come from names."""


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
def from_sides(a, b, c):
    """Signed distance of a point that is a, b, c beyond three sides at right angles, from the solid within them; its gradient."""
    if a > 0.0 or b > 0.0 or c > 0.0:
        out = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        size = math.sqrt(dot(out, out))
        return size, times(1.0 / size, out)
    if a >= b and a >= c:
        return a, (1.0, 0.0, 0.0)
    return (b, (0.0, 1.0, 0.0)) if b >= c else (c, (0.0, 0.0, 1.0))


@kernel(inline=True)
def from_box(sizes, x):
    """Distance from the box of half sizes (a, b, c) with edges rounded outwards by a radius, `sizes`: from spheres and capsules too."""
    away, n = from_sides(abs(x[0]) - sizes[0], abs(x[1]) - sizes[1], abs(x[2]) - sizes[2])
    return away - sizes[3], (math.copysign(n[0], x[0]), math.copysign(n[1], x[1]), math.copysign(n[2], x[2]))


@kernel(inline=True)
def from_cylinder(sizes, x):
    """Distance from the mantle of a radius and the ends at a half length, `sizes`."""
    size = math.sqrt(x[0] * x[0] + x[1] * x[1])
    out_x, out_y = (x[0] / size, x[1] / size) if size > 0.0 else (1.0, 0.0)
    away, n = from_sides(size - sizes[0], abs(x[2]) - sizes[1], -math.inf)
    return away, (out_x * n[0], out_y * n[0], math.copysign(n[1], x[2]))


OF_PACKAGE = above_plane, from_box, from_cylinder
_OTHERS: dict[int, Any] = {}  # entries of other kernels by number, which keep their machine code
_ADDRESSES = np.zeros(NUMBERS, dtype=np.int64)  # of those entries, by number
_KINDS = types.UniTuple(types.float64, MOST_SIZES), types.UniTuple(types.float64, 3)


@intrinsic
def _call_at(typingctx, number, sizes, x):
    returned, word = types.Tuple((types.float64, _KINDS[1])), ir.IntType(64)

    def emit(context, builder, signature, given):
        addresses = builder.inttoptr(word(_ADDRESSES.ctypes.data), word.as_pointer())
        address = builder.load(builder.gep(addresses, [builder.fptosi(given[0], word)]))
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, address)):
            context.call_conv.return_user_exc(builder, RuntimeError, ("the module with the shape of an obstacle has not been imported",))
        return emit_call_at(context, builder, address, returned, _KINDS, given[1:])

    return returned(number, sizes, x), emit


def other_distance(number, sizes, x):
    """Distance and gradient by the kernel of a shape that is not among the package's."""
    return _call_at(number, sizes, x)


def _interpreted(number, sizes, x):
    return _OTHERS[int(number)](sizes, x)


# its machine code is not kept: it knows where this process has the addresses
other_distance = _interpreted if config.DISABLE_JIT else Kernel(other_distance, OPTIONS, keep=False).call


@kernel(inline=True)
def distance(body, x):
    """Signed distance [m] from a body's surface to x in its frame, negative inside, and its gradient: outwards, of length 1."""
    if body.shape == 0.0:
        return above_plane(body.sizes, x)
    if body.shape == 1.0:
        return from_box(body.sizes, x)
    return from_cylinder(body.sizes, x) if body.shape == 2.0 else other_distance(body.shape, body.sizes, x)


class Obstacle(Configuration):
    """Base of the shapes: a rigid solid, fixed or moving without turning.

    Attributes:
        distance: kernel (sizes, x) of the signed distance [m] from the surface to x (3) in the obstacle's frame, negative inside, and its
            gradient: outwards, of length 1. sizes are those of its geometry, and zeros up to MOST_SIZES.
    """

    distance: ClassVar[Any]
    number: ClassVar[int]

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
        numbers = [float(self.number), shape.thickness, own, dissipation, *swing, *sizes]
        return [*numbers, *self.position, *self.orientation.ravel().tolist(), *self.velocity, *self.amplitude]


Class = TypeVar("Class", bound=type[Obstacle])

SHAPES: dict[str, type[Obstacle]] = {}
"""Every registered shape by its name."""


def register_shape(shape: Class) -> Class:
    """Class decorator: make an `Obstacle` with a field such as `type: Literal["torus"] = "torus"` available to scenes by that name.

    Registering a class of the same module and name again replaces it. Raises ValueError for a name that is taken.
    """
    (name,) = get_args(shape.__pydantic_fields__["type"].annotation)
    present = next((other for known, other in SHAPES.items() if _number(known) == _number(name)), shape)
    if (present.__module__, present.__qualname__) != (shape.__module__, shape.__qualname__):
        raise ValueError(f"the shape {name!r} is registered twice: {present.__module__}, {shape.__module__}")
    if shape.distance in OF_PACKAGE:
        shape.number = OF_PACKAGE.index(shape.distance)
    else:
        shape.number = _number(name)
        _place(shape.distance, shape.number)
    SHAPES[name] = shape
    return shape


def _number(name: str) -> int:
    """Number of a shape: the same in every process."""
    return len(OF_PACKAGE) + zlib.crc32(name.encode()) % (NUMBERS - len(OF_PACKAGE))


def _place(function: Any, number: int) -> None:
    """Have `other_distance` call a kernel for this number."""

    def enter(sizes, x):
        away, n = function(sizes, x)
        return float(away), (float(n[0]), float(n[1]), float(n[2]))

    _OTHERS[number] = enter if config.DISABLE_JIT else Kernel(enter, OPTIONS, keep=False)
    if not config.DISABLE_JIT:
        _ADDRESSES[number] = address_of(_OTHERS[number].compiled(_KINDS))


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


class Round(Directed):
    """Base of the solids of revolution about `position`."""

    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis [m], that of a capsule without its caps")


@register_shape
class Capsule(Round):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along `axis`."""

    type: Literal["capsule"] = "capsule"
    distance = from_box

    def geometry(self) -> Geometry:
        return Geometry((0.0, 0.0, 0.5 * self.length, self.radius), self.radius, (("capsule", (self.radius, self.length)),))


@register_shape
class Cylinder(Round):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    type: Literal["cylinder"] = "cylinder"
    distance = from_cylinder

    def geometry(self) -> Geometry:
        return Geometry((self.radius, 0.5 * self.length), min(self.radius, 0.5 * self.length), (("cylinder", (self.radius, self.length)),))
