"""SE(3) for controllers: logarithms, exponentials and adjoints of poses (4, 4) and twists (6,),
angular before linear; interpolation."""

import numpy as np

from soft_tendon_env.mechanics.motion.pose_errors import move_poses, pose_errors
from soft_tendon_env.tools.types import Array


def pose_error(pose: Array, wanted: Array) -> Array:
    """log(g^-1 g_bar) (6,), the twist that carries pose g (4, 4) to the wanted pose g_bar (4, 4) in
    unit time."""
    out = np.empty((1, 1, 6))
    pose_errors(np.ascontiguousarray(pose)[None], np.ascontiguousarray(wanted)[None, None], out)
    return np.asarray(out[0, 0])


def moved_pose(pose: Array, twist: Array) -> Array:
    """g exp(x) (4, 4) of a pose g (4, 4) and a twist x (6,)."""
    out = np.empty((1, 1, 4, 4))
    move_poses(np.ascontiguousarray(pose)[None], np.ascontiguousarray(twist)[None, None], out)
    return np.asarray(out[0, 0])


def inverse_pose(pose: Array) -> Array:
    """g^-1 (4, 4)."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return out


def adjoint(pose: Array) -> Array:
    """Ad_g (6, 6)."""
    R, out = pose[:3, :3], np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    out[3:, :3] = skew(pose[:3, 3]) @ R
    return out


def adjoint_of_twist(twist: Array) -> Array:
    """ad_xi (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = skew(twist[:3])
    out[3:, :3] = skew(twist[3:])
    return out


def skew(x: Array) -> Array:
    """x~ (3, 3) with x~ y = x × y."""
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def pose_at(ahead: Array, poses: Array, time: float) -> Array:
    """The pose (4, 4) at a time ahead [s] of poses (m, 4, 4) at `ahead` (m,): along the screw
    between two, the last for ever."""
    after = int(np.searchsorted(ahead, time - 1e-9))
    if after == 0 or after == ahead.size:
        return np.asarray(poses[min(after, ahead.size - 1)])
    share = (time - ahead[after - 1]) / (ahead[after] - ahead[after - 1])
    if share > 1.0 - 1e-9:
        return np.asarray(poses[after])
    return moved_pose(poses[after - 1], share * pose_error(poses[after - 1], poses[after]))


def value_at(ahead: Array, values: Array, time: float) -> Array:
    """The vector (k,) at a time ahead [s] of vectors (m, k) at `ahead` (m,): linear between two,
    the last for ever."""
    return np.array([np.interp(time, ahead, column) for column in values.T])
