"""The body of a drawn arm, places of several arms, and the camera that sees them all."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.drawing.renderer import box_corners, mount_size, view_box, viewpoint
from soft_tendon_env.model.model import Model
from soft_tendon_env.scene.scene import rod_radius
from soft_tendon_env.tools.types import Array

SPACING, VISITED = 0.65, 0.5
"""Distance at which several arms are drawn, in widths of the box that most motions need, and the share of it that views show whole."""
ELEVATION, FIELD_OF_VIEW = 28.0, np.radians(55.0)
"""Of the viewer's camera: elevation [deg], by which a tip's path looks about as it does in frames, and vertical field of view."""
LABEL = 2.5
"""Depth of an arm's name behind its base, in depths of the mount."""
PULLS = -1.0, 0.0, 0.12, 0.4, 1.0
PULL_COLORS = np.array([[160, 90, 255], [105, 108, 118], [255, 225, 90], [255, 150, 40], [255, 40, 30]])
"""RGB at these shares of the largest tension that the actuator gives, from pushing over slack to pulling; as frames have them."""


class Body(NamedTuple):
    """Cylinders from station to station, axis along their z: all that a tapered rod needs to be seen."""

    length: Array  # (m - 1,) [m], unstrained
    radius: Array  # (m - 1,) [m]
    center: Array  # (samples, m - 1, 3) [m]
    quaternion: Array  # (samples, m - 1, 4), x y z w


class Camera(NamedTuple):
    """A perspective camera."""

    position: Array  # (3,) [m]
    target: Array  # (3,) [m], seen in the middle
    up: Array  # (3,)


def body(model: Model, arc_length: Array, position: Array) -> Body:
    """The body at stations (m,) [m] whose positions are (samples, m, 3) [m]."""
    radius, _ = rod_radius(model.scene, 0.5 * (arc_length[1:] + arc_length[:-1]))
    center = 0.5 * (position[:, 1:] + position[:, :-1])
    return Body(np.diff(arc_length), radius, center, rotation_from_z(np.diff(position, axis=1)))


def rotation_from_z(direction: Array) -> Array:
    """Quaternions (..., 4), x y z w, of the shortest rotations that take z to these directions (..., 3) of any length."""
    x, y, z = np.moveaxis(direction, -1, 0)
    quaternion = np.stack([-y, x, np.zeros_like(x), np.sqrt(x**2 + y**2 + z**2) + z], axis=-1)
    size = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    half_turn = np.array([1.0, 0.0, 0.0, 0.0])  # to -z any half turn across z is as short
    return np.where(size > 0.0, quaternion / np.where(size > 0.0, size, 1.0), half_turn)


def side_by_side(model: Model, number: int) -> tuple[float, float, float]:
    """The place [m] of the arm of this number, 0, 1, ..., among several of a kind: in a row from left to right, as the viewer opens."""
    lower, upper, vertical, upright = view_box(model.scene)
    right = viewpoint(vertical, upright)[0]
    x, y, z = (SPACING * number * float(np.abs(right) @ (upper - lower)) * right).tolist()
    return x, y, z


def label_place(model: Model) -> Array:
    """Place (3,) [m] of the name of an arm at the origin: behind its mount."""
    return np.array([-LABEL * mount_size(model.scene)[0], 0.0, 0.0])


def camera(models: Sequence[Model], places: Array, aspect: float) -> Camera:
    """The camera that sees arms at places (arms, 3) [m] and their names whole, in a view of this width over height."""
    *_, vertical, upright = view_box(models[0].scene)
    turn = viewpoint(vertical, upright, ELEVATION)
    seen = np.concatenate([_visited(model) + place for model, place in zip(models, places, strict=True)]) @ turn.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    slope = np.tan(0.5 * FIELD_OF_VIEW) * np.array([aspect, 1.0])
    distance = (np.abs(seen[:, :2] - middle[:2]) / slope + (seen[:, 2:] - middle[2])).max()
    return Camera((middle + [0.0, 0.0, distance]) @ turn, middle @ turn, np.eye(3)[vertical] * (1.0 if upright else -1.0))


def _visited(model: Model) -> Array:
    """Corners (9, 3) [m] of what an arm at the origin moves in, and the place of its name."""
    lower, upper, *_ = view_box(model.scene)
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower) * [1.0, VISITED, VISITED]
    return np.concatenate([box_corners(middle - half, middle + half), label_place(model)[None]])


def tension_colors(model: Model, tension: Array) -> NDArray[np.uint32]:
    """0xRRGGBBAA (samples, n_a) for tensions (samples, n_a) [N], by their share of the largest that each actuator gives."""
    largest = np.abs([tendon.tension_limits for tendon in model.scene.tendons]).max(axis=1)
    red, green, blue = (np.interp(tension / largest, PULLS, channel).astype(np.uint32) for channel in PULL_COLORS.T)
    return red << 24 | green << 16 | blue << 8 | np.uint32(255)
