"""Poses and coordinates of the tip and its target out of observations by group."""

import numpy as np

from soft_tendon_env.mechanics.motion.pose_errors import move_poses
from soft_tendon_env.tools.types import Array


def tip_poses(values: dict[str, Array]) -> Array:
    """Measured poses (rows, 4, 4), the rotation's columns made orthonormal again after their rounding."""
    x, y = np.split(values["tip_rotation"], 2, axis=1)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    y = y - (x * y).sum(axis=1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    pose = np.tile(np.eye(4), (len(x), 1, 1))
    pose[:, :3, :3] = np.stack([x, y, np.cross(x, y)], axis=2)
    pose[:, :3, 3] = values["tip_position"]
    return pose


def target_poses(values: dict[str, Array], poses: Array) -> Array | None:
    """Target poses (rows, 1 + previews, 4, 4), or None where the observation has none."""
    if "target_error" not in values:
        return None
    errors = np.concatenate([values["target_error"], values.get("preview", np.empty((len(poses), 0)))], axis=1)
    errors = np.ascontiguousarray(errors.reshape(len(poses), -1, 6))
    out = np.empty((*errors.shape[:2], 4, 4))
    move_poses(poses, errors, out)
    return out


def target_coordinates(own: dict[str, Array], samples: int) -> Array | None:
    """Coordinates (samples, n) of the target of one row now and at each preview time, or None where the observation has none."""
    if "wanted_coordinates" in own:
        return own["wanted_coordinates"].reshape(samples, -1)
    if "target_coordinates" not in own:
        return None
    ahead = own.get("coordinate_preview", np.empty(0)).reshape(-1, own["coordinates"].size)
    return own["coordinates"] + np.vstack([own["target_coordinates"], ahead])
