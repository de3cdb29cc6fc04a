"""Episodes of a robot begin at rest, which is measured: noise is no motion, and an arm that goes on to move is stopped with the reason."""

import numpy as np
import pytest

from soft_tendon_env.robots import Measurement, RobotEnv, RobotStopped
from soft_tendon_env.robots.environment import REST_SPEED, speed_of

LENGTH = 0.3


def noise(deviation):
    random = np.random.default_rng(0)
    return lambda time: random.normal(scale=deviation, size=3)


def swing(amplitude, frequency=1.0):
    return lambda time: np.array([0.0, amplitude * LENGTH * np.sin(2.0 * np.pi * frequency * time), 0.0])


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


@pytest.mark.cases(
    "motion, rest, seconds",
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


@pytest.mark.cases(
    "motion, rest, message",
    [
        (swing(0.01), REST_SPEED, r"its tip moves at 0\.0132 m/s, 60 s after the first command"),
        (both(swing(0.01), noise(2e-3)), REST_SPEED, r"at rest it is at most 0\.0015 m/s\. Allow more"),
        (lambda time: np.array([0.0, 0.01 * LENGTH * time, 0.0]), REST_SPEED, r"moves at 0\.00299 m/s"),
    ],
)
def test_an_arm_that_does_not_rest_is_let_go(motion, rest, message, arm_of_test, drawing):
    arm = moving(arm_of_test(), motion)
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, rest_speed=rest)
    with pytest.raises(RobotStopped, match=f"the arm does not come to rest: .*{message}"):
        env.reset(seed=0)
    assert arm.is_slack and env.stopped.slack
    env.close()


def test_an_arm_that_has_moved_is_waited_for_whatever_settle_says(arm_of_test, drawing):
    arm = moving(arm_of_test(), lambda time: swing(0.05)(min(time, 4.0)))
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)  # it is there, by the user's word
    assert arm.clock.now() == 0.0
    env.step(np.ones(3))
    env.reset(seed=0)
    assert 6.2 <= arm.clock.now() <= 6.6 and env.zero == {}
    env.close()


def test_a_slow_rate_is_no_rest_before_the_pretension(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.1, rate=0.1)
    env.reset(seed=0)
    assert arm.clock.now() == pytest.approx(7.2, abs=0.05) and arm.sent[-1][1] == pytest.approx([0.5, 0.5, 0.5])
    env.close()


def test_motion_is_told_from_noise():
    """A drift has its own speed, a swing 2 pi f A / sqrt(2)."""
    time = 0.01 * np.arange(400)
    for motion, expected in ((0.3 * time, 0.3), (0.02 * np.sin(4.0 * np.pi * time), 0.08 * np.pi / np.sqrt(2.0))):
        position = np.stack([motion, 0.0 * time, np.full_like(time, 7.0)], axis=1)
        assert speed_of(position, 0.01) == pytest.approx(expected, rel=0.01)
        noisy = position + np.random.default_rng(1).normal(scale=1e-3, size=position.shape)
        assert speed_of(noisy, 0.01) == pytest.approx(expected, rel=0.03)
