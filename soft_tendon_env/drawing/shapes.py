"""Curves, bodies and obstacles of arms in space, for pictures and recordings.

It says where several arms stand, and has the cameras that see them.
"""

import functools
import itertools
import math

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.effects.contact.obstacles import Obstacle, read_distances
from soft_tendon_env.mechanics.motion.batch import read_backbones
from soft_tendon_env.mechanics.terms.external_forces import place_base
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.arm import make_arm
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import Scene, rod_length, rod_radius, tendon_ends, tendon_offset
from soft_tendon_env.tools.types import Array

FINENESS = 12  # quadrilaterals along a side of the boxes from which surfaces are made
BEHIND = 0.1  # depth of the mount behind the rod's base, in lengths of the rod
LABEL = 2.5  # depth of an arm's name behind its base, in depths of the mount
LEAST_RADIUS = 0.03  # of the mount, in lengths of the rod
RADIUS_OF_MOUNT = 1.9  # in radii of the rod at its base

# box around the arm, in lengths of the rod: a rod of constant curvature goes 0.59 of them aside
# when bent by 80 degrees, and 0.72 at most
ASIDE = 0.60
AHEAD = 1.05
HANGING = (0.0, AHEAD, AHEAD)  # where the tip of an arm hangs whose base is across gravity

FROM = 15.0  # [deg] above the floor, of the direction from which frames see an arm
AZIMUTH = -58.0  # [deg] around the vertical, of frames and of the viewer's camera
ELEVATION = 28.0  # [deg] above the floor, of the viewer's camera: tips' paths look as in frames
FIELD_OF_VIEW = math.radians(55.0)  # [rad] of the viewer's camera, from top to bottom
SPACING = 0.65  # distance of several arms, in widths of the box that most motions need
VISITED = 0.5  # share of that box's width in which arms mostly are

PULLS = (-1.0, 0.0, 0.12, 0.4, 1.0)
"""Shares of the largest tension that the actuator gives, from pushing over slack to pulling."""
PULL_COLORS = np.array(
    [[160, 90, 255], [105, 108, 118], [255, 225, 90], [255, 150, 40], [255, 40, 30]]
)
"""Red, green and blue, 0 to 255, at these shares."""


def positions(pose: Array) -> Array:
    """Positions (..., 3) [m] of poses (..., 4, 4)."""
    return pose[..., :3, 3]


def drawing_stations(model: Model, count: int) -> Array:
    """About `count` arc lengths (m,) [m] from base to tip.

    The tendons' ends and the borders of segments are among them.
    """
    borders = model.grid.breakpoints
    length = borders[-1]
    shares = np.diff(borders) / length
    # a piece has at least one station, its start
    pieces_per_part = (count - 1) * shares
    pieces = np.ceil(pieces_per_part).astype(int)
    stations = []
    start = borders[0]
    for end, piece_count in zip(borders[1:], pieces, strict=True):
        piece = np.linspace(start, end, piece_count, endpoint=False)
        stations.append(piece)
        start = end
    tip = np.array([length])
    return np.concatenate([*stations, tip])


def base_poses(
    model: Model,
    times: Array,
    scene: Scene | None = None,
) -> Array:
    """Poses (m, 4, 4) of the arm's base in the world at times (m,) [s].

    The scene's effects move it; scene: with other numbers.
    """
    if scene is None:
        scene = model.scene
    shape = (times.size, 1, 1)
    poses = np.tile(scene.base.pose, shape)
    if not model.arm.effects.base.any():
        return poses
    arm = model.arm
    if scene != model.scene:
        arm = make_arm(scene, model.grid, model.arm.strain)
    base = np.zeros(24)
    rotation = base[:9].reshape(3, 3)
    position = base[9:12]
    for pose, time in zip(poses, times, strict=True):
        place_base(arm, time, base)
        pose[:3, :3] = rotation
        pose[:3, 3] = position
    return poses


def backbones(
    model: Model,
    strain: Array,
    arc_length: Array,
    base: Array | None = None,
) -> Array:
    """Poses (samples, m, 4, 4) of the sections at arc lengths (m,) [m].

    Strains are (samples, points, 6) as of Model.strain.

    base (samples, 4, 4): poses of the base, see `base_poses`; by default sections are seen from the
    base.
    """
    no_places = np.empty(0)
    places = model.grid.places(arc_length, no_places)
    packed_strain = model.grid.packed(strain)
    kinematics = make_workspace(model.arm).kinematics
    shape = (len(strain), arc_length.size, 1, 1)
    out = np.tile(np.eye(4), shape)
    read_backbones(model.arm, places, packed_strain, kinematics, out)
    if base is None:
        return out
    return base[:, None] @ out


def tendon_curves(
    model: Model,
    backbone: Array,
    arc_length: Array,
) -> list[Array]:
    """Curves of the tendons: for each its points (samples, m_i, 3) [m].

    They are at those of the arc lengths (m,) between its ends; backbone (samples, m, 4, 4).
    """
    curves = []
    for tendon in model.scene.tendons:
        start, end = tendon_ends(model.scene, tendon)
        inside = (arc_length >= start) & (arc_length <= end)
        offset, _ = tendon_offset(model.scene, tendon, arc_length[inside])
        pose = backbone[:, inside]
        # the section lies across the x axis of its pose
        y_axis = pose[..., :3, 1]
        z_axis = pose[..., :3, 2]
        along_y = y_axis * offset[:, :1]
        along_z = z_axis * offset[:, 1:]
        curve = positions(pose) + along_y + along_z
        curves.append(curve)
    return curves


def surface(
    obstacle: Obstacle,
    time: float,
    box: tuple[Array, Array],
) -> Array:
    """Quadrilaterals (n, 4, 3) [m] of an obstacle's surface at a time [s].

    They are seen counterclockwise from outside; of an endless one they are the part in a view's
    box.
    """
    pose = obstacle.pose(time)
    rotation = pose[:3, :3]
    position = pose[:3, 3]
    if not obstacle.is_endless:
        at_origin = _surface_at_origin(obstacle.kind, obstacle.sizes())
        turned = at_origin @ rotation.T
        return np.asarray(turned + position)
    lower, upper = box
    middle = 0.5 * (lower + upper)
    largest = np.max(upper - lower)
    extent = float(largest)
    half_width = 0.5 * extent
    part = half_width * _square() @ rotation.T
    normal = rotation[:, 2]
    # of the box's middle above the plane
    height = float(normal @ (middle - position))
    below_middle = middle - normal * height
    return np.asarray(part + below_middle)


def obstacles_of(effects: Effects) -> tuple[Obstacle, ...]:
    """Obstacles of a scene's effects."""
    if effects.contact is None:
        return ()
    return tuple(effects.contact.obstacles)


def _square() -> Array:
    """Square from (-1, -1, 0) to (1, 1, 0) in small pieces, counterclockwise from above."""
    side = np.linspace(-1.0, 1.0, FINENESS + 1)
    x, y = np.meshgrid(side, side, indexing="ij")
    z = np.zeros_like(x)
    coordinates = [x, y, z]
    grid = np.stack(coordinates, axis=-1)
    # the corners of each piece, from its least x and y counterclockwise
    left = grid[:-1]
    right = grid[1:]
    corners = [
        left[:, :-1],
        right[:, :-1],
        right[:, 1:],
        left[:, 1:],
    ]
    pieces = np.stack(corners, axis=2)
    return pieces.reshape(-1, 4, 3)


@functools.cache
def _surface_at_origin(kind: float, sizes: tuple[float, ...]) -> Array:
    """Surface in the obstacle's frame.

    It is that of the box around it, every corner moved to the nearest point of the obstacle.
    """
    square = _square()
    above = square + [0.0, 0.0, 1.0]
    below = square - [0.0, 0.0, 1.0]
    seen_from_below = below[:, ::-1]
    cube = []
    for face in (above, seen_from_below):
        for axis in range(3):
            side = np.roll(face, axis, axis=-1)
            cube.append(side)
    half_sizes = np.array(sizes[:3])
    edge_radius = sizes[3]
    edge_sizes = half_sizes + edge_radius
    box = np.concatenate(cube) * edge_sizes
    # the obstacle's row, at rest at the origin
    motion = np.zeros(5)
    position = np.zeros(3)
    rotation = np.eye(3).ravel()
    velocity = np.zeros(6)
    row = np.concatenate([[kind], motion, sizes, position, rotation, velocity])
    points = box.reshape(-1, 3)
    shape = (1, len(points), 3)
    nearest = np.empty(shape)
    distances = np.empty((1, len(points)))
    read_distances(row[None], points, 0.0, distances, nearest)
    return nearest.reshape(box.shape)


def view_box(scene: Scene) -> tuple[Array, Array, int, bool]:
    """Lower and upper corner (3,) [m], the vertical axis, and whether its values grow upwards.

    Up is the world axis nearest to against gravity, or to the straight rod. The box holds what most
    motions need; what leaves it is drawn as well.
    """
    length = rod_length(scene)
    base = scene.base.pose
    rotation = base[:3, :3]
    gravity = np.zeros(3)
    if scene.effects.gravity is not None:
        gravity = np.array(scene.effects.gravity.acceleration)
    strength = float(np.linalg.norm(gravity))
    down = -base[:3, 0]
    hanging = np.zeros(3)
    if strength > 0.0:
        down = gravity
        # in the frame of the base, where the tip of a limp arm hangs
        direction = gravity @ rotation / strength
        scaled = np.array(HANGING) * length
        hanging = scaled * direction
    # the box in the frame of the base
    backwards = [-BEHIND, -ASIDE, -ASIDE]
    behind = np.array(backwards)
    ahead = np.array([AHEAD, ASIDE, ASIDE])
    lower = np.minimum(behind * length, hanging)
    upper = np.maximum(ahead * length, hanging)
    # its corners in the world
    corners = corners_of_box(lower, upper) @ rotation.T
    corners += base[:3, 3]
    sizes = np.abs(down)
    vertical = int(np.argmax(sizes))
    is_upright = bool(down[vertical] <= 0.0)
    lowest = corners.min(axis=0)
    highest = corners.max(axis=0)
    return lowest, highest, vertical, is_upright


def corners_of_box(lower: Array, upper: Array) -> Array:
    """Corners (8, 3) of a box along the axes."""
    ends_by_axis = zip(lower, upper, strict=True)
    corners = list(itertools.product(*ends_by_axis))
    return np.array(corners)


def viewpoint(
    vertical: int,
    upright: bool,
    elevation: float = FROM,
) -> Array:
    """Rotation (3, 3) of the camera of frames and recordings in the world frame.

    Its rows are to the right, up and towards the viewer as seen.

    `vertical` and `upright` as `view_box` has them; elevation [deg] above the floor.
    """
    sign = 1.0
    azimuth = AZIMUTH
    if not upright:
        # from below, and from the other side, so that the same axis stays to the right
        sign = -1.0
        azimuth = 180.0 - AZIMUTH
    height = np.radians(elevation)
    around = np.radians(azimuth)
    # towards the viewer, with the vertical axis last, then in its place
    level = np.cos(height)
    x = level * np.cos(around)
    y = level * np.sin(around)
    z = sign * np.sin(height)
    direction = [x, y, z]
    towards = np.roll(direction, vertical - 2)
    axis = np.eye(3)[vertical]
    against_gravity = sign * axis
    right = np.cross(against_gravity, towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    return np.stack([right, up, towards])


def mount_size(scene: Scene) -> tuple[float, float]:
    """Depth behind the rod's base and radius [m] of the cylinder that holds it."""
    length = rod_length(scene)
    radii, _ = rod_radius(scene, np.zeros(1))
    of_rod = RADIUS_OF_MOUNT * float(radii[0])
    least = LEAST_RADIUS * length
    depth = BEHIND * length
    return depth, max(of_rod, least)


def cylinders(position: Array) -> tuple[Array, Array]:
    """Centres (samples, m - 1, 3) [m] and quaternions, x y z w, of cylinders along z.

    They go from station to station (samples, m, 3).
    """
    start = position[:, :-1]
    end = position[:, 1:]
    centre = 0.5 * (end + start)
    quaternion = rotation_from_z(end - start)
    return centre, quaternion


def rotation_from_z(direction: Array) -> Array:
    """Quaternions (..., 4), x y z w, of the shortest rotations that take z to directions.

    The directions (..., 3) are of any length.
    """
    # the cross product of z and the direction, then its length and their inner product: a
    # quaternion of half the angle between them
    x, y, z = np.moveaxis(direction, -1, 0)
    in_plane = x**2 + y**2
    squares = in_plane + z**2
    length = np.sqrt(squares)
    about_z = np.zeros_like(x)
    components = [-y, x, about_z, length + z]
    quaternion = np.stack(components, axis=-1)
    size = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    is_unique = size > 0.0
    # to -z any half turn across z is as short
    half_turn = np.array([1.0, 0.0, 0.0, 0.0])
    divisor = np.where(is_unique, size, 1.0)
    return np.where(is_unique, quaternion / divisor, half_turn)


def side_by_side(model: Model, number: int) -> tuple[float, float, float]:
    """Returns the place of an arm among several of a kind in the viewer.

    They stand in a row from left to right, as the viewer opens.

    Args:
        model: of one of the arms.
        number: of the arm, 0, 1, ...

    Returns:
        Place (x, y, z) [m].
    """
    lower, upper, vertical, upright = view_box(model.scene)
    right = viewpoint(vertical, upright)[0]
    # of the box as it is seen
    extent = upper - lower
    sizes = np.abs(right)
    width = float(sizes @ extent)
    distance = SPACING * number * width
    x, y, z = (distance * right).tolist()
    return x, y, z


def label_place(model: Model) -> Array:
    """Place (3,) [m] of the name of an arm: behind its mount."""
    base = model.scene.base.pose
    position = base[:3, 3]
    along_rod = base[:3, 0]
    depth, _ = mount_size(model.scene)
    behind = LABEL * depth * along_rod
    return np.asarray(position - behind)


def camera(
    model: Model,
    places: Array,
    aspect: float,
) -> tuple[Array, Array, Array]:
    """Position, target [m] and upward direction of the camera that sees arms whole.

    It sees arms at places (arms, 3) [m], and their names.

    aspect: width of the view over its height.
    """
    lower, upper, vertical, upright = view_box(model.scene)
    turn = viewpoint(vertical, upright, ELEVATION)
    # corners of the part of the box in which an arm mostly is, around each place
    rotation = model.scene.base.pose[:3, :3]
    axes_of_base = np.abs(rotation)
    shares = [1.0, VISITED, VISITED]
    share = np.minimum(axes_of_base @ shares, 1.0)
    middle_of_box = 0.5 * (lower + upper)
    half = 0.5 * (upper - lower) * share
    corners = corners_of_box(middle_of_box - half, middle_of_box + half)
    label = label_place(model)
    points = np.stack([*corners, label])
    arm_by_arm = [place + points for place in places]
    every_arm = np.concatenate(arm_by_arm)
    seen = every_arm @ turn.T
    lowest = seen.min(axis=0)
    highest = seen.max(axis=0)
    middle = 0.5 * (lowest + highest)
    # every point is within the field of view: the nearer, the farther the camera stands back
    slope = math.tan(0.5 * FIELD_OF_VIEW)
    aspects = np.array([aspect, 1.0])
    slopes = slope * aspects
    from_middle = seen - middle
    distances = np.abs(from_middle)
    aside = distances[:, :2]
    towards = from_middle[:, 2:]
    needed = aside / slopes + towards
    distance = needed.max()
    position = middle + [0.0, 0.0, distance]
    if upright:
        sign = 1.0
    else:
        sign = -1.0
    axis = np.eye(3)[vertical]
    upward = sign * axis
    return position @ turn, middle @ turn, upward


def tension_colors(model: Model, tension: Array) -> Array:
    """Red, green and blue, 0 to 255, (.., n_a, 3) for tensions (.., n_a) [N].

    They go by their share of the largest that each actuator gives.
    """
    tension_limits = [tendon.tension_limits for tendon in model.scene.tendons]
    limits = np.abs(tension_limits)
    largest = limits.max(axis=1)
    share = tension / largest
    channels = []
    for channel in PULL_COLORS.T:
        pulled = np.interp(share, PULLS, channel)
        channels.append(pulled)
    return np.stack(channels, axis=-1)
