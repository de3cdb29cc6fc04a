"""Limits hold for what is sent, whatever `write` returns; measurements that cannot be stop the robot."""

import re

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import Measurement, RobotEnv, RobotStopped, SimulatedRobot, read_log, run_policy

POSE = np.eye(4)
POSE[0, 3] = 0.3


class Pulling:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.array([0.5, -0.5, 0.0], dtype=np.float32), None


def posed(at=(0.3, 0.0, 0.0), turned=POSE[:3, :3], row=(0.0, 0.0, 0.0, 1.0), time=1.0):
    """Measurement of a tip."""
    pose = np.vstack([np.column_stack([turned, at]), row])
    return Measurement(time, tip_pose=pose, tendon_length=np.zeros(3))


@pytest.mark.cases(
    "measured, cause",
    [
        (Measurement(1.0, tip_pose=np.full((4, 4), np.nan), tendon_length=np.zeros(3)), "measurement.tip_pose should be finite"),
        (Measurement(1.0, tip_pose=np.eye(4), tendon_length=np.zeros(2)), "measurement.tendon_length should have shape (3,), not (2,)"),
        (posed(row=[0.1, 0.0, 0.2, 1.0]), "with a rotation R: its last row is [0.1, 0, 0.2, 1]"),
        (posed(turned=1.02 * np.eye(3)), "R R^T is off the identity by 0.0404"),
        (posed(turned=np.diag([1.0, -1.0, 1.0])), "R is mirrored"),
        (Measurement(1.0, tip_pose=POSE.T, tendon_length=np.zeros(3)), "its last row is [0.3, 0, 0, 1], it is transposed"),
        (posed(at=(180.0, 90.0, 0.0)), "puts the tip 201 m from the base, and the arm reaches 0.375 m: it seems to be in mm"),
        (posed(at=(20.0, -15.0, 0.0)), "puts the tip 25 m from the base, and the arm reaches 0.375 m: it seems to be in cm"),
        (posed(at=(0.3, 0.0, 0.4)), "puts the tip 0.5 m from the base, and the arm reaches 0.375 m: is it in the scene's world frame?"),
        (posed()._replace(time="12:30"), "measurement.time should be a finite number of seconds"),
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


@pytest.mark.cases(
    "frame, cause",
    [
        (lambda count: 12 - count % 2, r"no reading for [68]0 ms: times of measurements go back, by 1 s"),
        (lambda count: 5 if count > 12 else 12, r"no reading for [68]0 ms: times of measurements go back, by 7 s"),
        (lambda count: 12, r"no reading for [68]0 ms"),
    ],
)
def test_times_of_measurements_grow(frame, cause, arm_of_test, drawing):
    arm = arm_of_test()
    arm.read = lambda read=arm.read: read()._replace(time=min(arm.counts["read"], frame(arm.counts["read"])))
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert re.fullmatch(cause, report.stop.cause) and report.stop.slack and 13 <= report.timing.periods <= 16


@pytest.mark.cases("unit, taken", [(1.0, "0.02 s, and the arm can move 0.0"), (1e3, "0.04 s, and the arm can move 0.1"), (1e9, "0.04 s")])
def test_a_tip_that_jumps_stops_the_robot(unit, taken, arm_of_test, drawing):
    """Whatever the unit of the tracker's clock."""
    arm, other = arm_of_test(), posed(at=(0.05, 0.25, 0.0)).tip_pose
    arm.read = lambda read=arm.read: (own := read())._replace(time=unit * own.time, tip_pose=other if arm.counts["read"] == 9 else POSE)
    report = run_policy(Pulling(), RobotEnv(drawing(tension_limits=(0.0, 2.0)), arm, settle=0.0), 0.6)
    assert f"measurement.tip_pose jumps by 0.354 m in {taken}" in report.stop.cause
    assert report.stop.slack and report.timing.periods == 8


@pytest.mark.parametrize("scene", ["three_tendon", "helical", "four_tendon"])
def test_no_motion_of_an_arm_is_a_jump(scene):
    """From limit to limit at random, with the noise of a poor tracker; numbers as float32 and in lists."""
    arm = {"scene": scene, "fidelity": "fast"}
    robot = SimulatedRobot(**arm, real_time=False, randomize={"stiffness": 0.7, "noise": {"position": 2e-3, "rotation": 0.02}})
    robot.read = lambda read=robot.read: (lambda own: own._replace(tip_pose=own.tip_pose.astype(np.float32).tolist()))(read())
    env = RobotEnv(gym.make("TendonRod-Reach-v0", observation=["tip_position"], **arm), robot, settle=0.0)
    env.reset(seed=0)
    for action in np.random.default_rng(1).choice([-1.0, 1.0], (50, *env.action_space.shape)).repeat(4, axis=0):
        assert not env.step(action)[3], env.stopped
    env.close()


@pytest.mark.cases(
    "returned, kept",
    [
        (lambda command: 40.0 * command + 12.0, None),  # steps of motors
        (lambda command: 0.5 * np.round(command / 0.5), [0.5, 2.5, 3.0]),  # whole ones, in newtons
        (lambda command: None, None),
        (lambda command: [2000, 3000, 3000], None),
    ],
)
def test_what_write_returns_moves_no_limit(returned, kept, arm_of_test, drawing, tmp_path):
    arm = arm_of_test()
    arm.write = lambda command, write=arm.write: returned(write(command))
    env = RobotEnv(drawing(tension_limits=(0.0, 3.2)), arm, settle=0.0, rate=25.0, log=tmp_path / "run.csv")
    env.reset(seed=0)
    for _ in range(12):
        env.step([-0.6, 0.5, 1.0])
    sent = np.array([command for _, command in arm.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= 25.0 * 0.02 + 1e-12
    np.testing.assert_allclose(sent[-1], [0.64, 2.4, 3.2], atol=1e-12)
    env.close()
    np.testing.assert_allclose(read_log(tmp_path / "run.csv").sent[-1], sent[-1] if kept is None else kept)
    heights = np.array(env.stopped.command).max(axis=1)
    assert arm.is_slack and len(heights) == 6 and (np.diff(heights) < 0.0).all()  # a ramp down, from what was sent
    (tmp_path / "run.csv").unlink()


@pytest.mark.cases(
    "returned, message", [(np.zeros(2), "shape (3,), not (2,)"), (np.full(3, np.nan), "should be finite"), ("ok", "array of numbers")]
)
def test_what_write_cannot_return_stops_the_robot(returned, message, arm_of_test, drawing):
    arm = arm_of_test()
    arm.write = lambda command, write=arm.write: (write(command), returned)[1]
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert message in report.stop.cause and report.stop.slack and arm.is_slack


def test_commands_stay_within_limits_and_rate(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.4, rate=10.0)
    env.reset(seed=0)
    np.testing.assert_allclose([command[0] for _, command in arm.sent[:22]], np.minimum(np.arange(1, 23) / 40.0, 0.5))  # evenly from slack
    for _ in range(30):
        observation, *_ = env.step([1.0, -1.0, 5.0])
    sent = np.array([command for _, command in arm.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= 10.0 * 0.02 + 1e-12
    np.testing.assert_allclose(sent[-1], [3.0, 0.5, 3.0], atol=1e-12)
    values = env.unwrapped.episodes.layout.values(observation[None])
    np.testing.assert_allclose(values["command"][0], sent[-1], rtol=1e-6)
    env.close()
    assert arm.is_slack  # beneath the limits, which are for control
