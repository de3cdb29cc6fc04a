"""Backbone and tendon curves of an arm in space, and surfaces of simple solids as quadrilaterals, for pictures and recordings."""

import numpy as np

from soft_tendon_env.effects import Effects, Solid
from soft_tendon_env.mechanics.motion.batch import read_backbones
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.coordinates import effects_outside
from soft_tendon_env.model.grid import discretisation
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import tendon_ends, tendon_offset
from soft_tendon_env.tools.types import Array

AROUND, ALONG, FINENESS = 32, 8, 12
"""Quadrilaterals around a round solid, along a straight one, and along a side of a face."""


def drawing_stations(model: Model, count: int) -> Array:
    """About `count` arc lengths (m,) [m] from base to tip, the tendons' ends and the borders of segments among them."""
    borders = model.grid.breakpoints
    pieces = np.ceil((count - 1) * np.diff(borders) / borders[-1]).astype(int)
    inner = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(borders[:-1], borders[1:], pieces, strict=True)]
    return np.concatenate([*inner, borders[-1:]])


def base_poses(model: Model, times: Array, effects: Effects | None = None) -> Array:
    """Poses (m, 4, 4) of the arm's base at times (m,) [s], as the scene's effects move it, or others in their place."""
    poses, table = np.tile(np.eye(4), (times.size, 1, 1)), model.arm.effects
    if not table.base.any():
        return poses
    if effects is not None:
        scene = model.scene.model_copy(update={"effects": effects})
        table = effects_outside(scene).table(discretisation(scene, model.grid))
    arm, work = model.arm.replaced(effects=table), make_workspace(model.arm)
    for pose, time in zip(poses, times, strict=True):
        work.clock[0] = time
        place_base(arm, work)
        pose[:3, :3], pose[:3, 3] = work.base[:9].reshape(3, 3), work.base[9:12]
    return poses


def backbones(model: Model, strain: Array, arc_length: Array, base: Array | None = None) -> Array:
    """Poses (samples, m, 4, 4) of the sections at arc lengths (m,) [m], of strains (samples, points, 6) as of Model.strain.

    base (samples, 4, 4): poses of the base, see `base_poses`; by default it stands at the world's origin.
    """
    places = model.grid.places(arc_length, np.empty(0))
    out = np.tile(np.eye(4), (len(strain), arc_length.size, 1, 1))
    read_backbones(model.arm, places, model.grid.packed(strain), make_workspace(model.arm), out)
    return out if base is None else base[:, None] @ out


def tendon_curves(model: Model, backbone: Array, arc_length: Array) -> list[Array]:
    """For each tendon its points (samples, m_i, 3) [m] at those of the arc lengths (m,) between its ends; backbone (samples, m, 4, 4)."""
    curves = []
    for tendon in model.scene.tendons:
        start, end = tendon_ends(model.scene, tendon)
        inside = (arc_length >= start) & (arc_length <= end)
        offset, _ = tendon_offset(model.scene, tendon, arc_length[inside])
        pose = backbone[:, inside]
        curves.append(pose[..., :3, 3] + pose[..., :3, 1] * offset[:, :1] + pose[..., :3, 2] * offset[:, 1:])
    return curves


def surface(solid: Solid, box: tuple[Array, Array]) -> Array:
    """Quadrilaterals (n, 4, 3) [m] of a solid's surface, seen counterclockwise from outside; of a plane the part in a view's box."""
    R, r = solid.pose[:3, :3], solid.pose[:3, 3]
    if solid.kind == "plane":
        lower, upper = box
        middle, half = 0.5 * (lower + upper), 0.5 * float(np.max(upper - lower))
        nearest = middle - R[:, 2] * float(R[:, 2] @ (middle - r))
        return np.asarray(_face(half * np.eye(3)[0], half * np.eye(3)[1]) @ R.T + nearest)
    if solid.kind == "box":
        x, y, z = 0.5 * np.diag(solid.size)
        faces = [own for a, b, c in ((x, y, z), (y, z, x), (z, x, y)) for own in (_face(a, b) + c, _face(b, a) - c)]
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
    angle, side = np.linspace(-0.5 * np.pi, 0.0, FINENESS), np.linspace(-half, half, ALONG + 1)[1:-1] if half else np.empty(0)
    radii, below = radius * np.cos(angle), -half + radius * np.sin(angle)
    if solid.kind == "cylinder":
        radii, below = np.linspace(0.0, radius, 4), np.full(4, -half)
    return np.concatenate([radii, np.full(side.size, radius), radii[::-1]]), np.concatenate([below, side, -below[::-1]])


def _turned(radius: Array, height: Array) -> Array:
    """The surface of revolution around z."""
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    x, y = np.cos(angle)[None, :] * radius[:, None], np.sin(angle)[None, :] * radius[:, None]
    grid = np.stack([x, y, np.broadcast_to(height[:, None], x.shape)], axis=-1)
    return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(-1, 4, 3)
