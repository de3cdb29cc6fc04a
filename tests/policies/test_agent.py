"""Trained agents as policies: what is found in their files, and what is refused."""

import json

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.policies import agent

SMALL = {"scene": "three_tendon", "fidelity": "fast"}


def make(task="TipPose", **options):
    return gym.make(IDS[task], **{**SMALL, **options})


@pytest.fixture
def agents():
    """agents/_agents.py."""
    return agent


@pytest.mark.parametrize("name", ["A2C", "PPO", "SAC", "TD3", "TQC", "TRPO", "CrossQ", "RecurrentPPO"])
def test_the_algorithm_is_found_from_the_file(tmp_path, agents, name):
    import sb3_contrib
    import stable_baselines3

    own = getattr(stable_baselines3, name, None) or getattr(sb3_contrib, name)
    trained = own("MlpLstmPolicy" if name == "RecurrentPPO" else "MlpPolicy", make(), device="cpu", seed=0)
    trained.save(tmp_path / "model.zip")
    assert agents.algorithm_of(tmp_path / "model.zip") == name
    env = make()
    observation, _ = env.reset(seed=0)
    action, _ = agents.load_agent(str(tmp_path / "model.zip"), env).predict(observation, None, np.ones(1, bool), deterministic=True)
    np.testing.assert_array_equal(action, trained.predict(observation, deterministic=True)[0])


def test_an_agent_sees_through_the_statistics_beside_it(tmp_path, agents):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    statistics = VecNormalize(DummyVecEnv([make]))
    trained = PPO("MlpPolicy", statistics, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu").learn(64)
    trained.save(tmp_path / "model.zip")
    env = make()
    observation, _ = env.reset(seed=0)
    with pytest.raises(FileNotFoundError, match="should have its vecnormalize.pkl beside it"):
        agents.load_agent(str(tmp_path / "model.zip"), env)
    (tmp_path / "config.json").write_text(json.dumps({"normalise": {"observations": False}}))
    raw, _ = agents.load_agent(str(tmp_path / "model.zip"), env).predict(observation)
    statistics.save(str(tmp_path / "vecnormalize.pkl"))
    action, _ = agents.load_agent(str(tmp_path / "model.zip"), env).predict(observation)
    np.testing.assert_array_equal(action, trained.predict(statistics.normalize_obs(observation), deterministic=True)[0])
    assert not np.array_equal(action, raw)


def test_a_goal_reached_by_hindsight_needs_no_memory_of_it(tmp_path, agents):
    """HER's buffer wants the environment, and a million samples of it."""
    from stable_baselines3 import SAC, HerReplayBuffer

    SAC("MultiInputPolicy", make("Reach"), replay_buffer_class=HerReplayBuffer, device="cpu").save(tmp_path / "model.zip")
    env = make("Reach")
    agent = agents.load_agent(str(tmp_path / "model.zip"), env)
    action, _ = agent.predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)


def test_a_file_of_something_else_is_refused(tmp_path, agents):
    (tmp_path / "model.zip").write_text("not a zip")
    with pytest.raises(ValueError, match="is no agent of Stable-Baselines3"):
        agents.algorithm_of(tmp_path / "model.zip")
    (tmp_path / "config.json").write_text("[]")
    with pytest.raises(ValueError, match="should be"):
        agents.agent_options(tmp_path / "model.zip")


@pytest.fixture
def ppo(tmp_path, agents):
    """The file of an agent that has learned nothing, with its configuration beside it."""
    from stable_baselines3 import PPO

    env = make(action="increment")
    PPO("MlpPolicy", env, n_steps=8, batch_size=4, seed=0, device="cpu").save(tmp_path / "model.zip")
    config = {"options": {**SMALL, "action": "increment"}, "layout": agents.layout_of(env.unwrapped.episodes)}
    (tmp_path / "config.json").write_text(json.dumps(config))
    return str(tmp_path / "model.zip")


SWAPPED = ["rates", "coordinates", "tip_position", "tip_rotation", "tip_twist", "target_error", "target_twist", "preview", "last_action"]


@pytest.mark.parametrize(
    "task, options, said",
    [
        ("TipPose", {"observation": SWAPPED}, "was trained with the observation coordinates (3), rates (3), .* has rates (3)"),
        ("TipPose", {"preview": []}, "preview (12), last_action (3), this environment has .* preview (0)"),
        ("Shape", {}, "was trained with the observation .*target_coordinates (3)"),
        ("TipPose", {"scene": "paper"}, "was trained on an arm with other segments"),
        ("TipPose", {"scene": {"scene": "three_tendon", "segments[0].young_modulus": 1e5}}, "was trained on an arm with other segments"),
        ("TipPose", {"scene": {"scene": "three_tendon", "effects.gravity.acceleration": [0, 0, -9.81]}}, "with other effects"),
    ],
    ids=["order", "preview", "task", "scene", "stiffness", "gravity"],
)
def test_an_agent_is_refused_elsewhere(agents, ppo, task, options, said):
    agents.load_agent(ppo, make(action="increment"))
    with pytest.raises(ValueError, match=said.replace("(", r"\(").replace(")", r"\)")):
        agents.load_agent(ppo, make(task, **{"action": "increment", **options}))


def test_an_agent_takes_along_its_arm_and_its_interface_but_not_what_it_learned(tmp_path, agents):
    learned = {"target": "circle", "reward": {"position": 1.0}, "randomize": {"payload": 0.1}, "threshold": 0.02, "on_divergence": "raise"}
    kept = {**SMALL, "action": "increment", "tension_rate": 50.0, "preview": [0.1], "control_period": 0.01, "tension_limits": [0.0, 9.0]}
    (tmp_path / "config.json").write_text(json.dumps({"options": {**learned, **kept}}))
    assert agents.agent_options(tmp_path / "model.zip") == kept
