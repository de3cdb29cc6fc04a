"""Rigid motions as matrices: errors undo moves, adjoints conjugate, ad is the bracket; trajectories
between their instants."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from soft_tendon_env.control.rigid_motions import (
    adjoint,
    adjoint_of_twist,
    inverse_pose,
    moved_pose,
    pose_at,
    pose_error,
    skew,
    value_at,
)

AHEAD = np.array([0.0, 0.02, 0.1])
SEEDS = range(3)


def hat(twist):
    """x^ (4, 4) of a twist (6,), written out."""
    a, b, c, x, y, z = twist
    return np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]], dtype=float)


def random_pose(seed):
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(rng=rng).as_matrix()
    pose[:3, 3] = rng.normal(size=3)
    return pose


def random_twists(seed):
    """Two that turn by less than half a turn."""
    rng = np.random.default_rng(100 + seed)
    return rng.uniform(-1.5, 1.5, (2, 6))


@pytest.fixture(scope="module")
def poses():
    """Three random ones (3, 4, 4), less than half a turn apart."""
    rng = np.random.default_rng(0)
    path = [random_pose(0)]
    for _ in range(2):
        path.append(moved_pose(path[-1], rng.uniform(-1.0, 1.0, 6)))
    return np.stack(path)


@pytest.mark.parametrize("seed", SEEDS)
def test_moves_are_exponentials_on_the_right_and_errors_undo_them(seed):
    pose = random_pose(seed)
    twist, _ = random_twists(seed)
    moved = moved_pose(pose, twist)
    expected_moved = pose @ expm(hat(twist))
    np.testing.assert_allclose(moved, expected_moved, atol=1e-13)
    np.testing.assert_allclose(pose_error(pose, moved), twist, rtol=1e-12, atol=1e-14)


def test_poses_that_are_not_contiguous_are_taken():
    pose = random_pose(0)
    target = random_pose(1)
    transposed = pose_error(np.asfortranarray(pose), np.asfortranarray(target))
    expected_transposed = pose_error(pose, target)
    np.testing.assert_array_equal(transposed, expected_transposed)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_inverse_pose_is_the_inverse_matrix(seed):
    pose = random_pose(seed)
    np.testing.assert_allclose(inverse_pose(pose) @ pose, np.eye(4), atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_adjoint_conjugates(seed):
    """(Ad_g x)^ = g x^ g^-1."""
    pose = random_pose(seed)
    twist, _ = random_twists(seed)
    conjugate = pose @ hat(twist) @ np.linalg.inv(pose)
    np.testing.assert_allclose(hat(adjoint(pose) @ twist), conjugate, atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_adjoint_of_a_twist_is_the_bracket(seed):
    """(ad_x y)^ = x^ y^ - y^ x^."""
    x, y = random_twists(seed)
    bracket = hat(x) @ hat(y) - hat(y) @ hat(x)
    np.testing.assert_allclose(hat(adjoint_of_twist(x) @ y), bracket, atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_skew_matrix_is_the_cross_product(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, 3))
    np.testing.assert_allclose(skew(x) @ y, np.cross(x, y), atol=1e-14)


def test_poses_are_exact_at_their_instants_and_held_beyond(poses):
    for time, pose in zip(AHEAD, poses, strict=True):
        for near in (time, time + 1e-12, time - 1e-12):
            pose_near = pose_at(AHEAD, poses, near)
            np.testing.assert_array_equal(pose_near, pose)
    before = pose_at(AHEAD, poses, -1.0)
    np.testing.assert_array_equal(before, poses[0])
    for time in (0.11, 1e3):
        beyond = pose_at(AHEAD, poses, time)
        np.testing.assert_array_equal(beyond, poses[-1])
        still = pose_at(np.zeros(1), poses[:1], time)
        np.testing.assert_array_equal(still, poses[0])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("share", [1e-3, 0.25, 0.5, 0.999])
def test_poses_move_along_the_screw_between_instants(poses, first, share):
    """Evenly: the error from the first grows in proportion to time."""
    start, end = poses[first : first + 2]
    time = (1.0 - share) * AHEAD[first] + share * AHEAD[first + 1]
    way = pose_error(start, pose_at(AHEAD, poses, time))
    expected_way = share * pose_error(start, end)
    np.testing.assert_allclose(way, expected_way, atol=1e-12)


def test_values_are_linear_between_instants_and_held_beyond():
    values = np.array([[0.0, 5.0], [1.0, 3.0], [-3.0, 3.0]])
    for time, value in zip(AHEAD, values, strict=True):
        value_there = value_at(AHEAD, values, time)
        np.testing.assert_array_equal(value_there, value)
    # three quarters of the first way, and a quarter of the second
    on_first_way = value_at(AHEAD, values, 0.015)
    np.testing.assert_allclose(on_first_way, [0.75, 3.5])
    on_second_way = value_at(AHEAD, values, 0.04)
    np.testing.assert_allclose(on_second_way, [0.0, 3.0], atol=1e-15)
    beyond = value_at(AHEAD, values, 7.0)
    np.testing.assert_array_equal(beyond, values[-1])
    still = value_at(np.zeros(1), values[:1], 0.3)
    np.testing.assert_array_equal(still, values[0])
