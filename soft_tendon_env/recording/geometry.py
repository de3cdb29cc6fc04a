"""What is drawn of an arm: where along it, the pieces of its body, the colours of its tendons."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.model import Model
from soft_tendon_env.scene import Array, rod_radius

PULL_COLORS = np.array([[60, 110, 255], [125, 125, 135], [255, 205, 40], [255, 45, 30]])
"""RGB at -1 (pushes), 0, 1/2 and 1 of the largest tension that the actuator gives."""


class Body(NamedTuple):
    """Cylinders from station to station, axis along their z: all that a tapered rod needs to be seen."""

    length: Array  # (m - 1,) [m], unstrained
    radius: Array  # (m - 1,) [m]
    center: Array  # (samples, m - 1, 3) [m]
    quaternion: Array  # (samples, m - 1, 4), x y z w


def body(model: Model, arc_length: Array, position: Array) -> Body:
    """The body at stations (m,) [m] whose positions are (samples, m, 3) [m]."""
    middle = 0.5 * (arc_length[1:] + arc_length[:-1])
    return Body(
        np.diff(arc_length),
        rod_radius(model.scene, middle)[0],
        0.5 * (position[:, 1:] + position[:, :-1]),
        rotation_from_z(np.diff(position, axis=1)),
    )


def rotation_from_z(direction: Array) -> Array:
    """Quaternions (..., 4), x y z w, of the shortest rotations that take z to these directions (..., 3) of any length."""
    x, y, z = np.moveaxis(direction, -1, 0)
    quaternion = np.stack([-y, x, np.zeros_like(x), np.sqrt(x**2 + y**2 + z**2) + z], axis=-1)
    size = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    half_turn = np.array([1.0, 0.0, 0.0, 0.0])  # to -z any half turn across z is as short
    return np.where(size > 0.0, quaternion / np.where(size > 0.0, size, 1.0), half_turn)


def tension_colors(model: Model, tension: Array) -> NDArray[np.uint32]:
    """0xRRGGBBAA (samples, n_a) for tensions (samples, n_a) [N], by their share of the largest that each actuator gives."""
    largest = np.abs([tendon.tension_limits for tendon in model.scene.tendons]).max(axis=1)
    red, green, blue = (np.interp(tension / largest, [-1.0, 0.0, 0.5, 1.0], channel).astype(np.uint32) for channel in PULL_COLORS.T)
    return red << 24 | green << 16 | blue << 8 | np.uint32(255)


def upwards(model: Model) -> Array:
    """The direction (3,) against gravity; z where there is none."""
    gravity = model.scene.effects.gravity
    down = np.zeros(3) if gravity is None else np.array(gravity.acceleration)
    size = np.linalg.norm(down)
    return -down / size if size > 0 else np.array([0.0, 0.0, 1.0])
