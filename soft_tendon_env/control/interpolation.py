"""Interpolation of reference trajectories in time: poses along screw motions, vectors linearly."""

import numpy as np

from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.tools.types import Array


def pose_at(ahead: Array, poses: Array, time: float) -> Array:
    """The pose (4, 4) at a time ahead [s] of poses (m, 4, 4) at `ahead` (m,): along the screw between two, the last for ever."""
    after = int(np.searchsorted(ahead, time - 1e-9))
    if after == 0 or after == ahead.size:
        return np.asarray(poses[min(after, ahead.size - 1)])
    share = (time - ahead[after - 1]) / (ahead[after] - ahead[after - 1])
    if share > 1.0 - 1e-9:
        return np.asarray(poses[after])
    return moved_pose(poses[after - 1], share * pose_error(poses[after - 1], poses[after]))


def value_at(ahead: Array, values: Array, time: float) -> Array:
    """The vector (k,) at a time ahead [s] of vectors (m, k) at `ahead` (m,): linear between two, the last for ever."""
    return np.array([np.interp(time, ahead, column) for column in values.T])
