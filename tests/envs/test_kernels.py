"""Kernels of the environments: targets in tables and the pose errors to them; observations scaled, clipped and cast, against NumPy."""

import numpy as np
import pytest

from soft_tendon_env.envs.kernels import scale_and_clip
from soft_tendon_env.mechanics.motion.pose_errors import move_poses


def random_poses(rng, *shape):
    poses = np.empty((1, int(np.prod(shape)), 4, 4))
    move_poses(np.eye(4)[None], rng.normal(size=(*poses.shape[:2], 6)), poses)
    return poses.reshape(*shape, 4, 4)


@pytest.mark.no_jit
def test_values_are_scaled_then_clipped_then_cast():
    rng = np.random.default_rng(0)
    values = 10.0 ** rng.uniform(-3, 3, (7, 5)) * rng.choice([-1.0, 1.0], (7, 5))
    scale, bound = rng.uniform(0.1, 9.0, 5), rng.uniform(1, 9, 5)
    values[0], values[1, 1], values[2] = [np.inf, -np.inf, np.nan, 0.0, -0.0], np.nan, bound / scale
    found = np.empty((7, 5), dtype=np.float32)
    scale_and_clip(values, scale, bound, found)
    np.testing.assert_array_equal(found, np.clip(values * scale, -bound, bound).astype(np.float32))
    assert np.isnan(found[0, 2]) and np.isnan(found[1, 1]) and np.isfinite(found).sum() == found.size - 2
    assert (np.abs(values * scale) > bound).any() and (np.abs(values * scale) < bound).any()
