"""A robot has the environment's spaces, a simulated one moves as the arm of an environment, and
episodes begin at rest."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import Measurement, RobotEnv, RobotStopped, SimulatedRobot
from soft_tendon_env.robots.environment import REST_SPEED, speed_of
from soft_tendon_env.tools.configuration import ConfigurationError

ELASTIC = {
    "scene": "three_tendon",
    "effects.tendon_elasticity": {"stiffness": 1e4, "displacement_limits": [-0.01, 0.02]},
}
LATE = {"scene": "three_tendon", "effects.actuators": {"time_constant": 0.02, "delay": 0.04}}
LENGTH = 0.3


def play_episode(env, seed=3, steps=40):
    """Observations and errors of position of an episode with random actions."""
    first, info = env.reset(seed=seed)
    found = [(first, info["position_error"])]
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (steps, 3)):
        observation, _, terminated, truncated, info = env.step(action)
        assert not terminated
        assert not truncated
        found.append((observation, info["position_error"]))
    env.close()
    return found


@pytest.mark.parametrize(
    ("scene", "drawn", "task"),
    [
        (
            "three_tendon",
            {"stiffness": 0.8, "payload": 0.01, "tension_gain": 1.1, "latency": 0.033},
            "TipPose",
        ),
        (ELASTIC, {"latency": 0.02}, "TipPose"),
        (LATE, {"latency": 0.02}, "Reach"),
    ],
)
def test_a_simulated_robot_moves_as_the_arm_of_an_environment(scene, drawn, task):
    options = {
        "scene": scene,
        "fidelity": "fast",
        "observation": "measurable",
        "sensors": 3,
        "history": 2,
    }
    alike = gym.make(f"TendonRod-{task}-v0", **options, randomize=drawn)
    robot = SimulatedRobot(
        scene=scene, fidelity="fast", sensors=3, randomize=drawn, real_time=False
    )
    real = RobotEnv(gym.make(f"TendonRod-{task}-v0", **options), robot, settle=0.0)
    assert real.observation_space == alike.observation_space
    assert real.action_space == alike.action_space
    for (expected, error), (found, distance) in zip(
        play_episode(alike), play_episode(real), strict=True
    ):
        expected, found = (
            flat["observation"] if isinstance(flat, dict) else flat for flat in (expected, found)
        )
        np.testing.assert_allclose(found, expected, atol=1e-6)
        assert distance == pytest.approx(error, abs=1e-9)
    assert real.stopped.slack
    assert not real.stopped.failures


def test_lengths_and_strains_count_from_the_arm_at_rest(arm_of_test, drawing):
    env = RobotEnv(drawing(), arm_of_test())  # whose lengths are 0.1, 0.2, 0.3 m, from anywhere
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(
        env.unwrapped.episodes.layout.values(observation[None])["tendon_lengths"], 0.0, atol=1e-12
    )
    rest = env.unwrapped.episodes.model.tendon_lengths(
        np.zeros(env.unwrapped.episodes.model.coordinate_count)
    )
    expected_tendon_length = rest - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(env.zero["tendon_length"], expected_tendon_length, atol=1e-9)
    env.close()


def test_a_robot_that_was_stopped_truncates_and_begins_again(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros(3))
    first, _ = env.reset(seed=0)
    env.stop("somebody pressed the button")
    observation, reward, terminated, truncated, info = env.step(np.ones(3))
    assert (reward, terminated, truncated, info["stopped"]) == (
        0.0,
        False,
        True,
        "somebody pressed the button",
    )
    assert (observation == first).all()
    assert arm.is_slack
    env.reset(seed=0)
    assert not env.step(np.ones(3))[3]
    assert not arm.is_slack
    env.close()
    with pytest.raises(gym.error.ClosedEnvironmentError):
        env.reset()


@pytest.mark.parametrize(
    ("options", "changes", "message"),
    [
        (
            {"observation": "full"},
            {},
            (
                "without q (coordinates), q_dot (rates), tip_twist (tip_twist), which is observed:"
                " take it out"
            ),
        ),
        (
            {},
            {"senses": ("tendon_length",)},
            "without tip_pose (the errors of the task): every run needs a tracker",
        ),
        (
            {"observation": ["coordinates", "tip_position", "tip_rotation", "preview"]},
            {},
            (
                "--set \"observation=['tip_position','tip_rotation','preview']\". No sensor"
                " measures coordinates: a controller NAME runs as filtered:NAME"
            ),
        ),
        (
            {"observation": ["tip_position", "tendon_lengths", "strain"], "sensors": 2},
            {},
            (
                "without strain (strain), which is observed: take it out, by --set"
                " \"observation=['tip_position','tendon_lengths']\""
            ),
        ),
        ({}, {"command_unit": "m"}, "which takes 'm', and the scene's arm takes 'N'"),
        (
            {"randomize": {"stiffness": 0.9}},
            {},
            "the option randomize should have no more than the noise",
        ),
        (
            {"tip_speed_limit": 3.0},
            {},
            "without tip_twist (the option tip_speed_limit): leave that option out",
        ),
    ],
)
def test_what_does_not_fit_is_said(options, changes, message, arm_of_test, drawing):
    robot = arm_of_test()
    for name, value in changes.items():
        setattr(robot, name, value)
    with pytest.raises(ConfigurationError) as error:
        RobotEnv(drawing(**options), robot)
    assert "environment: robot is Arm, " in str(error.value)
    assert message in str(error.value)


def test_robots_begin_at_rest_and_are_not_copied(arm_of_test, drawing):
    env = RobotEnv(drawing(), arm_of_test())
    env.reset(seed=0)
    with pytest.raises(ConfigurationError, match="should have no state: robots begin at rest"):
        env.reset(options={"state": env.unwrapped.state})
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(
            TypeError,
            match="an environment whose arm is a robot cannot be copied: there is one robot",
        ):
            copied(env)
    env.close()


def noise(deviation):
    random = np.random.default_rng(0)
    return lambda time: random.normal(scale=deviation, size=3)


def swing(amplitude, frequency=1.0):
    return lambda time: np.array(
        [0.0, amplitude * LENGTH * np.sin(2.0 * np.pi * frequency * time), 0.0]
    )


def both(*motions):
    return lambda time: sum(motion(time) for motion in motions)


def moving(arm, motion):
    """The arm with a tip that moves as a function of time says, in m."""

    def read():
        pose = np.eye(4)
        pose[:3, 3] = motion(arm.clock.now()) + [LENGTH, 0.0, 0.0]
        return Measurement(arm.clock.now(), tip_pose=pose, tendon_length=np.zeros(3))

    arm.read = read
    return arm


@pytest.mark.parametrize(
    ("motion", "rest", "seconds"),
    [
        (noise(3e-3), REST_SPEED, 3.2),
        (noise([0.0, 0.0, 2e-3]), REST_SPEED, 3.2),  # of a camera, along its axis
        (swing(5e-4), REST_SPEED, 3.2),  # 0.0022 of the length per second
        (swing(0.01), 0.05, 3.2),
        (lambda time: swing(0.05)(min(time, 7.0)), REST_SPEED, 9.2),
        (lambda time: 0.05 * np.exp(-time) * np.ones(3), REST_SPEED, 5.6),
    ],
)
def test_rest_is_found_in_noise(motion, rest, seconds, arm_of_test, drawing):
    arm = moving(arm_of_test(), motion)
    env = RobotEnv(drawing(), arm, rest_speed=rest)
    env.reset(seed=0)
    assert arm.clock.now() == pytest.approx(seconds, abs=0.21)
    env.close()


@pytest.mark.parametrize(
    ("motion", "rest", "message"),
    [
        (swing(0.01), REST_SPEED, r"its tip moves at 0\.0132 m/s, 60 s after the first command"),
        (
            both(swing(0.01), noise(2e-3)),
            REST_SPEED,
            r"at rest it is at most 0\.0015 m/s\. Allow more",
        ),
        (
            lambda time: np.array([0.0, 0.01 * LENGTH * time, 0.0]),
            REST_SPEED,
            r"moves at 0\.00299 m/s",
        ),
    ],
)
def test_an_arm_that_does_not_rest_is_let_go(motion, rest, message, arm_of_test, drawing):
    arm = moving(arm_of_test(), motion)
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, rest_speed=rest)
    with pytest.raises(RobotStopped, match=f"the arm does not come to rest: .*{message}"):
        env.reset(seed=0)
    assert arm.is_slack
    assert env.stopped.slack
    env.close()


def test_an_arm_that_has_moved_is_waited_for_whatever_settle_says(arm_of_test, drawing):
    arm = moving(arm_of_test(), lambda time: swing(0.05)(min(time, 4.0)))
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)  # it is there, by the user's word
    assert arm.clock.now() == 0.0
    env.step(np.ones(3))
    env.reset(seed=0)
    assert 6.2 <= arm.clock.now() <= 6.6
    assert env.zero == {}
    env.close()


def test_a_slow_rate_is_no_rest_before_the_pretension(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.1, rate=0.1)
    env.reset(seed=0)
    assert arm.clock.now() == pytest.approx(7.2, abs=0.05)
    assert arm.sent[-1][1] == pytest.approx([0.5, 0.5, 0.5])
    env.close()


def test_the_first_command_is_reached_evenly_from_slack(arm_of_test, drawing):
    """Displacements rise from the least one, where tendons are let out, to that of rest."""
    arm = arm_of_test()
    arm.command_unit = "m"
    env = RobotEnv(drawing(scene=ELASTIC, action="tension"), arm, settle=0.1, rate=0.05)
    env.reset(seed=0)
    slack = np.array([-0.01, -0.01, -0.01])
    rest = env.unwrapped.episodes.start_command
    sent = np.array([command for _, command in arm.sent])
    np.testing.assert_allclose(sent[-1], rest, atol=1e-12)
    changes = np.diff(sent, axis=0)
    rising = changes[changes[:, 0] > 1e-12]
    assert len(rising) > 5
    expected_rising = rising[0] * np.ones((len(rising), 1))
    np.testing.assert_allclose(rising, expected_rising, atol=1e-12)
    expected_sent = slack + rising[0]
    np.testing.assert_allclose(sent[0], expected_sent, atol=1e-12)
    env.close()


def test_motion_is_told_from_noise():
    """A drift has its own speed, a swing 2 pi f A / sqrt(2)."""
    time = 0.01 * np.arange(400)
    for motion, expected in (
        (0.3 * time, 0.3),
        (0.02 * np.sin(4.0 * np.pi * time), 0.08 * np.pi / np.sqrt(2.0)),
    ):
        position = np.stack([motion, 0.0 * time, np.full_like(time, 7.0)], axis=1)
        assert speed_of(position, 0.01) == pytest.approx(expected, rel=0.01)
        rng = np.random.default_rng(1)
        noisy = position + rng.normal(scale=1e-3, size=position.shape)
        assert speed_of(noisy, 0.01) == pytest.approx(expected, rel=0.03)
