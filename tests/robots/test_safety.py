"""Whatever ends a run, the tendons go slack within 100 ms, the robot is closed, and the log has every period until then."""

import signal
import threading

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import RobotEnv, RobotStopped, read_log, run_policy
from soft_tendon_env.robots.protocol import Measurement
from soft_tendon_env.robots.safety import RAMP

SOON = 0.1
"""Time [s] within which tendons should be slack."""
PULLS = np.array([0.5, -0.5, 0.0], dtype=np.float32)


class Pulling:
    """A policy that pulls, and does `then(count)` before it."""

    def __init__(self, then=lambda count: None):
        self.count, self.then = 0, then

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.count += 1
        self.then(self.count)
        return PULLS, None


def at(place, act):
    """What does something at a count, and ever after."""

    def fault(count):
        if count >= place:
            act()

    return fault


def lost():
    raise OSError(5, "Input/output error", "/dev/ttyUSB0")


def out_of_reach():
    raise ValueError("the target is out of reach")


def interrupt():
    signal.raise_signal(signal.SIGINT)


@pytest.mark.cases(
    "faults, policy, raised, cause, sent",
    [
        ({}, Pulling(), None, "the run ended", 30),
        ({"read": at(12, lost)}, Pulling(), None, "reading failed: OSError, /dev/ttyUSB0: Input/output error", 11),
        ({}, Pulling(at(8, out_of_reach)), ValueError, "ValueError, the target is out of reach", 7),
        ({}, Pulling(at(8, interrupt)), KeyboardInterrupt, "Ctrl-C", 7),
    ],
)
def test_every_end_lets_the_tendons_go(faults, policy, raised, cause, sent, arm_of_test, drawing, tmp_path):
    arm = arm_of_test(**faults)
    env = RobotEnv(drawing(), arm, settle=0.0, log=tmp_path / "run.csv")
    if raised is None:
        assert run_policy(policy, env, 0.6).stop is env.stopped
    else:
        with pytest.raises(raised):
            run_policy(policy, env, 0.6)
    assert_let_go(env.stopped, arm, cause)
    log = read_log(tmp_path / "run.csv")
    np.testing.assert_allclose(log.time, 0.02 * np.arange(sent), atol=1e-9)
    assert (log.sent == log.commanded).all() and (log.sent.max(axis=1) > 1.0).all()
    (tmp_path / "run.csv").unlink()


def assert_let_go(stop, arm, cause):
    assert cause in stop.cause and stop.slack and arm.is_slack and arm.closed
    assert stop.seconds <= SOON
    heights = np.array(stop.command).max(axis=1)
    assert len(heights) > 3 and (np.diff(heights) < 0.0).all()  # a ramp, and no blow


def test_a_port_that_is_lost_is_tried_again(arm_of_test, drawing):
    arm = arm_of_test(write=lambda count: lost() if 5 <= count < 9 else None)
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert "writing failed" in report.stop.cause and len(report.stop.failures) == 3
    assert report.stop.slack and report.stop.seconds <= SOON and arm.is_slack
    arm = arm_of_test(write=at(5, lost))
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert not report.stop.slack and not report.finished and report.stop.seconds <= SOON and arm.closed


@pytest.mark.cases("patience", [1, 3])
def test_measurements_that_are_not_new_are_no_readings(patience, arm_of_test, drawing):
    arm = arm_of_test()
    arm.read = lambda read=arm.read: read()._replace(time=min(arm.clock.now(), 0.2))  # a tracker that has lost sight
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0, patience=patience), 0.6)
    assert report.stop.cause == f"no reading for {20 * (patience + 1)} ms" and report.stop.slack and report.stop.seconds <= SOON
    assert report.timing.periods == 11 + patience


def test_a_loop_that_is_too_slow_is_stopped(arm_of_test, drawing, tmp_path):
    arm = arm_of_test()
    slow = Pulling(lambda count: arm.clock.wait_until(arm.clock.now() + 0.03))  # of periods of 0.02 s
    report = run_policy(slow, RobotEnv(drawing(), arm, settle=0.0, log=tmp_path / "run.csv"), 5.0)
    assert report.stop.cause == "the loop is 70 ms behind its deadlines" and report.stop.slack and report.stop.seconds <= SOON
    assert len(read_log(tmp_path / "run.csv").time) == report.timing.periods == report.timing.overruns == 7


class Ending(gym.Wrapper):
    """Ends episodes after five steps."""

    def step(self, action):
        observation, reward, terminated, _, info = self.env.step(action)
        return observation, reward, terminated, self.env.robot.counts["write"] >= 6, info


def test_a_run_is_not_cut_short_without_a_word(arm_of_test, drawing):
    arm = arm_of_test()
    with pytest.raises(ValueError, match=r"seconds: 60 s are 3000 control periods, and episodes end after 500: .*max_episode_steps=3000"):
        run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0), 60.0)
    assert arm.closed and not arm.sent
    arm = arm_of_test()
    report = run_policy(Pulling(), Ending(RobotEnv(drawing(), arm, settle=0.0)), 0.6)
    assert report.stop.cause == "the episode ended after 5 of 30 control periods" and not report.finished
    assert report.stop.slack and arm.closed and report.timing.periods == 5


@pytest.mark.parametrize("what", ["read", "write", "policy"])
def test_the_watchdog_lets_go_where_something_hangs(what, arm_of_test, drawing, gate):
    after_hanging = []

    def hang(count):
        if count == 10:
            gate.wait(20.0)
            after_hanging.append(count)

    arm = arm_of_test(real_time=True, **({} if what == "policy" else {what: hang}))
    env = RobotEnv(drawing(), arm, settle=0.0, patience=15)  # which a busy machine does not use up
    loop = threading.Thread(target=run_policy, args=(Pulling(hang if what == "policy" else lambda count: None), env, 5.0))
    loop.start()
    while not ((stop := env.stopped) and stop.slack and "no reading" in stop.cause):
        assert loop.is_alive()
    assert arm.is_slack and not after_hanging  # while it still hangs
    gate.set()
    loop.join()
    assert arm.is_slack and arm.closed and env.stopped is stop


@pytest.mark.cases(
    "measured, cause",
    [
        (Measurement(1.0, tip_pose=np.full((4, 4), np.nan), tendon_length=np.zeros(3)), "measurement.tip_pose should be finite"),
        (Measurement(1.0, tip_pose=np.eye(4), tendon_length=np.zeros(2)), "measurement.tendon_length should have shape (3,), not (2,)"),
        (Measurement(1.0, tip_pose=2.0 * np.eye(4), tendon_length=np.zeros(3)), "measurement.tip_pose should be a pose"),
        (Measurement(1.0, tip_pose=np.eye(4)), "measurement.tendon_length"),
        (None, "read should return a Measurement, not NoneType"),
    ],
)
def test_measurements_that_cannot_be_stop_the_robot(measured, cause, arm_of_test, drawing):
    arm = arm_of_test()
    arm.read = lambda: measured
    env = RobotEnv(drawing(), arm, settle=0.0)
    with pytest.raises(RobotStopped, match="reading failed") as stopped:
        env.reset()
    assert cause in str(stopped.value) and arm.is_slack
    env.close()


def test_commands_stay_within_limits_and_rate(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.4, rate=10.0)
    env.reset(seed=0)
    for _ in range(30):
        observation, *_ = env.step([1.0, -1.0, 5.0])
    sent = np.array([command for _, command in arm.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= 10.0 * 0.02 + 1e-12
    np.testing.assert_allclose(sent[-1], [3.0, 0.5, 3.0], atol=1e-12)
    values = env.unwrapped.episodes.layout.values(observation[None])
    np.testing.assert_allclose(values["command"][0], sent[-1], rtol=1e-6)
    env.close()
    assert arm.is_slack  # beneath the limits, which are for control


def test_a_dry_run_sends_nothing(arm_of_test, drawing, tmp_path):
    arm = arm_of_test()
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, log=tmp_path / "dry.csv", dry=True), 0.4)
    assert report.finished and not arm.sent and arm.counts["read"] > 20
    assert (read_log(tmp_path / "dry.csv").sent.max(axis=1) > 1.0).all()  # what would have been
    assert RAMP <= SOON
