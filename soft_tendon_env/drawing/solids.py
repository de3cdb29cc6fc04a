"""Surfaces of simple solids as quadrilaterals, for frames, and what a plane shows of itself."""

import numpy as np

from soft_tendon_env.effects import Solid
from soft_tendon_env.tools.types import Array

AROUND, ALONG, FINENESS = 32, 8, 12
"""Quadrilaterals around a round solid, along a straight one, and along a side of a face."""


def plane_size(solid: Solid, box: tuple[Array, Array]) -> tuple[Array, float]:
    """Middle (3,) [m] and half of the side [m] of the part of a plane that is drawn, nearest to a box of corners (3,), and as large."""
    lower, upper = box
    middle, normal = 0.5 * (lower + upper), solid.pose[:3, 2]
    return middle - normal * float(normal @ (middle - solid.pose[:3, 3])), 0.5 * float(np.max(upper - lower))


def surface(solid: Solid, box: tuple[Array, Array]) -> Array:
    """Quadrilaterals (n, 4, 3) [m] of a solid's surface, seen counterclockwise from outside; of a plane the part in a view's box."""
    R, r = solid.pose[:3, :3], solid.pose[:3, 3]
    if solid.kind == "plane":
        r, half = plane_size(solid, box)
        return np.asarray(_face(half * np.eye(3)[0], half * np.eye(3)[1]) @ R.T + r)
    if solid.kind == "box":
        x, y, z = 0.5 * np.diag(solid.size)
        faces = [_face(a, b) + c for a, b, c in ((x, y, z), (y, z, x), (z, x, y))]
        faces += [_face(b, a) - c for a, b, c in ((x, y, z), (y, z, x), (z, x, y))]
        return np.asarray(np.concatenate(faces) @ R.T + r)
    return np.asarray(_turned(*_outline(solid)) @ R.T + r)


def _face(a: Array, b: Array) -> Array:
    """The parallelogram from -a - b to a + b in small pieces, whose normal is a x b."""
    steps = np.linspace(-1.0, 1.0, FINENESS + 1)
    grid = steps[:, None, None] * a + steps[None, :, None] * b
    return np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def _outline(solid: Solid) -> tuple[Array, Array]:
    """Radius and height (m,) [m] of a solid of revolution, from its lower end to its upper one."""
    radius, half = solid.size[0], 0.5 * solid.size[1] if len(solid.size) > 1 else 0.0
    if solid.kind == "cylinder":
        side = np.linspace(-half, half, ALONG + 1)
        rim = np.linspace(0.0, radius, 4)
        height = np.concatenate([np.full(4, -half), side[1:-1], np.full(4, half)])
        return np.concatenate([rim, np.full(side.size - 2, radius), rim[::-1]]), height
    angle = np.linspace(-0.5 * np.pi, 0.0, FINENESS)
    below, side = -half + radius * np.sin(angle), np.linspace(-half, half, ALONG + 1)[1:-1] if half else np.empty(0)
    radii = radius * np.cos(angle)
    return np.concatenate([radii, np.full(side.size, radius), radii[::-1]]), np.concatenate([below, side, -below[::-1]])


def _turned(radius: Array, height: Array) -> Array:
    """The surface of revolution around z."""
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    x, y = np.cos(angle)[None, :] * radius[:, None], np.sin(angle)[None, :] * radius[:, None]
    grid = np.stack([x, y, np.broadcast_to(height[:, None], x.shape)], axis=-1)
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 3)
