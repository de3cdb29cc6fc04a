"""Agents behind the Kalman filter: what they see, and what it is good for."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation import evaluate
from soft_tendon_env.evaluation.entrants import model_in_the_loop, trained_alike
from soft_tendon_env.policies import TrainingWarning, load_policy, policy_options
from soft_tendon_env.policies.estimators import ESTIMATORS, EstimatorEntry
from soft_tendon_env.policies.filtered_agent import ESTIMATED, FilteredAgent
from soft_tendon_env.policies.names import PolicyName
from soft_tendon_env.policies.regimes import NOISE

FILTER = ESTIMATORS["kalman"]
TOLD = ("tendon_lengths", "strain")
"""Groups that an estimator needs besides the tip's pose."""
ELASTIC = {"stiffness": 1e4, "displacement_limits": [-0.01, 0.1]}
SLOW = {"type": "random", "knot_period": 1.5}


class Spy:
    """An agent that keeps what it sees, and pulls in turn."""

    def __init__(self, actions=10):
        self.seen = []
        self.actions = actions

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append(observation)
        count = 0 if state is None else state
        flat = observation["observation"] if isinstance(observation, dict) else observation
        action = np.full((*np.shape(flat)[:-1], self.actions), 0.3 * np.sin(0.3 * count))
        return action.astype(np.float32), count + 1


def knowing(env, latency=0.0):
    """An estimator that is told the arm's state, and says that commands have a latency [s]."""
    arm = env.unwrapped.episodes.arms.rows

    class Told:
        needs = TOLD
        history = 1

        def estimate(self, measured, last):
            return SimpleNamespace(
                q=arm.q[0].copy(),
                q_dot=arm.q_dot[0].copy(),
                tip_pose=None,
                input_error=None,
                force_error=None,
                timing=Timing(latency, 0.0),
                timing_spread=0.0,
                surprise=0.0,
            )

    return EstimatorEntry("told:", lambda model, setting: Told(), Timing(0.06, 0.0))


def made(groups=tuple(ESTIMATED), task="TipPose", **options):
    given = {
        "observation": groups,
        "sensors": 3,
        "preview": [0.02, 0.04, 0.1, 0.2],
        "fidelity": "fast",
        "target": SLOW,
        **options,
    }
    return gym.make(IDS[task], **given)


def test_what_an_agent_sees_of_a_state_that_is_known_is_what_is_observed():
    """All groups, and their history."""
    env = made(history=3)
    spy = Spy()
    entry = knowing(env)
    policy = FilteredAgent(spy, env, env.unwrapped.episodes.model, entry)
    observation, _ = env.reset(seed=1)
    state = None
    for _ in range(12):
        action, state = policy.predict(observation, state)
        np.testing.assert_allclose(spy.seen[-1], observation, rtol=1e-4, atol=2e-5)
        observation, *_ = env.step(action)
        sent = env.unwrapped.episodes.actuation.command[0]
        np.testing.assert_allclose(state.rows[0].command, sent, atol=1e-4)
        np.testing.assert_array_equal(state.rows[0].arm.sent[-1], state.rows[0].command)
    assert np.ptp([seen[0] for seen in spy.seen]) > 1e-3, "the arm moves"


def test_an_agent_sees_the_arm_where_its_command_will_find_it():
    """With two periods of latency it sees what is observed two periods later."""
    groups = ("tip_position", "tip_rotation", *TOLD, "target_error", "target_pose", "preview")
    env = made(groups, preview=[0.02, 0.04], randomize={"latency": 0.04})
    spy = Spy()
    entry = knowing(env, 0.04)
    policy = FilteredAgent(spy, env, env.unwrapped.episodes.model, entry)
    observation, _ = env.reset(seed=1)
    observed = []
    state = None
    for _ in range(20):
        observed.append(observation)
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    told = slice(env.unwrapped.episodes.layout.slices["preview"].start)
    late = np.array(observed[2:])[:, told]
    seen = np.array(spy.seen[:-2])[:, told]
    np.testing.assert_allclose(seen, late, atol=2e-3)
    now = np.array(observed[:-2])[:, told]
    assert abs(now - late).max() > 0.1, "the arm and its target move"


def test_a_target_that_is_not_told_ahead_stays_where_it_is():
    env = made(("tip_position", "tip_rotation", *TOLD, "target_error"))
    spy = Spy()
    entry = knowing(env)
    policy = FilteredAgent(spy, env, env.unwrapped.episodes.model, entry)
    observation, _ = env.reset(seed=1)
    policy.predict(observation)
    np.testing.assert_allclose(spy.seen[0], observation, atol=2e-5)


def test_goals_are_reached_from_where_the_tip_is_estimated():
    env = made(("tip_position", "tip_rotation", *TOLD), task="Reach", target=None, preview=[])
    spy = Spy()
    entry = knowing(env)
    policy = FilteredAgent(spy, env, env.unwrapped.episodes.model, entry)
    observation, _ = env.reset(seed=1)
    moved = {**observation, "achieved_goal": observation["achieved_goal"] + 0.1}
    policy.predict(moved)
    (seen,) = spy.seen
    assert seen["achieved_goal"].dtype == observation["achieved_goal"].dtype
    np.testing.assert_allclose(seen["achieved_goal"], observation["achieved_goal"], atol=1e-6)
    np.testing.assert_array_equal(seen["desired_goal"], observation["desired_goal"])


def test_rows_are_estimated_apart_and_forget_when_their_episodes_begin():
    options = policy_options("filtered:apg", "TipPose", {"randomize": {"noise": NOISE}})
    envs = gym.make_vec(IDS["TipPose"], num_envs=2, threads=1, **options)
    policy = load_policy("filtered:apg", envs)
    observations, _ = envs.reset(seed=[1, 2])
    state = None
    for _ in range(4):
        actions, state = policy.predict(observations, state)
        observations, *_ = envs.step(actions)
    together, _ = policy.predict(observations, state)
    assert together.shape == (2, 10)
    begun, after = policy.predict(observations, state, np.array([False, True]))
    alone, fresh = policy.predict(observations[1:])
    np.testing.assert_allclose(begun[0], together[0], atol=1e-5)
    np.testing.assert_allclose(begun[1], alone[0], atol=1e-5)
    assert after.rows[0].arm.periods == 5
    assert after.rows[1].arm.periods == fresh.rows[0].arm.periods == 1


@pytest.mark.parametrize("regime", ["exact", "noisy"])
def test_an_agent_behind_the_filter_holds_where_commands_are_late(regime):
    """Noise and an unknown latency of 40 ms: alone `apg` is off by two to five times as much."""
    unknown = {"latency": 0.04}
    if regime == "noisy":
        unknown["noise"] = NOISE
    errors = {}
    for name in ("apg", "filtered:apg", "filtered:apg_filtered"):
        given = {"target": SLOW, "randomize": unknown, "scene": "paper", "fidelity": "fast"}
        options = policy_options(name, "TipPose", given)
        env = gym.make(IDS["TipPose"], max_episode_steps=150, **options)
        policy = load_policy(name, env)
        scores = evaluate(policy, env, [1, 2], 1.0)
        errors[name] = [score.errors["position_error"].rms for score in scores]
    bound = 0.6 * min(errors["apg"])
    assert max(*errors["filtered:apg"], *errors["filtered:apg_filtered"]) < bound
    state = None
    observation, _ = env.reset(seed=1)
    for _ in range(60):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    (diagnosis,) = policy.estimate(state)
    assert diagnosis.latency.value == pytest.approx(0.04, abs=0.005)


def test_the_filter_of_an_agent_has_a_model_of_its_own():
    options = policy_options("filtered:apg@fast", "TipPose", {"fidelity": "standard"})
    env = gym.make(IDS["TipPose"], **options)
    with pytest.warns(TrainingWarning, match="judged with 'standard'"):
        policy = load_policy("filtered:apg@fast", env)
    believed = policy.observer.estimator.model
    assert believed.coordinate_count < env.unwrapped.episodes.model.coordinate_count


@pytest.mark.parametrize(
    ("task", "options", "said"),
    [
        (
            "TipPose",
            {"scene": {"scene": "paper", "effects.tendon_elasticity": ELASTIC}},
            "commands are in m: an agent behind a state estimator needs tensions",
        ),
        (
            "TipPose",
            {"observation": ("tip_position", "tip_rotation", "coordinates", "rates")},
            "observes coordinates, rates, which no state estimator replaces",
        ),
        (
            "Shape",
            {"observation": ("tip_position", "tip_rotation", *TOLD, "target_lengths")},
            "observes target_lengths, which no state estimator replaces",
        ),
        (
            "TipPose",
            {"observation": ("tip_position", *TOLD)},
            "does not observe tip_rotation, which the state estimator needs",
        ),
        (
            "TipPose",
            {"observation": ("tip_position", "tip_rotation", *TOLD, "target_pose")},
            "does not observe target_error, which the state estimator needs",
        ),
    ],
)
def test_agents_that_no_estimate_serves_are_refused(task, options, said):
    env = gym.make(IDS[task], **options)
    with pytest.raises(ValueError, match=said):
        FilteredAgent(Spy(), env, env.unwrapped.episodes.model, FILTER)


def test_all_seeds_of_a_training_stand_behind_the_same_filter():
    members = trained_alike(PolicyName.parse("filtered:apg@fast", "TipPose"))
    assert sorted(members) == [0, 1, 2, 3, 4]
    agents = {PolicyName.parse(name, "TipPose") for name in members.values()}
    assert len({agent.folder for agent in agents}) == 5
    assert {agent.estimator for agent in agents} == {"kalman"}
    assert {agent.belief for agent in agents} == {"fast"}
    assert len({str(agent.fingerprint()) for agent in agents}) == 5


def test_the_use_of_a_model_is_said():
    words = [
        model_in_the_loop(PolicyName.parse(name, "TipPose"), told=True)
        for name in ("apg", "filtered:apg", "filtered:tracking", "tracking")
    ]
    assert words == [
        "none",
        "kalman estimator, told of the effects",
        "controller, kalman estimator, told of the effects",
        "controller, told of the effects",
    ]
