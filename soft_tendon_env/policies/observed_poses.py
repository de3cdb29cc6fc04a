"""Poses of tips and of their targets, out of observations."""

import numpy as np

from soft_tendon_env.mechanics.motion.pose_errors import move_poses
from soft_tendon_env.tools.types import Array


def tip_poses(values: dict[str, Array]) -> Array:
    """Measured poses (rows, 4, 4).

    The rotation's columns are made orthonormal again after their rounding.
    """
    x_rounded, y_rounded = np.split(values["tip_rotation"], 2, axis=1)
    x = _unit(x_rounded)
    along = (x * y_rounded).sum(axis=1, keepdims=True)
    y = _unit(y_rounded - along * x)
    z = np.cross(x, y)
    rotation = np.stack([x, y, z], axis=2)
    shape = (len(x), 1, 1)
    pose = np.tile(np.eye(4), shape)
    pose[:, :3, :3] = rotation
    pose[:, :3, 3] = values["tip_position"]
    return pose


def _unit(vectors: Array) -> Array:
    """Vectors (rows, 3) of length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def target_poses(values: dict[str, Array], poses: Array) -> Array | None:
    """Target poses (rows, 1 + previews, 4, 4), or None where the observation has none."""
    if "target_error" not in values:
        return None
    rows = len(poses)
    preview = values.get("preview", np.empty((rows, 0)))
    entries = np.concatenate([values["target_error"], preview], axis=1)
    errors = entries.reshape(rows, -1, 6)
    targets = np.empty((*errors.shape[:2], 4, 4))
    move_poses(poses, errors, targets)
    return targets
