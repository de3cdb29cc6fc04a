"""SE(3) for controllers: logarithms, exponentials, adjoints and interpolation.

Poses are (4, 4) and twists (6,), angular before linear.
"""

import numpy as np

from soft_tendon_env.mechanics.motion.pose_errors import move_poses, pose_errors
from soft_tendon_env.tools.types import Array

SAME_TIME = 1e-9  # [s] by which a time may be beyond a pose's and still count as it
SAME_SHARE = 1e-9  # of the way between two poses


def pose_error(pose: Array, target: Array) -> Array:
    """Pose error log(g^-1 g_bar) (6,).

    It is the twist that carries pose g (4, 4) to the target pose g_bar (4, 4) in unit time.
    """
    poses = np.ascontiguousarray(pose)[None]
    targets = np.ascontiguousarray(target)[None, None]
    out = np.empty((1, 1, 6))
    pose_errors(poses, targets, out)
    return np.asarray(out[0, 0])


def moved_pose(pose: Array, twist: Array) -> Array:
    """Pose g exp(x) (4, 4) of a pose g (4, 4) and a twist x (6,)."""
    poses = np.ascontiguousarray(pose)[None]
    twists = np.ascontiguousarray(twist)[None, None]
    out = np.empty((1, 1, 4, 4))
    move_poses(poses, twists, out)
    return np.asarray(out[0, 0])


def inverse_pose(pose: Array) -> Array:
    """g^-1 (4, 4)."""
    transposed = pose[:3, :3].T
    out = np.eye(4)
    out[:3, :3] = transposed
    position = pose[:3, 3]
    out[:3, 3] = -transposed @ position
    return out


def adjoint(pose: Array) -> Array:
    """Ad_g (6, 6)."""
    R = pose[:3, :3]
    out = np.zeros((6, 6))
    out[:3, :3] = R
    out[3:, 3:] = R
    lever = skew(pose[:3, 3])
    out[3:, :3] = lever @ R
    return out


def adjoint_of_twist(twist: Array) -> Array:
    """ad_xi (6, 6)."""
    angular = skew(twist[:3])
    out = np.zeros((6, 6))
    out[:3, :3] = angular
    out[3:, 3:] = angular
    out[3:, :3] = skew(twist[3:])
    return out


def skew(x: Array) -> Array:
    """x~ (..., 3, 3) with x~ y = x × y, of vectors x (..., 3)."""
    out = np.zeros((*x.shape, 3))
    out[..., 2, 1] = x[..., 0]
    out[..., 0, 2] = x[..., 1]
    out[..., 1, 0] = x[..., 2]
    return out - np.swapaxes(out, -1, -2)


def pose_at(ahead: Array, poses: Array, time: float) -> Array:
    """Interpolated pose of a trajectory, along the screw between two poses.

    Args:
        ahead: (m,) [s] of the poses from now, increasing.
        poses: (m, 4, 4).
        time: ahead [s].

    Returns:
        The pose (4, 4); before the first and after the last of them that one.
    """
    after = int(np.searchsorted(ahead, time - SAME_TIME))
    if after == 0:
        return np.asarray(poses[0])
    if after == ahead.size:
        return np.asarray(poses[-1])
    before = after - 1
    between = ahead[after] - ahead[before]
    share = (time - ahead[before]) / between
    if share > 1.0 - SAME_SHARE:  # one of the poses itself, without round-off
        return np.asarray(poses[after])
    screw = pose_error(poses[before], poses[after])
    return moved_pose(poses[before], share * screw)


def value_at(ahead: Array, values: Array, time: float) -> Array:
    """Interpolated vector of a trajectory, linear between two.

    Args:
        ahead: (m,) [s] of the vectors from now, increasing.
        values: (m, k).
        time: ahead [s].

    Returns:
        The vector (k,); before the first and after the last of them that one.
    """
    components = values.T
    return np.array([np.interp(time, ahead, component) for component in components])
