"""Residual policies: agents that add to the actions of a controller or of another agent, and what these are told of it."""

import json
import shutil

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import evaluate
from soft_tendon_env.evaluation.entrants import fingerprint, model_in_the_loop, policy_kind
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.policies.agent_files import ResidualSettings, trained_folder
from soft_tendon_env.policies.estimated_agent import EstimatingAgent
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.residual import Residual, ResidualPolicy

BASES = ["feedforward", "tracking", "predictive", "measured:tracking", "filtered:predictive@fast", "apg", "filtered:apg", "dagger"]
NOISE = {"position": 1e-3, "curvature": 0.05}


class Adding:
    """An agent that adds the same to all actions."""

    def __init__(self, env, added):
        self._added = np.full(env.action_space.shape, added, dtype=np.float32)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.broadcast_to(self._added, (*np.shape(observation)[:-1], self._added.size)), None


def made(name, steps=20, **options):
    """An environment, and the policy of a name in it."""
    env = gym.make(IDS["TipPose"], max_episode_steps=steps, disable_env_checker=True, **policy_options(name, "TipPose", options))
    return env, load_policy(name, env)


def added_to(name, env, added, **settings):
    return ResidualPolicy(Residual(ResidualSettings(policy=name, **settings), env), Adding(env, added))


@pytest.mark.cases("name", BASES)
def test_an_agent_that_adds_nothing_leaves_the_other_policy_as_it_is(name):
    env, policy = made(name, randomize={"noise": NOISE} if "filtered" in name else {})
    alone, both = (evaluate(own, env, [0, 1], 0.1) for own in (policy, added_to(name, env, 0.0)))
    for one, other in zip(alone, both, strict=True):
        assert other.errors["position_error"].rms == pytest.approx(one.errors["position_error"].rms, rel=1e-6)
        assert other.total_reward == pytest.approx(one.total_reward, rel=1e-9)


@pytest.mark.cases("name", ["filtered:predictive@fast", "filtered:apg"])
def test_a_state_estimator_is_told_what_the_sum_asks_for(name):
    env, policy = made(name)
    seen, _ = env.reset(seed=3)
    told, state = added_to(name, env, 1.0, share=0.3), None
    for _ in range(8):
        action, state = told.predict(seen, state)
        seen, *_ = env.step(action)
        rows = state.policy
        sent = rows.sent[0, -1] if isinstance(policy, EstimatingAgent) else rows[0].sent[-1]
        np.testing.assert_allclose(sent, env.unwrapped.episodes.tension[0], atol=1e-4)


def saved(tmp_path, base, **changes):
    """The folder of an agent like the one that ships, which adds to another policy."""
    folder = tmp_path / "residual"
    shutil.copytree(trained_folder() / "ppo" / "TipPose", folder, dirs_exist_ok=True)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "residual": {"policy": base, **changes}}))
    return PolicyName.parse(str(folder), "TipPose")


@pytest.mark.cases(
    "base, kind, model",
    [
        ("filtered:predictive@fast", "hybrid", "controller, kalman estimator"),
        ("apg", "learned", "none"),
        ("adaptive:apg", "learned", "adaptive estimator"),
        ("ppo", "learned", "none"),
    ],
)
def test_what_it_is(tmp_path, base, kind, model):
    policy = saved(tmp_path, base)
    assert policy_kind(policy) == kind and set(model_in_the_loop(policy).split(", ")) == set(model.split(", "))
    assert fingerprint(policy)["added to"] == fingerprint(PolicyName.parse(base, "TipPose"))


def test_another_agent_than_the_one_that_was_added_to_is_refused(tmp_path):
    config = json.loads((trained_folder() / "ppo" / "TipPose" / "config.json").read_text())
    assert policy_kind(saved(tmp_path, "ppo", files=config["files"])) == "learned"
    with pytest.raises(ValueError, match=r"weights.pt is not the file that .* was written with"):
        policy_kind(saved(tmp_path, "ppo", files={**config["files"], "weights.pt": "0" * 64}))


@pytest.mark.cases(
    "base, said",
    [
        ("nope", "policy is 'nope', no policy"),
        ("tests.arena.test_arena:Still", "should be a controller or an agent"),
        ("tests", "should be a controller or an agent"),
    ],
)
def test_what_cannot_be_added_to_is_refused(base, said):
    with pytest.raises(ValueError, match=said):
        ResidualSettings(policy=base).named("TipPose")


def test_a_controller_believes_in_the_arm_of_the_training():
    name, weight = "filtered:predictive@fast", {"scene": "paper", "effects.gravity.acceleration": [0.0, 0.0, -9.8]}
    heavy, plain = (made(name, **options)[0] for options in ({"scene": weight, "fidelity": "fine"}, {}))
    arms = {own: own.unwrapped.episodes.model.scene for own in (heavy, plain)}
    gravity = arms[heavy].effects.gravity

    def believed(env, scene=None, **settings):
        return Residual(ResidualSettings(policy=name, **settings), env, scene)._policy.estimator.model.scene

    assert believed(heavy).effects.gravity == gravity and believed(plain, arms[heavy]).effects.gravity == gravity
    assert believed(heavy, arms[plain]).effects.gravity is None and believed(heavy, without=["gravity"]).effects.gravity is None
    assert believed(heavy).strain != arms[heavy].strain
    with pytest.raises(ValueError, match="residual.without has 'fluid', which the arm has not: gravity"):
        believed(heavy, without=["fluid"])
    with pytest.raises(ValueError, match=r"policy is 'apg', and without is \['gravity'\]: it is for controllers and state estimators"):
        ResidualSettings(policy="apg", without=["gravity"]).named("TipPose")
