"""Rewards in PyTorch: the environment's own, and what has no gradients is refused by name."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from soft_tendon_env import register
from soft_tendon_env.differentiable import TensorReward, rollout
from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast", "action": "increment"}
ROWS = 3


def rows_of(task, **options):
    return gym.make_vec(
        IDS[task], num_envs=ROWS, max_episode_steps=None, threads=1, **{**SMALL, **options}
    )


def played(envs, actions):
    """Trajectories of given actions (periods, rows, n_a) from a reset on."""
    envs.reset(seed=3)
    periods = iter(actions)
    return rollout(envs, lambda observation: next(periods), len(actions))


def drawn_actions(periods):
    rng = np.random.default_rng(0)
    return torch.tensor(rng.uniform(-1.0, 1.0, (periods, ROWS, 3)))


@pytest.mark.parametrize("task", ["TipPose", "Shape"])
def test_rewards_of_an_episode_are_those_of_the_environment(task, everything):
    """Also where commands are late, actuators are wrong and the tip is too fast."""
    envs = rows_of(task, randomize=everything, tip_speed_limit=0.05)
    trajectories = played(envs, drawn_actions(12))
    assert trajectories.diverged.any()
    assert not trajectories.diverged.all()
    reward = TensorReward(episodes_of(envs))(trajectories)
    np.testing.assert_allclose(reward, trajectories.reward, rtol=0.0, atol=1e-14)


def test_gradients_of_rewards_are_those_of_differences():
    envs = rows_of("TipPose")
    reward = TensorReward(episodes_of(envs))
    actions = drawn_actions(4)
    leading = actions.clone().requires_grad_(True)
    reward(played(envs, leading)).sum().backward()

    def total(step):
        changed = actions.clone()
        changed[1, 2, 0] += step
        return float(played(envs, changed).reward.sum())

    step = 1e-4
    difference = (total(step) - total(-step)) / (2.0 * step)
    assert float(leading.grad[1, 2, 0]) == pytest.approx(difference, rel=1e-2)


def test_rewards_without_gradients_are_refused_by_name(forgotten):
    register("reward_term", "calm", lambda tracking: 0.5 + 0.0 * tracking.distance)
    of_user = rows_of("TipPose", reward={"calm": 1.0, "position": 1.0})
    with pytest.raises(ConfigurationError, match="has terms of calm, without gradients"):
        TensorReward(episodes_of(of_user))
    of_coordinates = rows_of("Shape", reward={"coordinates": 1.0})
    with pytest.raises(ConfigurationError, match="has terms of coordinate_error"):
        TensorReward(episodes_of(of_coordinates))
    with pytest.raises(ConfigurationError, match="of goals, of the task Reach"):
        TensorReward(episodes_of(rows_of("Reach")))
