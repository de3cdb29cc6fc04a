"""Analytic policy gradient: learns as a class of Stable-Baselines3 does, and what gradients cannot
pass is refused by name."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from soft_tendon_env.differentiable import rollout
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.analytic_policy_gradient import (
    APG,
    COSTS,
    APGSettings,
    TrackingCost,
    clip_rows,
    normalised,
)
from soft_tendon_env.learning.hyperparameters import UNREAD
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.tools.configuration import ConfigurationError

FAST = {"scene": "three_tendon", "fidelity": "fast"}
OBSERVED = [
    "tip_position",
    "tip_rotation",
    "tip_twist",
    "tendon_lengths",
    "target_error",
    "command",
]
SMALL = {"policy_kwargs": {"net_arch": [32]}, "seed": 0}


def envs(task="TipPose", rows=8, **options):
    return make_sb3_vec_env(
        IDS[task],
        rows,
        threads=1,
        **{**FAST, "action": "increment", "max_episode_steps": 40, **options},
    )


@pytest.mark.slow
def test_errors_fall():
    """To less than a third within 25,000 steps, at which PPO has not begun to learn."""
    drawn = {"latency": [0.0, 0.03], "stiffness": [0.9, 1.1], "noise": {"position": 1e-4}}
    options = {"observation": OBSERVED, "history": 2, "randomize": drawn}
    agent = APG("MlpPolicy", envs(rows=16, **options), learning_rate=2e-3, **SMALL)
    before = error_of(agent, options)
    agent.learn(25_000)
    assert agent.num_timesteps >= 25_000
    assert error_of(agent, options) < before / 3.0


@pytest.mark.parametrize(
    ("task", "policy"), [("TipPose", "MlpPolicy"), ("Reach", "MultiInputPolicy")]
)
def test_observations_are_normalised_as_vec_normalize_does(task, policy):
    env = VecNormalize(
        envs(task, 4, observation="measurable", sensors=1, history=1),
        norm_reward=False,
        clip_obs=2.0,
    )
    agent = APG(policy, env, settings=APGSettings(n_steps=32), **SMALL).learn(512)
    seen = envs(task, 64, observation="measurable", sensors=1, history=1).reset()
    tensors = (
        {key: torch.as_tensor(value) for key, value in seen.items()}
        if task == "Reach"
        else torch.as_tensor(seen)
    )
    found = normalised(tensors, env)
    wanted = env.normalize_obs(seen)
    for key in found if task == "Reach" else [...]:
        np.testing.assert_allclose(found[key], wanted[key], atol=1e-6)
        assert (np.abs(wanted[key]) <= 2.0).all()
    for moments in env.obs_rms.values() if task == "Reach" else [env.obs_rms]:
        assert 512 < moments.count < 600, "of learning, and of resets"
    assert np.isfinite(agent.predict(wanted)[0]).all()


def test_a_policy_remembers_from_one_window_to_the_next_and_forgets_at_resets():
    env = envs(rows=4, observation=OBSERVED, max_episode_steps=12)
    small = {"policy_kwargs": {"net_arch": [32], "memory": 4}, "seed": 0}
    agent = APG(
        "MlpPolicy", env, settings=APGSettings(n_steps=8, max_row_gradient=2.0), **small
    ).learn(32)
    assert (agent._memory != 0.0).any(dim=1).all()
    assert not agent._memory.requires_grad
    agent.learn(32, reset_num_timesteps=False)
    assert not agent._memory.any(), "all episodes have timed out"


def test_a_memory_is_taught_what_was_drawn(tmp_path):
    drawn = {
        "latency": [0.0, 0.04],
        "stiffness": [0.8, 1.2],
        "tension_gain": [0.9, 1.1],
        "payload": 0.001,
        "omit": 0.3,
    }
    env = envs(rows=8, observation=OBSERVED, randomize=drawn)
    small = {"policy_kwargs": {"net_arch": [32], "memory": 4}, "seed": 0}
    agent = APG(
        "MlpPolicy",
        env,
        settings=APGSettings(
            n_steps=8, identification=1e3, cost=lambda found: 0.0 * found.action.sum()
        ),
        **small,
    )
    shares = agent.rows.episodes.drawn_shares()
    assert shares.shape == (8, 2 + agent.rows.episodes.model.tendon_count), (
        "latency, stiffness and gains; a payload has no range"
    )
    memory = agent.policy.gate.weight.detach().clone()
    agent.learn(128)
    assert (agent.policy.gate.weight != memory).any()
    agent.save(tmp_path / "agent")
    assert torch.equal(
        APG.load(tmp_path / "agent", env=env)._identifier.weight, agent._identifier.weight
    )
    with pytest.raises(ValueError, match="needs a policy with a memory"):
        APG("MlpPolicy", env, settings=APGSettings(identification=1.0), **SMALL)


def test_numbers_that_are_drawn_are_shares_of_their_ranges():
    env = envs(
        rows=16,
        randomize={"latency": [0.01, 0.04], "stiffness": [0.8, 1.2], "tension_offset": [-0.1, 0.1]},
    )
    env.reset()
    episodes = env.env.episodes
    for row, shares in enumerate(episodes.drawn_shares()):
        found = episodes.drawn(row)["drawn"]
        modulus = found["segments.0.young_modulus"] / episodes.model.scene.segments[0].young_modulus
        wanted = [
            (modulus - 0.8) / 0.4,
            *((found["tension_offset"] + 0.1) / 0.2),
            (found["latency"] - 0.01) / 0.03,
        ]
        np.testing.assert_allclose(shares, wanted, atol=1e-12)


def test_gradients_of_rows_are_clipped_at_those_of_the_median_row():
    rows = [[1.0, 0.0], [0.0, -2.0], [30.0, 40.0], [0.0, 0.0], [0.0, 3.0]]
    gradient = torch.tensor(rows)
    clipped = clip_rows(gradient, 2.0)
    np.testing.assert_allclose(clipped[2], [2.4, 3.2])
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(clipped[others], gradient[others])
    few = torch.tensor([[0.0], [0.0], [5.0]])
    assert torch.equal(clip_rows(few, 2.0), few)
    assert torch.equal(clip_rows(gradient, np.inf), gradient)


def error_of(agent, options):
    """Root mean square position error [m] in the second half of episodes of other seeds."""
    env, errors = (
        gym.make_vec(
            IDS["TipPose"],
            num_envs=8,
            max_episode_steps=None,
            **{**FAST, "action": "increment", **options},
        ),
        [],
    )
    observation, _ = env.reset(seed=1000)
    for _ in range(60):
        observation, *_, info = env.step(agent.predict(observation, deterministic=True)[0])
        errors.append(info["position_error"])
    return np.sqrt(np.square(errors[30:]).mean())


def test_the_cost_grows_as_a_square_near_the_target_and_as_a_logarithm_far_off():
    env = envs()
    env.reset()
    cost = TrackingCost(
        env.env.episodes,
        APGSettings(position_scale=0.01, angle_scale=0.1, far_weight=0.0, smoothness=2.0),
    )

    def of(position, angle, change):
        error = torch.zeros(1, 1, 6)
        tip = torch.zeros(1, 1, 3)
        error[..., 0] = angle
        tip[..., 0] = position
        return float(
            cost(
                SimpleNamespace(
                    error=error, position_error=tip, action_change=torch.full((1, 1, 3), change)
                )
            )
        )

    assert of(0.0, 0.0, 0.5) == pytest.approx(0.5)
    assert of(1e-5, 0.0, 0.0) == pytest.approx(0.5 * 1e-6, rel=0.05)
    assert of(0.0, 1e-3, 0.0) == pytest.approx(0.5e-4, rel=1e-2)
    assert of(10.0, 0.0, 0.0) == pytest.approx(np.log(1000.0), rel=1e-4)


def test_the_cost_by_the_reward_is_what_it_lacks():
    env = envs(rows=4, observation=OBSERVED)
    env.reset()
    settings = APGSettings(cost="reward", smoothness=0.0)
    agent = APG("MlpPolicy", env, settings=settings, **SMALL)
    trajectories = rollout(agent.rows, lambda seen: agent.policy.act(seen, seen[:, :0])[0], 6)
    cost = agent._cost(trajectories, [])
    missing = 1.0 - trajectories.reward.mean()
    assert float(cost.detach()) == pytest.approx(float(missing), abs=1e-12)


@pytest.mark.parametrize(("cost", "is_read"), [("errors", True), ("reward", False)])
def test_scales_of_errors_are_read_by_their_cost_alone(cost, is_read):
    env = envs(rows=2, observation=OBSERVED)
    env.reset()
    episodes = env.env.episodes
    agent = APG("MlpPolicy", env, **SMALL)
    trajectories = rollout(agent.rows, lambda seen: agent.policy.act(seen, seen[:, :0])[0], 2)
    usual = COSTS[cost](episodes, APGSettings())(trajectories)
    for name in UNREAD["reward"]:
        settings = APGSettings(**{name: 0.5})
        changed = COSTS[cost](episodes, settings)(trajectories)
        is_changed = bool(changed != usual)
        assert is_changed == is_read, name


def test_the_average_of_weights_acts_and_is_saved(tmp_path):
    """It begins with those of the first update, and takes a quarter of the way in each after it."""
    settings = APGSettings(n_steps=4, averaged_updates=4.0)
    agent = APG("MlpPolicy", envs(rows=2, observation=OBSERVED), settings=settings, **SMALL)
    learned = []

    def keep(local, general):
        learned.append(agent.policy.action_net.weight.detach().clone())
        return True

    agent.learn(4 * 2 * 3, callback=keep)
    expected, *later = learned[3::4]
    for weights in later:
        expected = expected + 0.25 * (weights - expected)
    averaged = agent.acting_policy
    torch.testing.assert_close(averaged.action_net.weight.detach(), expected)
    assert not torch.equal(averaged.action_net.weight, agent.policy.action_net.weight)
    observation = agent.env.reset()
    action, _ = agent.predict(observation, deterministic=True)
    expected_action = averaged.predict(observation, deterministic=True)[0]
    np.testing.assert_array_equal(action, expected_action)
    agent.save(tmp_path / "agent")
    loaded = APG.load(tmp_path / "agent", env=agent.env)
    assert torch.equal(loaded.acting_policy.action_net.weight, averaged.action_net.weight)
    assert torch.equal(loaded.policy.action_net.weight, agent.policy.action_net.weight)


def test_refusals():
    """Of environments that are no one's or whose gradients stop somewhere, each by name."""
    with pytest.raises(TypeError, match="make_sb3_vec_env"):
        APG("MlpPolicy", DummyVecEnv([lambda: gym.make("Pendulum-v1")]))
    stuck = {
        "scene": {
            "scene": "three_tendon",
            "effects.viscoelastic_memory": {"branches": [{"modulus": 0.5, "relaxation_time": 0.1}]},
        }
    }
    with pytest.raises(ValueError, match=r"effects\.viscoelastic_memory has internal states"):
        APG("MlpPolicy", envs(**stuck), **SMALL)
    with pytest.raises(ValueError, match="cost is 'rewards': did you mean 'reward'"):
        APGSettings(cost="rewards")
    with pytest.raises(ValueError, match="averaged_updates is 0.5: it should be at least 1"):
        APGSettings(averaged_updates=0.5)
    with pytest.raises(ConfigurationError, match="rewards coordinate_error"):
        APG("MlpPolicy", envs("Shape", reward={"coordinates": {"weight": 1.0}}), **SMALL).learn(128)
