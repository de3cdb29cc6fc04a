"""Environments and agents as controllers meet them: interfaces, names, Stable-Baselines3's evaluation, recordings."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.envs import IDS
from soft_tendon_env.learning.vec_env import make_sb3_vec_env
from soft_tendon_env.policies.controller_policy import ControllerPolicy, interface_of, make_policy, observation_options
from soft_tendon_env.recording import collect
from soft_tendon_env.tools.configuration import ConfigurationError

PREVIEW = (0.02, 0.04, 0.1)
FAST = {"scene": "three_tendon", "fidelity": "fast"}


def test_the_interface_is_the_same_however_the_environment_is_wrapped(short):
    envs = [short(kind, IDS["TipPose"]) for kind in ("single", "vector", "sb3")]
    monitored = VecNormalize(make_sb3_vec_env(IDS["TipPose"], 2, preview=PREVIEW, **FAST))
    for env in (*envs, gym.wrappers.TimeLimit(envs[0], 3), monitored):
        found = interface_of(env)
        assert found.layout.slices == interface_of(envs[0]).layout.slices
        np.testing.assert_allclose(found.ahead, [0.0, *PREVIEW], atol=1e-12)
        np.testing.assert_array_equal(found.start, 0.0)


@pytest.mark.parametrize("env", [lambda: gym.make("CartPole-v1"), lambda: gym.make_vec("CartPole-v1", 1), object])
def test_other_environments_are_refused(env):
    with pytest.raises(TypeError, match="should be an environment of soft_tendon_env, not"):
        interface_of(env())


def test_observations_that_say_too_little_are_refused(short, probed):
    _, probe = probed(short("single", IDS["TipPose"]))
    blind = short("single", IDS["TipPose"], observation=("tip_position", "coordinates"))
    with pytest.raises(ConfigurationError, match="observation.*lacks tip_rotation, rates, target_error, preview, which Probe needs"):
        probed(blind)
    with pytest.raises(ConfigurationError, match="lacks strain"):
        ControllerPolicy(probe, interface_of(short("single", IDS["TipPose"])), SimpleNamespace(needs=("strain", "strain_rate"), history=0))


MEASURED = ("tip_position", "tip_rotation", "coordinates", "rates")


@pytest.mark.parametrize(
    "task, seen, missing",
    [
        ("TipPose", ("target_error",), "preview"),
        ("Shape", ("target_error", "preview"), "target_coordinates, coordinate_preview"),
        ("Shape", ("target_coordinates",), "coordinate_preview"),
    ],
)
def test_controllers_are_told_the_target_in_groups_of_the_task(short, probed, task, seen, missing):
    with pytest.raises(ConfigurationError, match=f"observation lacks {missing}, which Probe needs"):
        probed(short("single", IDS[task], observation=(*MEASURED, *seen)))


@pytest.mark.parametrize(
    "task, seen",
    [
        ("TipPose", ("target_error", "preview")),
        ("Shape", ("target_coordinates", "coordinate_preview")),
        ("Shape", ("wanted_coordinates",)),
        ("Reach", ()),
    ],
)
def test_these_groups_are_enough(short, probed, begun, task, seen):
    env = short("single", IDS[task], observation=(*MEASURED, *seen))
    policy, probe = probed(env)
    policy.predict(begun(env))
    target = probe.seen[0][0].reference
    assert any(told is not None for told in (target.tip_pose, target.tip_position, target.q))


@pytest.mark.parametrize("preview", [(0.04, 0.02), (0.02, 0.02), (0.02, 0.021)])
def test_preview_times_increase(short, probed, preview):
    with pytest.raises(ConfigurationError, match=r"preview should be times that increase by at least a control period"):
        probed(short("single", IDS["TipPose"], preview=preview))


def test_unknown_names_are_told_what_there_is(short):
    env = short("single", IDS["Reach"])
    known = "feedforward, long_horizon_predictive, predictive, robust_predictive, robust_tracking, tracking"
    with pytest.raises(ValueError, match=f"controller is 'trackin'.*did you mean 'tracking'.*{known}"):
        make_policy("trackin", env)
    with pytest.raises(ValueError, match="task is 'Tip'.*valid: Reach, Shape, TipPose"):
        observation_options("tracking", "Tip")
    with pytest.raises(TypeError, match="soft_tendon_env"):
        make_policy("tracking", gym.make("CartPole-v1"))


@pytest.mark.parametrize("task", CONTROLLERS)
def test_controllers_see_as_far_ahead_as_they_want(task):
    for name, entry in CONTROLLERS[task].items():
        options = observation_options(name, task, 0.05)
        np.testing.assert_allclose(options["preview"], 0.05 * np.arange(1, entry.looks_ahead + 1))
        env = gym.make(IDS[task], control_period=0.05, **FAST, **options)
        np.testing.assert_allclose(interface_of(env).ahead, 0.05 * np.arange(entry.looks_ahead + 1))


@pytest.mark.parametrize("task", ["TipPose", "Reach"])
def test_stable_baselines_evaluates_controllers(short, probed, task):
    """Single environments and rows; every episode begins with no memory."""
    for kind, episodes in (("single", 2), ("sb3", 3)):
        env = short(kind, IDS[task])
        policy, probe = probed(env)
        _, lengths = evaluate_policy(policy, env, n_eval_episodes=episodes, return_episode_rewards=True, warn=False)
        assert lengths == [6] * episodes
        assert sum(memory is None for _, memory in probe.seen) >= episodes
        assert max(memory or 0 for _, memory in probe.seen) == 5


def test_episodes_of_controllers_are_collected(short, probed):
    env = short("single", IDS["Shape"])
    policy, probe = probed(env)
    state = None

    def act(observation):
        nonlocal state
        action, state = policy.predict(observation, state)
        return action

    rollout = collect(env, act, seed=0)
    assert rollout.samples == 7 and len(probe.seen) == 6
    for sample, (now, _) in enumerate(probe.seen):
        np.testing.assert_allclose(rollout.tip_pose[sample], now.tip_pose, rtol=1e-6, atol=2e-6)
        np.testing.assert_allclose(rollout.tension[sample], now.tension, rtol=1e-6)


@pytest.mark.cases(
    "task, controller, latency, preview, told",
    [
        ("TipPose", "predictive", 0.0, (0.02, 0.04), "0.02, 0.04] s, and 'predictive' needs it at every control period up to 0.14 s"),
        ("TipPose", "predictive", 0.0, (0.1, 0.2), "'predictive' needs it at every control period up to 0.14 s"),
        ("TipPose", "long_horizon_predictive", 0.0, (0.5,), r"observation_options.*preview=\[0.02 \* k for k in range\(1, 26\)\]"),
        ("TipPose", "robust_predictive", 0.03, (0.02, 0.04, 0.06, 0.08, 0.12, 0.14, 0.16, 0.18), "up to 0.18 s"),
        ("Shape", "predictive", 0.0, (0.1, 0.2), r"preview=\[0.02 \* k for k in range\(1, 8\)\]"),
        ("Shape", "feedforward", 0.0, (0.02,), "'feedforward' needs it at every control period up to 0.04 s"),
        ("TipPose", "tracking", 0.05, (0.02, 0.04, 0.08), "'tracking' needs it at every control period up to 0.1 s"),
        ("TipPose", "tracking", 0.05, (0.02, 0.04, 0.1), None),
        ("TipPose", "tracking", 0.0, (0.1, 0.2), None),  # goes straight in between, which feedback makes up for
        ("Reach", "predictive", 0.0, (0.02,), None),  # goals do not move
    ],
)
def test_a_preview_that_lacks_what_a_controller_looks_at_is_refused(short, task, controller, latency, preview, told):
    env = short("single", IDS[task], preview=preview)
    if told is None:
        make_policy(controller, env, latency=latency)
    else:
        with pytest.raises(ConfigurationError, match=told):
            make_policy(controller, env, latency=latency)
