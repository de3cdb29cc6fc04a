"""Errors between poses against the matrix logarithm, moves and noise against the matrix exponential."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from soft_tendon_env.mechanics.motion.pose_errors import move_poses, perturb_poses, pose_errors


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


def moved(pose, twist):
    out = np.empty((*twist.shape[:2], 4, 4))
    move_poses(pose, twist, out)
    return out


@pytest.mark.no_jit
def test_moves_are_matrix_exponentials():
    rng = np.random.default_rng(3)
    pose, twist = random_poses(rng, 5), rng.normal(size=(5, 3, 6))
    twist[0, 0], twist[0, 1, :3], twist[0, 2] = 0.0, 0.0, 1e-9
    for g, row, found in zip(pose, twist, moved(pose, twist), strict=True):
        for x, g_bar in zip(row, found, strict=True):
            np.testing.assert_allclose(g_bar, g @ expm(matrix(x)), atol=1e-13)
    np.testing.assert_array_equal(moved(pose, twist)[0, 0], pose[0])


@pytest.mark.no_jit
def test_no_moves_give_no_poses():
    assert moved(random_poses(np.random.default_rng(5), 3), np.empty((3, 0, 6))).shape == (3, 0, 4, 4)


@pytest.mark.no_jit
def test_noise_turns_a_pose_about_its_own_axes_and_moves_it_along_the_world_s():
    rng = np.random.default_rng(2)
    pose, rotation, translation = random_poses(rng, 6), rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    rotation[0], rotation[1] = 0.0, 1e-9
    out = np.empty_like(pose)
    perturb_poses(pose, rotation, translation, out)
    np.testing.assert_allclose(out[:, :3, :3], pose[:, :3, :3] @ Rotation.from_rotvec(rotation).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(out[:, :3, 3], pose[:, :3, 3] + translation)
    np.testing.assert_array_equal(out[:, 3], pose[:, 3])
    np.testing.assert_array_equal(out[0, :3, :3], pose[0, :3, :3])
