"""Whatever ends a run, the tendons go slack within 100 ms, the robot is closed, and the log has
every period until then; limits hold."""

import os
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from soft_tendon_env import simulate
from soft_tendon_env.robots import (
    Measurement,
    MeasurementWarning,
    RobotEnv,
    RobotStopped,
    run_policy,
    safety,
)
from soft_tendon_env.robots import clock as clock_module
from soft_tendon_env.robots.clock import Clock, Pacer
from soft_tendon_env.robots.freshness import Freshness
from soft_tendon_env.robots.top_speed import top_speed

SOON = 0.03
"""Time [s] within which tendons should be slack."""


def at(place, act):
    """What does something at a count, and ever after."""
    return lambda count: act() if count >= place else None


def lost():
    raise OSError(5, "Input/output error", "/dev/ttyUSB0")


def out_of_reach():
    raise ValueError("the target is out of reach")


@pytest.mark.parametrize(
    ("faults", "then", "raised", "cause", "sent"),
    [
        ({}, at(99, lost), None, "the run ended", 30),
        (
            {"read": at(12, lost)},
            at(99, lost),
            None,
            "reading failed: OSError, /dev/ttyUSB0: Input/output error",
            11,
        ),
        ({}, at(8, out_of_reach), ValueError, "ValueError, the target is out of reach", 7),
        (
            {},
            at(8, lambda: signal.raise_signal(signal.SIGINT)),
            KeyboardInterrupt,
            "interrupted",
            7,
        ),
        (
            {},
            at(8, lambda: signal.raise_signal(signal.SIGTERM)),
            KeyboardInterrupt,
            "interrupted",
            7,
        ),
        (
            {},
            at(8, lambda: signal.raise_signal(signal.SIGUSR1)),
            KeyboardInterrupt,
            "interrupted by SIGUSR1",
            7,
        ),
    ],
)
def test_every_end_lets_the_tendons_go(
    faults, then, raised, cause, sent, arm_of_test, drawing, pulling, columns_of_log, tmp_path
):
    arm = arm_of_test(**faults)
    before = [signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)]
    env = RobotEnv(drawing(), arm, settle=0.0, log=tmp_path / "run.csv")
    if raised is None:
        assert run_policy(pulling(then), env, 0.6).stop is env.stopped
    else:
        with pytest.raises(raised):
            run_policy(pulling(then), env, 0.6)
    assert cause in env.stopped.cause
    assert env.stopped.slack
    assert arm.is_slack
    assert arm.closed
    assert env.stopped.seconds <= SOON
    heights = np.array([command.max() for _, command in arm.sent[-6:]])
    assert (np.diff(heights) < 0.0).all()  # a ramp, and no blow
    log = columns_of_log(tmp_path / "run.csv")
    expected_time = 0.02 * np.arange(sent)
    np.testing.assert_allclose(log["time"], expected_time, atol=1e-9)
    assert (log["tension_0"] == log["commanded_0"]).all()
    assert (log["tension_0"] > 1.0).all()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    for number, handler in zip((signal.SIGTERM, signal.SIGHUP), before, strict=True):
        signal.signal(number, handler)


def test_a_port_that_is_lost_is_tried_again(arm_of_test, drawing, pulling):
    arm = arm_of_test(write=lambda count: lost() if 5 <= count < 9 else None)
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert "writing failed" in report.stop.cause
    assert len(report.stop.failures) == 3
    assert report.stop.slack
    assert report.stop.seconds <= SOON
    assert arm.is_slack
    arm = arm_of_test(write=at(5, lost))
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert not report.stop.slack
    assert not report.finished
    assert arm.closed
    assert safety.TRYING - SOON <= report.stop.seconds <= safety.TRYING + SOON


def test_a_robot_that_cannot_be_closed_is_told(arm_of_test, drawing, pulling):
    arm = arm_of_test()

    def close():
        raise OSError(5, "Input/output error", "/dev/ttyUSB0")

    arm.close = close
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.2)
    assert report.stop.slack
    assert report.stop.failures == ["OSError, /dev/ttyUSB0: Input/output error"]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_every_later_stop_tries_again(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)
    env.step(np.ones(3))
    arm.faults["write"] = at(0, lost)
    assert not env.stop("somebody pressed the button").slack
    del arm.faults["write"]
    env.close()
    assert arm.is_slack
    assert env.stopped.slack
    assert env.stopped.cause == "somebody pressed the button"


def test_measurements_that_are_not_new_are_no_readings(arm_of_test, drawing, pulling):
    arm = arm_of_test()
    arm.read = lambda read=arm.read: read()._replace(
        time=min(arm.clock.now(), 0.2)
    )  # a tracker that has lost sight
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0, patience=1), 0.6)
    assert report.stop.cause == "no reading for 40 ms: patience is 1 control periods of 20 ms"
    assert report.stop.slack
    assert report.stop.seconds <= SOON
    assert report.timing.periods == 12


def test_a_loop_that_is_too_slow_is_stopped(arm_of_test, drawing, pulling):
    arm = arm_of_test()
    slow = pulling(
        lambda count: arm.clock.wait_until(arm.clock.now() + 0.03)
    )  # of periods of 0.02 s
    report = run_policy(slow, RobotEnv(drawing(), arm, settle=0.0), 5.0)
    assert (
        report.stop.cause
        == "the loop is 70 ms behind its deadlines: patience is 3 control periods of 20 ms"
    )
    assert report.stop.slack
    assert report.stop.seconds <= SOON
    assert report.timing.periods == report.timing.overruns == 7


def test_a_run_is_not_cut_short_without_a_word(arm_of_test, drawing, pulling):
    arm = arm_of_test()
    with pytest.raises(
        ValueError,
        match=(
            r"seconds: 60 s are 3000 control periods, and episodes end after 500:"
            r" .*max_episode_steps=3000"
        ),
    ):
        run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 60.0)
    assert arm.closed
    assert not arm.sent


@pytest.mark.parametrize("what", ["read", "write", "policy"])
def test_the_watchdog_lets_go_where_something_hangs(
    what, arm_of_test, drawing, pulling, wait_until
):
    gate = threading.Event()

    def hang(count):
        if count == 10:
            arm.clock.wait_until(arm.clock.now() + 0.08)  # longer than three periods of 0.02 s
            gate.wait()

    arm = arm_of_test(is_watched=True, **({} if what == "policy" else {what: hang}))
    env = RobotEnv(drawing(), arm, settle=0.0)
    policy = pulling(hang if what == "policy" else lambda count: None)
    loop = threading.Thread(target=run_policy, args=(policy, env, 5.0), daemon=True)
    loop.start()
    wait_until(lambda: env.stopped and env.stopped.slack and "no reading" in env.stopped.cause)
    assert arm.is_slack
    assert loop.is_alive()
    gate.set()
    wait_until(lambda: not loop.is_alive())
    assert arm.closed
    assert arm.is_slack


CHILD = """
import sys, time, gymnasium, numpy as np
from soft_tendon_env.robots import Measurement, RobotEnv, safety, slack
safety.TRYING = slack.TRYING = 30.0  # as a busy machine may need
class Arm:
    command_unit, senses = "N", ("tip_pose",)
    def read(self): return Measurement(time.perf_counter(), tip_pose=np.eye(4))
    def write(self, command): print(command.max(), flush=True)
    def close(self): pass
options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_position"]}
env = gymnasium.make("TendonRod-Reach-v0", **options)
env = RobotEnv(env, Arm(), settle=0.0, patience=100_000)
env.reset(seed=0)
for _ in range(20): env.step(np.ones(3))
raise ValueError("and nothing is closed")
"""


@pytest.mark.slow
def test_the_end_of_the_interpreter_lets_go():
    ended = subprocess.run(
        [sys.executable, "-c", CHILD],
        capture_output=True,
        text=True,
        env={**os.environ},
    )
    assert "and nothing is closed" in ended.stderr
    assert [float(line) for line in ended.stdout.splitlines() if re.fullmatch(r"[0-9.]+", line)][
        -1
    ] == 0.0


def measurement_of_a_tip(at=(0.3, 0.0, 0.0), turned=(1.0, 1.0, 1.0), row=(0.0, 0.0, 0.0, 1.0)):
    """Measurement of a tip."""
    return Measurement(
        1.0,
        tip_pose=np.vstack([np.column_stack([np.diag(turned), at]), row]),
        tendon_length=np.zeros(3),
    )


@pytest.mark.parametrize(
    ("measured", "cause"),
    [
        (
            Measurement(1.0, tip_pose=np.full((4, 4), np.nan), tendon_length=np.zeros(3)),
            "measurement.tip_pose should be finite",
        ),
        (
            Measurement(1.0, tip_pose=np.eye(4), tendon_length=np.zeros(2)),
            "measurement.tendon_length should have shape (3,), not (2,)",
        ),
        (
            measurement_of_a_tip(row=[0.1, 0.0, 0.2, 1.0]),
            "is no pose [[R, r], [0, 0, 0, 1]] with a rotation R, by 0.2",
        ),
        (measurement_of_a_tip(turned=[1.0, -1.0, 1.0]), "by 2"),
        # orthogonal axes, one of them too long: 1.1^2 - 1
        (measurement_of_a_tip(turned=[1.0, 1.1, 1.0]), "by 0.21"),
        (
            measurement_of_a_tip(at=(180.0, 90.0, 0.0)),
            "puts the tip 201 m from the base, and the arm reaches 0.375 m: is it in m",
        ),
        (measurement_of_a_tip(at=(0.0, 0.38, 0.0)), "puts the tip 0.38 m from the base"),
        (
            measurement_of_a_tip()._replace(time="12:30"),
            "measurement.time should be a finite number of seconds",
        ),
        (
            measurement_of_a_tip()._replace(tip_time=np.nan),
            "measurement.tip_time should be a finite number of seconds",
        ),
    ],
)
def test_measurements_that_cannot_be_stop_the_robot(measured, cause, arm_of_test, drawing):
    arm = arm_of_test()
    arm.read = lambda: measured
    env = RobotEnv(drawing(), arm, settle=0.0)
    with pytest.raises(RobotStopped, match="reading failed") as stopped:
        env.reset()
    assert cause in str(stopped.value)
    assert arm.is_slack
    env.close()


@pytest.mark.parametrize(
    ("answer", "is_refused"),
    [
        ([2000, 3000, 3000], True),
        ([5.6, 0.0, 0.0], True),  # a tenth of the range, 5 N, may be rounding
        ([5.4, 0.0, 0.0], False),
        ([0.0, -0.4, 1.0], False),
        ([1.0, -0.6, 1.0], True),
    ],
)
def test_what_write_cannot_return_stops_the_robot(
    answer, is_refused, arm_of_test, drawing, pulling
):
    arm = arm_of_test()
    arm.write = lambda command, write=arm.write: (write(command), answer)[1]
    if not is_refused:
        report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.2)
        assert report.finished
        return
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 0.6)
    assert "it should be what was sent, in N, or nothing" in report.stop.cause
    assert report.stop.slack
    assert arm.is_slack


@pytest.mark.parametrize(
    "rounds", [lambda command: 0.5 * np.round(command / 0.5), lambda command: None]
)
def test_commands_stay_within_limits_and_rate(rounds, arm_of_test, drawing):
    arm = arm_of_test()
    arm.write = lambda command, write=arm.write: rounds(write(command))
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.4, rate=10.0)
    env.reset(seed=0)
    np.testing.assert_allclose(
        [command[0] for _, command in arm.sent[:22]], np.minimum(np.arange(1, 23) / 40.0, 0.5)
    )  # evenly from slack
    for _ in range(30):
        observation, *_ = env.step([1.0, -1.0, 5.0])
    sent = np.array([command for _, command in arm.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= 10.0 * 0.02 + 1e-12
    np.testing.assert_allclose(sent[-1], [3.0, 0.5, 3.0], atol=1e-12)
    values = env.unwrapped.episodes.layout.values(observation[None])
    np.testing.assert_allclose(values["command"][0], sent[-1], rtol=1e-6)
    env.close()
    assert arm.is_slack  # beneath the limits, which are for control


@pytest.mark.parametrize("late", [0.013, 0.031, 0.055])
def test_a_rate_holds_per_second_also_after_a_late_period(late, arm_of_test, drawing, pulling):
    def work(count):
        if count in (6, 20):
            arm.clock.wait_until(arm.clock.now() + late)

    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0, rate=7.0)
    run_policy(pulling(work), env, 1.0)
    # until the stop, which goes to slack at once
    times = np.array([time for time, _ in arm.sent])
    tensions = np.array([command[0] for _, command in arm.sent])
    rises = slice(0, int(np.argmax(tensions)) + 1)
    first, last = np.triu_indices(len(tensions[rises]), k=1)
    change = tensions[last] - tensions[first]
    assert (change <= 7.0 * (times[last] - times[first]) + 1e-9).all()
    # and what can be changed is: 2.5 N take about 0.4 s
    assert tensions.max() == pytest.approx(3.75)
    assert times[np.argmax(tensions)] <= 3.75 / 7.0 + 2.0 * late + 0.05


def test_tendons_are_slack_before_another_episode_begins(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(tension_limits=(0.5, 3.0)), arm, settle=0.0)
    env.reset(seed=0)
    env.step(np.ones(3))
    pulled = len(arm.sent)
    arm.clock.wait_until(arm.clock.now() + 0.01)
    env.reset(seed=0)
    heights = [command.max() for _, command in arm.sent[pulled : pulled + 8]]
    assert heights[5] == 0.0
    assert (np.diff(heights[:6]) < 0.0).all()
    # a pause of any length between episodes is nobody's fault
    env.stop("a pause")
    arm.clock.wait_until(arm.clock.now() + 100.0)
    env.reset(seed=0)
    assert env.stopped is None
    env.close()


def test_real_time_is_slept_through_and_met(monkeypatch):
    """Sleeping ends a little before the deadline, since a process wakes late."""
    now = [5.0]
    slept = []

    def sleep(seconds):
        slept.append(seconds)
        now[0] += seconds + 2e-4

    def perf_counter():
        now[0] += 1e-5
        return now[0]

    monkeypatch.setattr(clock_module, "sleep", sleep)
    monkeypatch.setattr(clock_module, "perf_counter", perf_counter)
    real = Clock()
    real.wait_until(5.1)
    assert 5.1 <= now[0] <= 5.1 + 3e-5
    assert len(slept) == 1
    assert 0.0993 <= slept[0] <= 0.0996
    real.wait_until(5.05)  # is past
    assert now[0] <= 5.1 + 6e-5
    real.wait_until(now[0] + 4e-4)  # too short to sleep
    assert len(slept) == 1


def test_no_rate_is_no_limit(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)
    env.step(np.ones(3))
    np.testing.assert_allclose(arm.sent[-1][1], 5.0)
    env.close()


@pytest.mark.parametrize("frozen", ["time", "tip_time"])
def test_the_slowest_sensor_counts(frozen, arm_of_test, drawing, pulling):
    """Motors that answer on a clock of their own are no sign of a tracker that sees, and
    conversely."""
    arm = arm_of_test()

    def read(read=arm.read):
        now = arm.clock.now()
        times = {"time": 1000.0 + now, "tip_time": -5.0 + now}
        times[frozen] = times[frozen] - now + min(now, 0.3)
        return read()._replace(**times)

    arm.read = read
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 1.0)
    assert report.stop.cause == "no reading for 80 ms: patience is 3 control periods of 20 ms"
    assert report.timing.periods == 19
    assert report.stop.slack


def test_readings_of_two_sensors_are_joined(arm_of_test, drawing):
    """Each of them is as new as its own time says."""
    clock = Clock(real=False)
    readings = Freshness(clock)
    near = np.eye(4)
    far = np.diag([1.0, -1.0, -1.0, 1.0])
    readings.take(Measurement(5.0, near, tendon_length=np.zeros(3), tip_time=90.0), True)
    clock.wait_until(0.25)
    old_pose = Measurement(5.1, far, tendon_length=np.ones(3), tip_time=90.0)
    assert not readings.is_new_pose(old_pose)
    readings.take(old_pose, False)
    assert (readings.newest.tip_pose == near).all()
    assert (readings.newest.tendon_length == 1.0).all()
    assert readings.age == readings.age_of_pose == 0.25
    left_out = Measurement(5.05, far, tendon_length=np.zeros(3), tip_time=90.05)
    readings.take(left_out, False)
    assert (readings.newest.tip_pose == near).all()
    assert readings.age == 0.25
    assert readings.age_of_pose == 0.0
    clock.wait_until(0.5)
    new_pose = Measurement(5.1, far, tendon_length=np.zeros(3), tip_time=90.1)
    assert readings.is_new_pose(new_pose)
    readings.take(new_pose, True)
    assert (readings.newest.tip_pose == far).all()
    assert (readings.newest.tendon_length == 1.0).all()
    assert readings.newest.tip_time == 90.1
    assert readings.age == 0.25
    assert readings.age_of_pose == 0.0


def jumping(arm, place):
    """The arm, whose tip at a count of readings is `place(count)` m from where it was."""

    def read(read=arm.read):
        measured = read()
        pose = measured.tip_pose.copy()
        pose[1, 3] += place(arm.counts["read"])
        return measured._replace(tip_pose=pose)

    arm.read = read
    return arm


def test_one_jump_within_reach_is_left_out_and_told(arm_of_test, drawing):
    arm = jumping(arm_of_test(), lambda count: 0.2 if count in (8, 12) else 0.0)
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)
    places = []
    with pytest.warns(MeasurementWarning, match=r"jumps by 0\.2 m within 20 ms") as caught:
        for _ in range(15):
            observation, *_ = env.step(np.zeros(3))
            groups = env.unwrapped.episodes.layout.values(observation[None])
            places.append(groups["tip_position"][0, 1])
    assert len(caught) == 2
    np.testing.assert_allclose(places, 0.0, atol=1e-9)
    assert env.stopped is None
    env.close()


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_a_jump_is_more_than_noise_and_top_speed(share, arm_of_test, drawing, recwarn):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    top = top_speed(drawing().unwrapped.episodes)
    farthest = 0.1 * 0.3 + top * 0.02  # in a period of 20 ms
    jumping(arm, lambda count: share * farthest if count == 6 else 0.0)
    env.reset(seed=0)
    for _ in range(8):
        env.step(np.zeros(3))
    env.close()
    jumps = [warning for warning in recwarn if warning.category is MeasurementWarning]
    # there and back
    assert len(jumps) == (1 if share > 1.0 else 0)


@pytest.mark.filterwarnings("ignore::soft_tendon_env.robots.MeasurementWarning")
def test_jumps_twice_in_a_row_stop_the_robot(arm_of_test, drawing, pulling):
    arm = jumping(arm_of_test(), lambda count: 0.12 if count >= 8 else 0.0)
    report = run_policy(pulling(), RobotEnv(drawing(), arm, settle=0.0), 1.0)
    assert "measurement.tip_pose jumps by 0.12 m within 20 ms" in report.stop.cause
    assert report.stop.slack
    assert report.timing.periods == 8


def test_noise_and_motion_are_no_jumps(arm_of_test, drawing, recwarn):
    """A tip that swings as fast as a soft arm may, beside noise of 1 % of its length."""
    random = np.random.default_rng(0)
    place = lambda count: 0.1 * np.sin(0.3 * count) + random.normal(scale=0.003)  # noqa: E731
    arm = jumping(arm_of_test(), place)
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)
    for _ in range(60):
        env.step(np.zeros(3))
    assert env.stopped is None
    env.close()
    assert not [warning for warning in recwarn if warning.category is MeasurementWarning]


def test_the_top_speed_is_above_that_of_the_hardest_pulls(drawing):
    episodes = drawing().unwrapped.episodes
    greatest = top_speed(episodes)
    model = episodes.model
    fastest = 0.0
    for pulled in ([5.0, 0.0, 0.0], [5.0, 5.0, 0.0], [0.0, 0.0, 5.0]):
        # pulled for as long as the arm swings over, then let go
        command = np.zeros((150, 3))
        command[:75] = pulled
        motion = simulate(model, command, 1.5, 0.01)
        speeds = np.linalg.norm(np.diff(motion.tip_pose[:, :3, 3], axis=0), axis=1) / 0.01
        fastest = max(fastest, float(speeds.max()))
    assert 1.7 * fastest <= greatest <= 2.3 * fastest
    assert (episodes.arms.rows.q == episodes.starts.q).all(), "the arm was left at rest"
    weaker = drawing(tension_limits=(0.0, 1.0)).unwrapped.episodes
    assert top_speed(weaker) < 0.5 * greatest


def test_a_driver_with_a_watchdog_of_its_own_is_told(arm_of_test, drawing):
    watched = []
    arm = arm_of_test()
    arm.watch = lambda slack, patience: watched.append((slack.tolist(), patience))
    env = RobotEnv(drawing(), arm, settle=0.0, patience=4)
    env.reset(seed=0)
    assert watched == [([0.0, 0.0, 0.0], pytest.approx(0.08))]
    env.reset(seed=0)
    assert len(watched) == 2

    def fails(slack, patience):
        raise OSError("no watchdog")

    arm.watch = fails
    with pytest.raises(RobotStopped, match="the robot's own watchdog failed: OSError, no watchdog"):
        env.reset(seed=0)
    env.close()


def test_a_late_period_does_not_move_the_next_deadlines():
    clock = Clock(real=False)
    pacer = Pacer(clock, 0.02)
    begun = []
    for busy in (0.005, 0.05, 0.001, 0.001, 0.001):  # the second one takes two and a half periods
        clock.wait_until(clock.now() + busy)
        pacer.wait()
        begun.append(clock.now())
    np.testing.assert_allclose(begun, [0.02, 0.07, 0.071, 0.08, 0.1], atol=1e-12)
    timing = pacer.timing
    assert (timing.periods, timing.overruns) == (5, 2)
    assert timing.worst == pytest.approx(0.03)
    assert timing.p50 == pytest.approx(0.0, abs=1e-12)
