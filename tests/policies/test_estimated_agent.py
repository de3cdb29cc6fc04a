"""Trained agents behind a state estimator: what they then observe, how they act on noisy sensors, and what is refused."""

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control.protocol import Estimate
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import evaluate
from soft_tendon_env.evaluation.entrants import believed_scene, fingerprint, misfit, model_in_the_loop, policy_kind
from soft_tendon_env.policies import load_policy, policy_options
from soft_tendon_env.policies.agent import load_agent
from soft_tendon_env.policies.estimated_agent import EstimatingAgent
from soft_tendon_env.policies.estimators import EstimatorEntry
from soft_tendon_env.policies.names import EstimatedAgent, PolicyName
from soft_tendon_env.policies.regimes import NOISE

MEDIUM = {"type": "random", "fraction": 0.4, "knot_period": 0.6}


class Told:
    """An estimator that is told coordinates and rates."""

    needs = uses = ("q", "q_dot")
    history = 0

    def estimate(self, measured, last):
        return Estimate(measured.q, measured.q_dot)


class Watched:
    """An agent that keeps what it observes."""

    def __init__(self, agent):
        self.agent, self.seen = agent, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append(np.array(observation["observation"] if isinstance(observation, dict) else observation))
        return self.agent.predict(observation, state, episode_start, deterministic)


def made(name, task="TipPose", rows=None, seconds=2.0, **options):
    """An environment, of several rows if so many are asked for, and the policy of a name."""
    given = policy_options(name, task, options)
    steps = round(seconds / 0.02)
    make = {"id": IDS[task], "max_episode_steps": steps}
    env = gym.make(**make, **given) if rows is None else gym.make_vec(**make, num_envs=rows, **given)
    return env, load_policy(name, env)


def error(env, policy, seed=5):
    (score,) = evaluate(policy, env, [seed], 1.0)
    assert score.diverged is None
    return score.errors["position_error"].rms


@pytest.mark.parametrize("task", ["TipPose", "Reach"])
def test_an_agent_that_is_told_the_state_observes_what_it_learned_with(task):
    options = PolicyName.parse("apg", task).options({})
    own = gym.make(IDS[task], **options)
    more = gym.make(IDS[task], **{**options, "observation": (*options["observation"], "coordinates", "rates"), "history": 0})
    agent = Watched(load_agent("apg", own))
    policy = EstimatingAgent(agent, own, more, EstimatorEntry("told:", lambda model, setting: Told()))
    expected, _ = own.reset(seed=3)
    observation, _ = more.reset(seed=3)
    state = None
    for _ in range(30):
        action, state = policy.predict(observation, state)
        expected = expected["observation"] if task == "Reach" else expected
        assert agent.seen[-1] == pytest.approx(expected, abs=1e-4)
        expected, *_ = own.step(action)
        observation, *_ = more.step(action)


@pytest.mark.parametrize("name", ["filtered:apg", "adaptive:agent", "filtered:ppo", "filtered:dagger"])
def test_noisy_sensors_without_rates_suffice(name):
    env, policy = made(name, fidelity="standard", target=MEDIUM, randomize={"noise": NOISE})
    assert not {"rates", "strain_rate", "tip_twist"} & env.unwrapped.episodes.layout.slices.keys()
    assert error(env, policy) < 8e-3


def test_least_squares_take_the_rates_of_strains():
    env, policy = made("measured:apg", fidelity="standard", target=MEDIUM)
    assert "strain_rate" in env.unwrapped.episodes.layout.slices and error(env, policy) < 3e-3
    options = PolicyName.parse("measured:apg", "TipPose").options({}, "sensors")
    assert misfit(PolicyName.parse("measured:apg", "TipPose"), options, "sensors") == "it needs the rates of strains"
    with pytest.raises(ValueError, match="observation lacks strain_rate"):
        load_policy("measured:apg", gym.make(IDS["TipPose"], **options))


def test_a_goal_is_reached_with_noisy_sensors():
    env, policy = made("filtered:apg", "Reach", randomize={"noise": NOISE})
    assert error(env, policy) < 1e-2


def test_rows_are_as_arms_alone_and_begin_anew():
    env, policy = made("filtered:apg", rows=2, randomize={"noise": NOISE})
    alone, one = made("filtered:apg", randomize={"noise": NOISE})
    observation, _ = env.reset(seed=[4, 5])
    first = observation.copy()
    single, _ = alone.reset(seed=4)
    state = own = None
    for _ in range(10):
        actions, state = policy.predict(observation, state)
        action, own = one.predict(single, own)
        assert actions[0] == pytest.approx(action, abs=1e-5)
        observation, *_ = env.step(actions)
        single, *_ = alone.step(action)
    again, state = policy.predict(np.stack([first[0], observation[1]]), state, np.array([True, False]))
    assert again[0] == pytest.approx(policy.predict(first)[0][0], abs=1e-5) and state.periods.tolist() == [1, 11]


def test_what_it_is():
    policy = PolicyName.parse("adaptive:apg", "TipPose")
    assert isinstance(policy, EstimatedAgent) and policy_kind(policy) == "learned"
    assert model_in_the_loop(policy) == "adaptive estimator"
    other, alone = (fingerprint(PolicyName.parse(name, "TipPose")) for name in ("filtered:apg", "apg"))
    assert other != fingerprint(policy) != alone
    believed = believed_scene(policy, {"scene": "paper", "effects.gravity.acceleration": [0.0, 0.0, -9.8]})
    assert believed.effects.gravity is not None and believed.strain == made("apg")[0].unwrapped.episodes.model.scene.strain


def test_what_no_estimator_finds_is_refused():
    with pytest.raises(ValueError, match="observes target_coordinates, which no state estimator finds"):
        made("filtered:ppo", "Shape")


def test_other_actions_are_refused():
    with pytest.raises(ValueError, match="the environment has tension_rate = 50.0, the agent was trained with"):
        made("filtered:apg", tension_rate=50.0)


def test_an_observation_without_the_tip_is_refused():
    with pytest.raises(ValueError, match="observation lacks tip_rotation"):
        made("filtered:apg", observation=["tip_position", "tendon_lengths", "target_error"])


def test_displacements_are_refused():
    elastic = {"effects.tendon_elasticity": {"stiffness": 500.0, "displacement_limits": [0.0, 0.01]}}
    policy = PolicyName.parse("filtered:apg", "TipPose")
    env = gym.make(IDS["TipPose"], **policy.options({"scene": {"scene": "paper", **elastic}}))
    with pytest.raises(ValueError, match="commands are displacements"):
        policy.load(env, other_effects=True)
