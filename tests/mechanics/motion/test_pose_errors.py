"""Errors between poses against the matrix logarithm, moves and noise against the matrix exponential."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from soft_tendon_env.mechanics.motion.pose_errors import pose_errors


def matrix(twist):
    (kx, ky, kz), p = twist[:3], twist[3:]
    return np.array([[0.0, -kz, ky, p[0]], [kz, 0.0, -kx, p[1]], [-ky, kx, 0.0, p[2]], [0.0, 0.0, 0.0, 0.0]])


def random_poses(rng, count):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.random(count, rng).as_matrix(), rng.normal(size=(count, 3))
    return poses


def errors(pose, wanted):
    out = np.empty((*wanted.shape[:2], 6))
    pose_errors(pose, wanted, out)
    return out


@pytest.mark.no_jit
def test_errors_are_matrix_logarithms():
    rng = np.random.default_rng(0)
    pose, wanted = random_poses(rng, 5), random_poses(rng, 15).reshape(5, 3, 4, 4)
    for g, row, found in zip(pose, wanted, errors(pose, wanted), strict=True):
        for g_bar, twist in zip(row, found, strict=True):
            np.testing.assert_allclose(matrix(twist), np.real(logm(np.linalg.solve(g, g_bar))), atol=1e-10)


@pytest.mark.no_jit
@pytest.mark.cases("angle", [0.0, 1e-12, 1e-8, 1e-4, 1.0, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi])
def test_errors_carry_the_pose_to_the_wanted_one_at_every_angle(angle):
    rng = np.random.default_rng(1)
    pose, axes = random_poses(rng, 20), rng.normal(size=(20, 3))
    axes[:3] = np.eye(3)
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    step = np.tile(np.eye(4), (20, 1, 1))
    step[:, :3, :3], step[:, :3, 3] = Rotation.from_rotvec(angle * axes).as_matrix(), rng.normal(size=(20, 3))
    found = errors(pose, (pose @ step)[:, None])[:, 0]
    np.testing.assert_allclose(np.linalg.norm(found[:, :3], axis=1), angle, atol=1e-7 if angle > 3 else 1e-15 + 1e-14)
    for g, g_bar, twist in zip(pose, pose @ step, found, strict=True):
        np.testing.assert_allclose(g @ expm(matrix(twist)), g_bar, atol=1e-10)
