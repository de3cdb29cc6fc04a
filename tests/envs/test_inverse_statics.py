"""The observation group `inverse_statics`: tendon lengths at which the model holds the target pose with the least effort."""

import numpy as np
import pytest

from soft_tendon_env.envs import ReachEnv, ShapeEnv, TipPoseEnv, TipPoseVectorEnv
from soft_tendon_env.envs.courses import InverseStatics
from soft_tendon_env.model.inverse_statics import tension_for_tip_pose
from soft_tendon_env.tools.configuration import ConfigurationError

PAPER = {"scene": "paper", "fidelity": "fast"}
GROUPS = ["tip_position", "tendon_lengths", "target_error", "inverse_statics", "command"]


def lengths(env, observation):
    """Those of inverse statics [m], less those at rest."""
    slices, unit = env.episodes.layout.slices, 0.1 * env.episodes.model.length
    return unit * (observation[slices["inverse_statics"]] + observation[slices["tendon_lengths"]])


@pytest.mark.parametrize("fraction", [0.25, 0.6])
def test_the_arm_that_has_these_lengths_has_the_target_pose(fraction):
    """A pose alone: of ten tensions that hold it, those of least effort are found, and their tendons' lengths are what is observed."""
    tension = np.random.default_rng(1).uniform(0.0, 60.0 * fraction, 10)
    env = TipPoseEnv(**PAPER, observation=GROUPS, target={"type": "hold", "tension": tension.tolist()})
    observation, _ = env.reset(seed=0)
    for _ in range(10):
        observation, *_ = env.step(np.full(10, -0.9))
    model, pose = env.episodes.model, env.episodes.target_pose[0]
    found = InverseStatics(model, env.episodes.limits, 0.02, 1)
    q = found.coordinates(0, np.tile(pose, (11, 1, 1)))[-1]
    np.testing.assert_allclose(model.tip_pose(q), pose, atol=2e-3)
    np.testing.assert_allclose(model.tendon_lengths(q) - env.episodes._rest_values.tendon_length, lengths(env, observation), atol=1e-6)
    least = tension_for_tip_pose(model, pose).tension
    assert np.linalg.norm(q[:10]) <= 1.02 * np.linalg.norm(least) < np.linalg.norm(tension)


@pytest.mark.parametrize("target", ["random", "steps", "circle", "out_of_reach", "hold"])
def test_of_every_target(target):
    """Finite, and the same for one row and for many, whatever their targets and their beginnings."""
    options = {**PAPER, "observation": GROUPS, "target": target}
    envs, env = TipPoseVectorEnv(num_envs=2, max_episode_steps=7, **options), TipPoseEnv(**options)
    rows, one = envs.reset(seed=[3, 5])[0], env.reset(seed=5)[0]
    for _ in range(6):
        np.testing.assert_array_equal(rows[1], one)
        assert np.isfinite(rows).all() and np.abs(lengths(env, one)).max() < 0.5
        rows, one = envs.step(np.zeros((2, 10)))[0], env.step(np.zeros(10))[0]


def test_follows_a_moving_target():
    """One Gauss-Newton step per control period is enough."""
    env = TipPoseEnv(**PAPER, observation=GROUPS, target={"type": "random", "fraction": 0.5})
    env.reset(seed=2)
    model, times = env.episodes.model, 0.02 * np.arange(100)
    poses = env.episodes.target_at(0, times).tip_pose
    q = InverseStatics(model, env.episodes.limits, 0.02, 1).coordinates(0, poses)
    off = [np.linalg.norm(model.tip_pose(at)[:3, 3] - pose[:3, 3]) for at, pose in zip(q[1:], poses[1:], strict=True)]
    assert max(off) < 2e-3  # of a length of 1 m


@pytest.mark.parametrize(("env", "lack"), [(ShapeEnv, "target_lengths"), (ReachEnv, "command")])
def test_is_of_target_poses_alone(env, lack):
    """Shapes have lengths of their own, and positions are given as goals."""
    with pytest.raises(ConfigurationError, match=f"'inverse_statics'.*{lack}"):
        env(**PAPER, observation=["tip_position", "inverse_statics"])
