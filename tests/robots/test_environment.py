"""A robot has the environment's spaces: a simulated one moves as the arm of an environment with its errors."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import RobotEnv, SimulatedRobot
from soft_tendon_env.tools.configuration import ConfigurationError

ELASTIC = {"scene": "three_tendon", "effects.tendon_elasticity": {"stiffness": 1e4, "displacement_limits": [-0.01, 0.02]}}
LATE = {"scene": "three_tendon", "effects.actuators": {"time_constant": 0.02, "delay": 0.04}}


def play_episode(env, seed=3, steps=40):
    """Observations and errors of position of an episode with random actions."""
    first, info = env.reset(seed=seed)
    found = [(first, info["position_error"])]
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (steps, 3)):
        observation, _, terminated, truncated, info = env.step(action)
        assert not (terminated or truncated)
        found.append((observation, info["position_error"]))
    env.close()
    return found


@pytest.mark.cases(
    "scene, drawn, task",
    [
        ("three_tendon", {"stiffness": 0.8, "payload": 0.01, "tension_gain": 1.1, "latency": 0.033}, "TipPose"),
        (ELASTIC, {"latency": 0.02}, "TipPose"),
        (LATE, {"latency": 0.02}, "Reach"),
    ],
)
def test_a_simulated_robot_moves_as_the_arm_of_an_environment(scene, drawn, task):
    options = {"scene": scene, "fidelity": "fast", "observation": "measurable", "sensors": 3, "history": 2}
    alike = gym.make(f"TendonRod-{task}-v1", **options, randomize=drawn)
    robot = SimulatedRobot(scene=scene, fidelity="fast", sensors=3, randomize=drawn, real_time=False)
    real = RobotEnv(gym.make(f"TendonRod-{task}-v1", **options), robot, settle=0.0)
    assert real.observation_space == alike.observation_space and real.action_space == alike.action_space
    for (expected, error), (found, distance) in zip(play_episode(alike), play_episode(real), strict=True):
        expected, found = (flat["observation"] if isinstance(flat, dict) else flat for flat in (expected, found))
        np.testing.assert_allclose(found, expected, atol=1e-6)
        assert distance == pytest.approx(error, abs=1e-9)
    assert real.stopped.slack and not real.stopped.failures


def test_lengths_and_strains_count_from_the_arm_at_rest(arm_of_test, drawing):
    env = RobotEnv(drawing(), arm_of_test())  # whose lengths are 0.1, 0.2, 0.3 m, from anywhere
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(env.unwrapped.episodes.layout.values(observation[None])["tendon_lengths"], 0.0, atol=1e-12)
    rest = env.unwrapped.episodes.model.tendon_lengths(np.zeros(env.unwrapped.episodes.model.coordinate_count))
    np.testing.assert_allclose(env.zero["tendon_length"], rest - [0.1, 0.2, 0.3], atol=1e-9)
    env.close()


def test_a_robot_that_was_stopped_truncates_and_begins_again(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(3))
    first, _ = env.reset(seed=0)
    env.stop("somebody pressed the button")
    observation, reward, terminated, truncated, info = env.step(np.ones(3))
    assert (reward, terminated, truncated, info["stopped"]) == (0.0, False, True, "somebody pressed the button")
    assert (observation == first).all() and arm.is_slack
    env.reset(seed=0)
    assert not env.step(np.ones(3))[3] and not arm.is_slack
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        env.reset()


@pytest.mark.cases(
    "options, changes, message",
    [
        ({"observation": "full"}, {}, "without q (coordinates), q_dot (rates), tip_twist (tip_twist), which is observed. Controllers"),
        ({}, {"senses": ("tendon_length",)}, "without tip_pose (the errors of the task)"),
        ({}, {"command_unit": "m"}, "which takes 'm', and the scene's arm takes 'N'"),
        ({"randomize": {"stiffness": 0.9}}, {}, "the option randomize should have no more than the noise"),
        ({"tip_speed_limit": 3.0}, {}, "without tip_twist (the option tip_speed_limit)"),
    ],
)
def test_what_does_not_fit_is_said(options, changes, message, arm_of_test, drawing):
    robot = arm_of_test()
    for name, value in changes.items():
        setattr(robot, name, value)
    with pytest.raises(ConfigurationError) as error:
        RobotEnv(drawing(**options), robot)
    assert "environment: robot is Arm, " in str(error.value) and message in str(error.value)


def test_robots_begin_at_rest_and_are_not_copied(arm_of_test, drawing):
    env = RobotEnv(drawing(), arm_of_test())
    env.reset(seed=0)
    with pytest.raises(ConfigurationError, match="should have no state: robots begin at rest"):
        env.reset(options={"state": env.unwrapped.state})
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="an environment whose arm is a robot cannot be copied: there is one robot"):
            copied(env)
    env.close()
