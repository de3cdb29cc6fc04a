"""Controllers as agents: they are told what is, what they decide is done, rows know nothing of each
other."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.control import ControllerOutput, Shape, TipPose, TipPosition
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.policies.arm_observer import ArmObserver
from soft_tendon_env.policies.controller_policy import ControllerPolicy, make_policy
from soft_tendon_env.policies.names import policy_options
from soft_tendon_env.policies.protocol import STATELESS_CALLS
from soft_tendon_env.tools.configuration import ConfigurationError

PREVIEW = (0.02, 0.04, 0.1)
SINGLE_PRECISION = {"rtol": 1e-6, "atol": 2e-6}


class Probe:
    """A controller that keeps the inputs and memories it is given, asks for tensions that depend on
    all of them, and counts."""

    def __init__(self):
        self.weights = np.arange(1.0, 4.0)
        self.seen = []

    def act(self, now, memory=None):
        self.seen.append((now, memory))
        told = (
            now.q,
            now.q_dot,
            now.tip_pose,
            now.tension,
            now.reference.tip_pose,
            now.reference.tip_position,
            now.reference.q,
        )
        phase = (memory or 0) + sum(values.sum() for values in told if values is not None)
        return ControllerOutput(0.5 + 1.5 * (1.0 + np.sin(self.weights * phase)), (memory or 0) + 1)


def probed(env):
    """A policy for three tendons and the probe it asks."""
    probe = Probe()
    return ControllerPolicy(probe, env), probe


def short(kind, id, **options):
    """Episodes of six steps, in a "single" environment or three rows of Gymnasium ("vector") or
    "sb3"."""
    options = {
        "max_episode_steps": 6,
        "scene": "three_tendon",
        "fidelity": "fast",
        "action": "tension",
        "preview": PREVIEW,
        **options,
    }
    if kind == "single":
        return gym.make(id, **options)
    return (
        gym.make_vec(id, num_envs=3, **options)
        if kind == "vector"
        else make_sb3_vec_env(id, 3, **options)
    )


def begun(env):
    """The first observation, of seed 0."""
    if isinstance(env, gym.Env | gym.vector.VectorEnv):
        return env.reset(seed=0)[0]
    env.seed(0)
    return env.reset()


def assert_told(now, env, row, seconds):
    """What a controller is told of a row is what its episode has."""
    episodes = env.unwrapped.episodes
    state = episodes.state(row)
    pose = episodes.arms.reading.tip_pose[row]
    assert now.time == pytest.approx(seconds)
    np.testing.assert_allclose(now.q, state.q, **SINGLE_PRECISION)
    np.testing.assert_allclose(now.q_dot, state.q_dot, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(now.tip_pose, pose, **SINGLE_PRECISION)
    np.testing.assert_allclose(now.tip_pose[:3, :3] @ now.tip_pose[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_array_equal(now.tip_pose[3], [0.0, 0.0, 0.0, 1.0])
    wanted = episodes.trajectories.at(row, seconds + now.reference.ahead)
    task = episodes.task
    np.testing.assert_allclose(
        now.reference.ahead, [0.0] if task.goal else [0.0, *PREVIEW], atol=1e-12
    )
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
def test_controllers_are_told_what_is_and_do_what_they_decide(kind, task):
    env = short(kind, IDS[task])
    inner = env.env if kind == "sb3" else env
    rows = 1 if kind == "single" else 3
    policy, probe = probed(env)
    observation = begun(env)
    state = None
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
    assert len(probe.seen) == 5 * rows
    assert np.ptp(asked) > 0.1


def test_rows_that_begin_forget_and_the_others_do_not():
    env = short("vector", IDS["TipPose"])
    policy, probe = probed(env)
    observation = begun(env)
    _, state = policy.predict(observation, None, np.ones(3, dtype=bool))
    policy.predict(observation, state, np.array([False, True, False]))
    told = probe.seen[3:]
    assert [memory for _, memory in told] == [1, None, 1]
    assert [now.time for now, _ in told] == pytest.approx([0.02, 0.0, 0.02])
    for row in range(3):
        expected = env.unwrapped.episodes.start_tension if row == 1 else state[row].tension
        np.testing.assert_array_equal(told[row][0].tension, expected)
    with pytest.raises(ValueError):
        policy.predict(observation, state, np.array([True, False]))


def test_a_state_that_is_never_given_back_is_warned_of_once():
    env = short("single", IDS["TipPose"])
    policy, _ = probed(env)
    observation = begun(env)
    for _ in range(STATELESS_CALLS - 1):
        policy.predict(observation)
    with pytest.warns(
        UserWarning, match="without the state of Probe.*action, state = policy.predict"
    ) as told:
        for _ in range(3):
            policy.predict(observation)
    assert len(told) == 1
    assert told[0].filename == __file__


def test_observations_that_say_too_little_are_refused():
    _, probe = probed(short("single", IDS["TipPose"]))
    blind = short("single", IDS["TipPose"], observation=("tip_position", "coordinates"))
    with pytest.raises(
        ConfigurationError,
        match="observation.*lacks tip_rotation, rates, target_error, preview, which Probe needs",
    ):
        probed(blind)
    env = short("single", IDS["TipPose"])
    estimator = SimpleNamespace(needs=("strain", "strain_rate"), history=0)
    observer = ArmObserver(env.unwrapped.episodes, estimator)
    with pytest.raises(ConfigurationError, match="lacks strain"):
        ControllerPolicy(probe, env, observer=observer)


@pytest.mark.parametrize("preview", [(0.04, 0.02), (0.02, 0.02), (0.02, 0.021)])
def test_preview_times_increase(preview):
    with pytest.raises(
        ConfigurationError, match=r"it should be times that increase by at least a control period"
    ):
        probed(short("single", IDS["TipPose"], preview=preview))


@pytest.mark.parametrize(
    ("task", "controller", "latency", "preview", "told"),
    [
        (
            "TipPose",
            "predictive",
            0.0,
            (0.02, 0.04),
            "0.02, 0.04] s, and it is needed at every control period up to 0.26 s",
        ),
        (
            "TipPose",
            "long_horizon_predictive",
            0.0,
            (0.5,),
            "up to 0.5 s: make the environment with observation_options",
        ),
        (
            "TipPose",
            "robust_predictive",
            0.03,
            (0.02, 0.04, 0.06, 0.08, 0.12, 0.14, 0.16, 0.18),
            "up to 0.18 s",
        ),
        ("Shape", "feedforward", 0.0, (0.02,), "it is needed at every control period up to 0.04 s"),
        (
            "TipPose",
            "tracking",
            0.05,
            (0.02, 0.04, 0.08),
            "it is needed at every control period up to 0.1 s",
        ),
        ("TipPose", "tracking", 0.05, (0.02, 0.04, 0.1), None),
        (
            "TipPose",
            "tracking",
            0.0,
            (0.1, 0.2),
            None,
        ),  # goes straight in between, which feedback makes up for
        ("Reach", "predictive", 0.0, (0.02,), None),  # goals do not move
    ],
)
def test_a_preview_that_lacks_what_a_controller_looks_at_is_refused(
    task, controller, latency, preview, told
):
    env = short("single", IDS[task], preview=preview)
    if told is None:
        make_policy(controller, env, latency=latency)
    else:
        with pytest.raises(ConfigurationError, match=told):
            make_policy(controller, env, latency=latency)


class Elsewhere:
    """An objective that follows what no task tells."""

    follows = ("moon",)

    def linear_error(self, posture):
        raise AssertionError


@pytest.mark.parametrize(
    ("task", "objective", "told"),
    [
        ("TipPose", TipPose(), "tip_pose"),
        ("Reach", TipPosition(), "tip_position"),
        ("Shape", Shape, "q"),
    ],
)
def test_objectives_follow_what_a_task_tells(task, objective, told):
    arm = {"scene": "three_tendon", "fidelity": "fast"}
    env = gym.make(IDS[task], **policy_options("predictive", task, arm))
    assert make_policy("predictive", env, objectives=[objective]) is not None
    with pytest.raises(ValueError, match=f"this environment tells {told} alone"):
        make_policy("predictive", env, objectives=[Elsewhere()])
