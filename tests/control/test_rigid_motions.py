"""Rigid motions as matrices: errors undo moves, adjoints conjugate, ad is the bracket."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env.control.rigid_motions import adjoint, adjoint_of_twist, moved_pose, pose_error, skew

SEEDS = range(5)


def hat(twist):
    """x^ (4, 4) of a twist (6,)."""
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = skew(twist[:3]), twist[3:]
    return out


def vee(matrix):
    """The twist (6,) of x^ (4, 4)."""
    return np.array([matrix[2, 1], matrix[0, 2], matrix[1, 0], *matrix[:3, 3]])


@pytest.fixture
def pose():
    """pose(seed): a random one."""

    def make(seed):
        rng, out = np.random.default_rng(seed), np.eye(4)
        out[:3, :3], out[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
        return out

    return make


@pytest.fixture
def twists():
    """twists(seed): two random ones that turn by less than pi."""
    return lambda seed: np.random.default_rng(100 + seed).uniform(-1.5, 1.5, (2, 6))


@pytest.mark.no_jit
@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.1, 1.0])
def test_errors_undo_moves(pose, twists, size):
    for seed in SEEDS:
        g, x = pose(seed), size * twists(seed)[0]
        np.testing.assert_allclose(pose_error(g, moved_pose(g, x)), x, rtol=1e-12, atol=1e-14)


def test_adjoints_conjugate_twists_and_ad_is_the_bracket(pose, twists):
    for seed in SEEDS:
        g, (x, y) = pose(seed), twists(seed)
        np.testing.assert_allclose(adjoint(g) @ x, vee(g @ hat(x) @ np.linalg.inv(g)), atol=1e-13)
        np.testing.assert_allclose(adjoint_of_twist(x) @ y, vee(hat(x) @ hat(y) - hat(y) @ hat(x)), atol=1e-14)
