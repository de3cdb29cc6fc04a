"""Exploration along the modes of the tip."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch.distributions import MultivariateNormal

from soft_tendon_env.envs import IDS
from soft_tendon_env.learning import config, train
from soft_tendon_env.learning.exploration import ModalGaussian, tip_modes
from soft_tendon_env.policies import agent
from soft_tendon_env.tools.configuration import ConfigurationError

SMALL = {"scene": "three_tendon", "fidelity": "fast"}
TABLE = {
    "task": "TipPose",
    "algorithm": "PPO",
    "steps": 256,
    "arms": 4,
    "seconds": 1.5,
    "hyperparameters": {"n_steps": 32, "batch_size": 64, "n_epochs": 2, "policy_kwargs": {"net_arch": [8], "log_std_init": -2.0}},
    "options": {**SMALL, "action": "increment"},
    "evaluation": {"every": 256, "episodes": 2},
    "exploration": "tip_modes",
}


def episodes(**options):
    return gym.make(IDS["TipPose"], **{**SMALL, **options}).unwrapped.episodes


@pytest.mark.parametrize("action", ["tension", "increment"])
def test_modes_of_three_tendons_bend_two_ways_and_pull_together(action):
    modes = tip_modes(episodes(action=action))
    np.testing.assert_allclose(modes.direction.T @ modes.direction, np.eye(3), atol=1e-12)
    assert (np.diff(modes.response) <= 0.0).all() and modes.response[1] > 10.0 * modes.response[2]
    assert abs(modes.direction[:, 2] @ np.full(3, 3**-0.5)) > 0.99


def test_response_is_how_far_a_unit_of_action_moves_the_tip():
    """Modes are of a unit of action: where that is half the tension, the tip moves half as far."""
    fast, slow = (tip_modes(episodes(action="increment", tension_rate=rate)) for rate in (100.0, 50.0))
    np.testing.assert_allclose(fast.response, 2.0 * slow.response, rtol=1e-9)
    stiff = tip_modes(episodes(action="increment", tension_limits=[0.0, 1e-3]))
    model = episodes().model
    u, h = np.zeros(3), 1e-4
    poses = [model.tip_pose(model.rest_coordinates(u + h * e)) for e in np.eye(3)]
    turn = [np.array([p[2, 1], p[0, 2], p[1, 0]]) - [p[1, 2], p[2, 0], p[0, 1]] for p in poses]
    moved = np.array([[*(0.5 * 0.2 * model.length * t), *(p[:3, 3] - [model.length, 0, 0])] for t, p in zip(turn, poses, strict=True)]) / h
    expected = np.linalg.svd(2.0 * moved.T)[1]  # 2 N are the increment of 20 ms
    np.testing.assert_allclose(stiff.response[:2], expected[:2], rtol=1e-3)


def test_actions_are_those_of_a_gaussian_with_that_covariance():
    torch.manual_seed(0)
    directions = torch.linalg.qr(torch.randn(4, 4)).Q
    mean, log_std = torch.randn(5, 4), torch.tensor([-2.0, -1.0, 0.0, 0.5])
    ours = ModalGaussian(directions).proba_distribution(mean, log_std)
    covariance = directions @ torch.diag(torch.exp(2.0 * log_std)) @ directions.T
    theirs, actions = MultivariateNormal(mean, covariance), torch.randn(5, 4)
    torch.testing.assert_close(ours.log_prob(actions), theirs.log_prob(actions), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(ours.entropy(), theirs.entropy(), rtol=1e-4, atol=1e-4)
    assert (ours.mode() == mean).all()
    many = ModalGaussian(directions).proba_distribution(torch.zeros(200_000, 4), log_std).sample()
    torch.testing.assert_close(torch.cov(many.T), covariance, rtol=0.03, atol=0.02)


def test_a_training_explores_so_goes_on_and_leaves_a_plain_agent(tmp_path):
    training = config.Training(**TABLE)
    model = train.train(training, tmp_path)
    assert isinstance(model.policy.action_dist, ModalGaussian)
    more = config.Training(**{**TABLE, "steps": 512})
    resumed = train.train(more, tmp_path, train.checkpoint_to_resume(tmp_path, more, resume=True))
    assert isinstance(resumed.policy.action_dist, ModalGaussian) and resumed.num_timesteps == 512
    env = gym.make(IDS["TipPose"], **{**SMALL, "action": "increment"})
    observation, _ = env.reset(seed=0)
    action, _ = agent.load_agent(str(tmp_path / "last"), env).predict(observation)
    with torch.no_grad():
        expected = resumed.policy.predict(observation, deterministic=True)[0]
    np.testing.assert_allclose(action, expected, atol=1e-6)


def test_deviations_begin_as_the_modes_say():
    log_std = train.model_of(config.Training(**TABLE), None).policy.log_std.detach().numpy()
    response = tip_modes(episodes(action="increment")).response
    np.testing.assert_allclose(np.exp(log_std), np.minimum(np.exp(-2.0) * np.sqrt(response[0] / response), 0.5), rtol=1e-5)


def test_it_is_for_ppo():
    with pytest.raises(ConfigurationError, match="exploration is 'tip_modes': it is for PPO, not for SAC"):
        config.Training(**{**TABLE, "algorithm": "SAC", "hyperparameters": {}})
