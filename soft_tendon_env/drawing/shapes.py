"""Curves, bodies and obstacles of arms in space, where several arms stand, and the cameras that see
them, for pictures and recordings."""

import functools
import itertools
import math

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.effects.contact.obstacles import Obstacle, read_distances
from soft_tendon_env.mechanics.motion.batch import read_backbones
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.coordinates import make_arm
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene, rod_length, rod_radius, tendon_ends, tendon_offset
from soft_tendon_env.tools.types import Array

FINENESS = 12  # quadrilaterals along a side of the boxes from which surfaces are made
BEHIND = 0.1  # depth of the mount behind the rod's base, in lengths of the rod
FROM, AZIMUTH = (
    15.0,
    -58.0,
)  # direction from which an arm is seen [deg]: above the floor, and around the vertical
PULLS = -1.0, 0.0, 0.12, 0.4, 1.0
PULL_COLORS = np.array(
    [[160, 90, 255], [105, 108, 118], [255, 225, 90], [255, 150, 40], [255, 40, 30]]
)
"""RGB at these shares of the largest tension that the actuator gives, from pushing over slack to
pulling."""
SPACING = (
    0.65  # distance at which several arms are drawn, in widths of the box that most motions need
)
VISITED = 0.5  # share of that box's width in which arms mostly are
ELEVATION, FIELD_OF_VIEW = (
    28.0,
    math.radians(55.0),
)  # [deg], [rad] of the viewer's camera: tips' paths look about as in frames
LABEL = 2.5  # depth of an arm's name behind its base, in depths of the mount


def drawing_stations(model: Model, count: int) -> Array:
    """About `count` arc lengths (m,) [m] from base to tip, the tendons' ends and the borders of
    segments among them."""
    borders = model.grid.breakpoints
    pieces = np.ceil((count - 1) * np.diff(borders) / borders[-1]).astype(int)
    inner = [
        np.linspace(a, b, k, endpoint=False)
        for a, b, k in zip(borders[:-1], borders[1:], pieces, strict=True)
    ]
    return np.concatenate([*inner, borders[-1:]])


def base_poses(model: Model, times: Array, scene: Scene | None = None) -> Array:
    """Poses (m, 4, 4) of the arm's base in the world at times (m,) [s], as its scene's effects move
    it; scene: with other numbers."""
    scene = scene or model.scene
    poses = np.tile(scene.base.pose, (times.size, 1, 1))
    if not model.arm.effects.base.any():
        return poses
    arm = model.arm if scene == model.scene else make_arm(scene, model.grid, model.arm.strain)
    base = np.zeros(24)
    for pose, time in zip(poses, times, strict=True):
        place_base(arm, time, base)
        pose[:3, :3], pose[:3, 3] = base[:9].reshape(3, 3), base[9:12]
    return poses


def backbones(model: Model, strain: Array, arc_length: Array, base: Array | None = None) -> Array:
    """Poses (samples, m, 4, 4) of the sections at arc lengths (m,) [m], of strains (samples,
    points, 6) as of Model.strain.

    base (samples, 4, 4): poses of the base, see `base_poses`; by default sections are seen from the
    base.
    """
    places = model.grid.places(arc_length, np.empty(0))
    out = np.tile(np.eye(4), (len(strain), arc_length.size, 1, 1))
    kinematics = make_workspace(model.arm).kinematics
    read_backbones(model.arm, places, model.grid.packed(strain), kinematics, out)
    return out if base is None else base[:, None] @ out


def tendon_curves(model: Model, backbone: Array, arc_length: Array) -> list[Array]:
    """For each tendon its points (samples, m_i, 3) [m] at those of the arc lengths (m,) between its
    ends; backbone (samples, m, 4, 4)."""
    curves = []
    for tendon in model.scene.tendons:
        start, end = tendon_ends(model.scene, tendon)
        inside = (arc_length >= start) & (arc_length <= end)
        offset, _ = tendon_offset(model.scene, tendon, arc_length[inside])
        pose = backbone[:, inside]
        curves.append(
            pose[..., :3, 3] + pose[..., :3, 1] * offset[:, :1] + pose[..., :3, 2] * offset[:, 1:]
        )
    return curves


def surface(obstacle: Obstacle, time: float, box: tuple[Array, Array]) -> Array:
    """Quadrilaterals (n, 4, 3) [m] of an obstacle's surface at a time [s], seen counterclockwise
    from outside; of an endless one the part in a view's box."""
    pose = obstacle.pose(time)
    R, r = pose[:3, :3], pose[:3, 3]
    if not obstacle.is_endless:
        return np.asarray(_surface_at_origin(obstacle.kind, obstacle.sizes()) @ R.T + r)
    lower, upper = box
    middle, half = 0.5 * (lower + upper), 0.5 * float(np.max(upper - lower))
    return np.asarray(half * _square() @ R.T + middle - R[:, 2] * float(R[:, 2] @ (middle - r)))


def obstacles_of(effects: Effects) -> tuple[Obstacle, ...]:
    """Obstacles of a scene's effects."""
    return () if effects.contact is None else tuple(effects.contact.obstacles)


def _square() -> Array:
    """The square from (-1, -1, 0) to (1, 1, 0) in small pieces, seen counterclockwise from
    above."""
    side = np.linspace(-1.0, 1.0, FINENESS + 1)
    grid = np.stack(
        [*np.meshgrid(side, side, indexing="ij"), np.zeros((side.size, side.size))], axis=-1
    )
    return np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2).reshape(
        -1, 4, 3
    )


@functools.cache
def _surface_at_origin(kind: float, sizes: tuple[float, ...]) -> Array:
    """The surface in the obstacle's frame: that of the box around it, every corner moved to the
    nearest point of the obstacle."""
    faces = _square() + [0.0, 0.0, 1.0], _square()[:, ::-1] - [0.0, 0.0, 1.0]
    box = np.concatenate([np.roll(face, k, axis=-1) for face in faces for k in range(3)]) * (
        np.array(sizes[:3]) + sizes[3]
    )
    row = np.concatenate([[kind], np.zeros(5), sizes, np.zeros(3), np.eye(3).ravel(), np.zeros(6)])
    corners = np.empty((1, 4 * len(box), 3))
    read_distances(row[None], box.reshape(-1, 3), 0.0, np.empty(corners.shape[:2]), corners)
    return corners.reshape(box.shape)


def view_box(scene: Scene) -> tuple[Array, Array, int, bool]:
    """Lower and upper corner (3,) [m], the vertical axis, and whether its values grow upwards.

    Up is the world axis nearest to against gravity, or to the straight rod. The box holds what most
    motions need: a rod of constant curvature goes 0.59 lengths aside when bent by 80 degrees, and
    0.72 at most. What leaves the box is drawn as well.
    """
    gravity = (
        np.zeros(3)
        if scene.effects.gravity is None
        else np.array(scene.effects.gravity.acceleration)
    )
    length, pull, base = rod_length(scene), float(np.linalg.norm(gravity)), scene.base.pose
    hanging = (
        np.array([0.0, 1.05, 1.05]) * length * (gravity @ base[:3, :3]) / pull
        if pull > 0.0
        else np.zeros(3)
    )
    lower = np.minimum(np.array([-BEHIND, -0.60, -0.60]) * length, hanging)
    upper = np.maximum(np.array([1.05, 0.60, 0.60]) * length, hanging)
    corners = corners_of_box(lower, upper) @ base[:3, :3].T + base[:3, 3]
    down = gravity if pull > 0.0 else -base[:3, 0]
    axis = int(np.argmax(np.abs(down)))
    return corners.min(axis=0), corners.max(axis=0), axis, bool(down[axis] <= 0.0)


def corners_of_box(lower: Array, upper: Array) -> Array:
    """Corners (8, 3) of a box along the axes."""
    return np.array([*itertools.product(*zip(lower, upper, strict=True))])


def viewpoint(vertical: int, upright: bool, elevation: float = FROM) -> Array:
    """Rotation (3, 3) of the camera of frames and recordings in the world frame: rows to the right,
    up and towards the viewer as seen.

    `vertical` and `upright` as `view_box` has them; elevation [deg] above the floor.
    """
    elevation, azimuth = np.radians(elevation), np.radians(AZIMUTH if upright else 180.0 - AZIMUTH)
    sign = 1.0 if upright else -1.0
    level = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    towards = np.roll([*level, sign * np.sin(elevation)], vertical - 2)
    right = np.cross(sign * np.eye(3)[vertical], towards)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(towards, right), towards])


def mount_size(scene: Scene) -> tuple[float, float]:
    """Depth behind the rod's base and radius [m] of the cylinder that holds it."""
    length = rod_length(scene)
    return BEHIND * length, max(1.9 * float(rod_radius(scene, np.zeros(1))[0][0]), 0.03 * length)


def cylinders(position: Array) -> tuple[Array, Array]:
    """Centres (samples, m - 1, 3) [m] and quaternions, x y z w, of cylinders along z that go from
    station to station (samples, m, 3)."""
    return 0.5 * (position[:, 1:] + position[:, :-1]), rotation_from_z(np.diff(position, axis=1))


def rotation_from_z(direction: Array) -> Array:
    """Quaternions (..., 4), x y z w, of the shortest rotations that take z to these directions
    (..., 3) of any length."""
    x, y, z = np.moveaxis(direction, -1, 0)
    quaternion = np.stack([-y, x, np.zeros_like(x), np.sqrt(x**2 + y**2 + z**2) + z], axis=-1)
    size = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    half_turn = np.array([1.0, 0.0, 0.0, 0.0])  # to -z any half turn across z is as short
    return np.where(size > 0.0, quaternion / np.where(size > 0.0, size, 1.0), half_turn)


def side_by_side(model: Model, number: int) -> tuple[float, float, float]:
    """The place [m] of the arm of this number, 0, 1, ..., among several of a kind: in a row from
    left to right, as the viewer opens."""
    lower, upper, vertical, upright = view_box(model.scene)
    right = viewpoint(vertical, upright)[0]
    x, y, z = (SPACING * number * float(np.abs(right) @ (upper - lower)) * right).tolist()
    return x, y, z


def label_place(model: Model) -> Array:
    """Place (3,) [m] of the name of an arm: behind its mount."""
    base = model.scene.base.pose
    return np.asarray(base[:3, 3] - LABEL * mount_size(model.scene)[0] * base[:3, 0])


def camera(model: Model, places: Array, aspect: float) -> tuple[Array, Array, Array]:
    """Position, target [m] and upward direction of the camera that sees arms at places (arms, 3)
    [m] and their names whole.

    aspect: width of the view over its height.
    """
    lower, upper, vertical, upright = view_box(model.scene)
    turn = viewpoint(vertical, upright, ELEVATION)
    share = np.minimum(np.abs(model.scene.base.pose[:3, :3]) @ [1.0, VISITED, VISITED], 1.0)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower) * share
    corners = corners_of_box(middle - half, middle + half)
    seen = np.concatenate([place + [*corners, label_place(model)] for place in places]) @ turn.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    slope = math.tan(0.5 * FIELD_OF_VIEW) * np.array([aspect, 1.0])
    distance = (np.abs(seen[:, :2] - middle[:2]) / slope + (seen[:, 2:] - middle[2])).max()
    return (
        (middle + [0.0, 0.0, distance]) @ turn,
        middle @ turn,
        np.eye(3)[vertical] * (1.0 if upright else -1.0),
    )


def tension_colors(model: Model, tension: Array) -> Array:
    """Red, green and blue, 0 to 255, (.., n_a, 3) for tensions (.., n_a) [N], by their share of the
    largest that each actuator gives."""
    largest = np.abs([tendon.tension_limits for tendon in model.scene.tendons]).max(axis=1)
    return np.stack(
        [np.interp(tension / largest, PULLS, channel) for channel in PULL_COLORS.T], axis=-1
    )
