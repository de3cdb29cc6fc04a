"""Controllers as agents: they are told what is, what they decide is done, rows know nothing of each other."""

import warnings

import numpy as np
import pytest

from soft_tendon_env.envs import IDS
from soft_tendon_env.policies.protocol import STATELESS_CALLS

PREVIEW = (0.02, 0.04, 0.1)
SINGLE_PRECISION = {"rtol": 1e-6, "atol": 2e-6}


def assert_told(now, env, row, seconds):
    """A situation of a row is its episodes'."""
    episodes = env.unwrapped.episodes
    state, pose = episodes.state(row), episodes.arms.reading.tip_pose[row]
    np.testing.assert_allclose(now.q, state.q, **SINGLE_PRECISION)
    np.testing.assert_allclose(now.q_dot, state.q_dot, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(now.tip_pose, pose, **SINGLE_PRECISION)
    np.testing.assert_allclose(now.tip_pose[:3, :3] @ now.tip_pose[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_array_equal(now.tip_pose[3], [0.0, 0.0, 0.0, 1.0])
    wanted, task = episodes.target_at(row, seconds + now.reference.ahead), episodes.task
    np.testing.assert_allclose(now.reference.ahead, [0.0] if task.goal else [0.0, *PREVIEW], atol=1e-12)
    expected = {
        "TipPose": {"tip_pose": wanted.tip_pose},
        "Shape": {"q": wanted.q},
        "Reach": {"tip_position": wanted.tip_pose[:, :3, 3]},
    }[task.name]
    for name in ("tip_pose", "tip_position", "q"):
        told = getattr(now.reference, name)
        if name not in expected:
            assert told is None
        else:
            np.testing.assert_allclose(told, expected[name], rtol=1e-6, atol=5e-6)


@pytest.mark.parametrize("kind", ["single", "vector", "sb3"])
@pytest.mark.parametrize("task", IDS)
def test_controllers_are_told_what_is_and_do_what_they_decide(short, probed, begun, kind, task):
    env = short(kind, IDS[task])
    inner, rows = env.env if kind == "sb3" else env, 1 if kind == "single" else 3
    policy, probe = probed(env)
    observation, state = begun(env), None
    asked = np.tile(inner.unwrapped.episodes.start_tension, (rows, 1))
    for step in range(5):
        action, state = policy.predict(observation, state)
        told = probe.seen[-rows:]
        for row, (now, memory) in enumerate(told):
            assert_told(now, inner, row, 0.02 * step)
            np.testing.assert_allclose(now.tension, asked[row], rtol=1e-6)
            assert memory == (step or None)
        asked = np.stack([memory.decision.tension for memory in state])
        observation = env.step(action)[0]
        np.testing.assert_allclose(inner.unwrapped.episodes.tension, asked, rtol=1e-6)
    assert len(probe.seen) == 5 * rows and np.ptp(asked) > 0.1


def test_increments_add_up_to_what_was_decided(short, probed, begun):
    env = short("single", IDS["TipPose"], action="increment", tension_rate=250.0)  # 5 N a period: from any limit to any other
    policy, _ = probed(env)
    observation, state = begun(env), None
    for _ in range(5):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        np.testing.assert_allclose(env.unwrapped.episodes.tension[0], state[0].decision.tension, rtol=1e-5)
        np.testing.assert_allclose(env.unwrapped.episodes.tension[0], state[0].tension, rtol=1e-12)


def test_increments_come_as_near_as_they_can(short, probed, begun):
    """And the next situation tells the tensions that were asked for, not those that were decided."""
    env = short("single", IDS["TipPose"], action="increment", tension_rate=10.0)
    policy, probe = probed(env, least=4.0, span=1.0)
    observation, state = begun(env), None
    for step in range(1, 5):
        action, state = policy.predict(observation, state)
        np.testing.assert_array_equal(action, 1.0)
        observation = env.step(action)[0]
        np.testing.assert_allclose(env.unwrapped.episodes.tension[0], 0.2 * step, rtol=1e-6)
    policy.predict(observation, state)
    np.testing.assert_allclose(probe.seen[-1][0].tension, 0.8, rtol=1e-6)


def test_decisions_beyond_the_limits_become_the_limits(short, probed, begun):
    env = short("single", IDS["TipPose"])
    policy, _ = probed(env, least=100.0)
    action, state = policy.predict(begun(env))
    np.testing.assert_array_equal(action, 1.0)
    np.testing.assert_array_equal(state[0].tension, 5.0)


def test_rows_that_begin_forget_and_the_others_do_not(short, probed, begun):
    env = short("vector", IDS["TipPose"])
    policy, probe = probed(env)
    observation = begun(env)
    _, state = policy.predict(observation, None, np.ones(3, dtype=bool))
    policy.predict(observation, state, np.array([False, True, False]))
    told = probe.seen[3:]
    assert [memory for _, memory in told] == [1, None, 1]
    for row in range(3):
        expected = env.unwrapped.episodes.start_tension if row == 1 else state[row].tension
        np.testing.assert_array_equal(told[row][0].tension, expected)
    with pytest.raises(ValueError):
        policy.predict(observation, state, np.array([True, False]))


@pytest.mark.parametrize("task", IDS)
def test_rows_are_what_single_rows_are(short, probed, begun, task):
    """Bit for bit, shapes apart."""
    env = short("vector", IDS[task])
    policy, _ = probed(env)
    observation, state, alone = begun(env), None, [None] * 3
    for _ in range(4):
        actions, state = policy.predict(observation, state)
        assert actions.shape == (3, 3) and actions.dtype == np.float32 and len(state) == 3
        for row in range(3):
            own = {key: value[row] for key, value in observation.items()} if isinstance(observation, dict) else observation[row]
            action, alone[row] = policy.predict(own, alone[row], np.array([False]), deterministic=False)
            assert action.shape == (3,) and action.dtype == np.float32 and len(alone[row]) == 1
            np.testing.assert_array_equal(action, actions[row])
            np.testing.assert_array_equal(alone[row][0].tension, state[row].tension)
        observation = env.step(actions)[0]
    assert (actions[0] != actions[1]).any()


def test_a_state_that_is_never_given_back_is_warned_of_once(short, probed, begun):
    env = short("single", IDS["TipPose"])
    policy, _ = probed(env)
    observation = begun(env)
    for _ in range(STATELESS_CALLS - 1):
        policy.predict(observation)
    with pytest.warns(UserWarning, match="without the state of Probe.*action, state = policy.predict") as told:
        for _ in range(3):
            policy.predict(observation)
    assert len(told) == 1 and told[0].filename == __file__


@pytest.mark.parametrize("given", ["state", "episode_start", "both"])
def test_no_warning_where_the_state_is_given_back_or_episodes_start(short, probed, begun, given):
    env = short("single", IDS["TipPose"])
    policy, _ = probed(env)
    observation, state = begun(env), None
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        for _ in range(2 * STATELESS_CALLS):
            starts = None if given == "state" else np.ones(1, dtype=bool)
            state = policy.predict(observation, None if given == "episode_start" else state, starts)[1]
