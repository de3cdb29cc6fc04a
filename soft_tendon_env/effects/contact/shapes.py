"""Shapes of obstacles: plane, sphere, capsule, cylinder and box."""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array
from soft_tendon_env.effects.contact.obstacle import Directed, Geometry, Obstacle, register_shape
from soft_tendon_env.mechanics.algebra.lie import coefficients, dot, exp_se3, times
from soft_tendon_env.tools.types import Length, Triple


@register_shape
class Plane(Directed):
    """Half-space below the plane through `position` with outward normal `axis`."""

    type: Literal["plane"] = "plane"

    def geometry(self) -> Geometry:
        return Geometry((), math.inf, (("plane", ()),))

    @staticmethod
    @kernel(inline=True)
    def distance(sizes, x):
        """Height above the plane."""
        return x[2], (0.0, 0.0, 1.0)


@kernel(inline=True)
def distance_from_sides(a, b, c):
    """Signed distance of a point that is a, b, c beyond three sides at right angles, from the solid within them; its gradient."""
    if a > 0.0 or b > 0.0 or c > 0.0:
        out = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        size = math.sqrt(dot(out, out))
        return size, times(1.0 / size, out)
    if a >= b and a >= c:
        return a, (1.0, 0.0, 0.0)
    return (b, (0.0, 1.0, 0.0)) if b >= c else (c, (0.0, 0.0, 1.0))


@register_shape
class Box(Obstacle):
    """Box about `position` with edges of `size` (x, y, z) [m], turned by `rotation` (x, y, z): angle [deg] times axis."""

    type: Literal["box"] = "box"
    size: tuple[Length, Length, Length] = Field(description="edges along the axes of its frame [m]")
    rotation: Triple = Field((0.0, 0.0, 0.0), description="rotation vector of its frame [deg]")

    @property
    def orientation(self) -> Array:
        x, y, z = np.radians(self.rotation).tolist()
        return np.array(exp_se3(((x, y, z), (0.0, 0.0, 0.0)), coefficients(x * x + y * y + z * z))[0]).reshape(3, 3)

    def geometry(self) -> Geometry:
        sizes = tuple(0.5 * edge for edge in self.size)
        return Geometry(sizes, min(sizes), (("box", self.size),))

    @staticmethod
    @kernel(inline=True)
    def distance(sizes, x):
        """Distance from the box of half sizes (a, b, c) with edges rounded outwards by a radius, `sizes`."""
        away, n = distance_from_sides(abs(x[0]) - sizes[0], abs(x[1]) - sizes[1], abs(x[2]) - sizes[2])
        return away - sizes[3], (math.copysign(n[0], x[0]), math.copysign(n[1], x[1]), math.copysign(n[2], x[2]))


@register_shape
class Sphere(Obstacle):
    """Sphere of a `radius` [m] about `position`."""

    type: Literal["sphere"] = "sphere"
    radius: Length = Field(description="radius [m]")
    distance = Box.distance

    def geometry(self) -> Geometry:
        return Geometry((0.0, 0.0, 0.0, self.radius), self.radius, (("sphere", (self.radius,)),))


class Round(Directed):
    """Base of the solids of revolution about `position`."""

    radius: Length = Field(description="radius [m]")
    length: Length = Field(description="length along the axis [m], that of a capsule without its caps")


@register_shape
class Capsule(Round):
    """Capsule about `position`: points up to `radius` [m] from a line of this `length` [m] along `axis`."""

    type: Literal["capsule"] = "capsule"
    distance = Box.distance

    def geometry(self) -> Geometry:
        return Geometry((0.0, 0.0, 0.5 * self.length, self.radius), self.radius, (("capsule", (self.radius, self.length)),))


@register_shape
class Cylinder(Round):
    """Cylinder about `position` with flat ends, of a `radius` and a `length` [m] along `axis`."""

    type: Literal["cylinder"] = "cylinder"

    def geometry(self) -> Geometry:
        return Geometry((self.radius, 0.5 * self.length), min(self.radius, 0.5 * self.length), (("cylinder", (self.radius, self.length)),))

    @staticmethod
    @kernel(inline=True)
    def distance(sizes, x):
        """Distance from mantle and ends."""
        size = math.sqrt(x[0] * x[0] + x[1] * x[1])
        out_x, out_y = (x[0] / size, x[1] / size) if size > 0.0 else (1.0, 0.0)
        away, n = distance_from_sides(size - sizes[0], abs(x[2]) - sizes[1], -math.inf)
        return away, (out_x * n[0], out_y * n[0], math.copysign(n[1], x[2]))
