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

from soft_tendon_env.robots import Measurement, RobotEnv, RobotStopped, run_policy, safety
from soft_tendon_env.robots.safety import Clock, Pacer

SOON = 0.1
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
            at(8, lambda: signal.raise_signal(signal.SIGTSTP)),
            KeyboardInterrupt,
            "interrupted",
            7,
        ),
    ],
)
def test_every_end_lets_the_tendons_go(
    faults, then, raised, cause, sent, arm_of_test, drawing, pulling, columns_of_log, tmp_path
):
    arm, before = (
        arm_of_test(**faults),
        [signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)],
    )
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
    np.testing.assert_allclose(log["time"], 0.02 * np.arange(sent), atol=1e-9)
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
from soft_tendon_env.robots import Measurement, RobotEnv, safety
safety.TRYING = 30.0  # as a busy machine may need
class Arm:
    command_unit, senses = "N", ("tip_pose",)
    def read(self): return Measurement(time.perf_counter(), tip_pose=np.eye(4))
    def write(self, command): print(command.max(), flush=True)
    def close(self): pass
options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_position"]}
env = gymnasium.make("TendonRod-Reach-v0", **options)
env = RobotEnv(env, Arm(), settle=0.0, patience=30_000)
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
        (
            measurement_of_a_tip(at=(180.0, 90.0, 0.0)),
            "puts the tip 201 m from the base, and the arm reaches 0.375 m: is it in m",
        ),
        (
            measurement_of_a_tip()._replace(time="12:30"),
            "measurement.time should be a finite number of seconds",
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


def test_what_write_cannot_return_stops_the_robot(arm_of_test, drawing, pulling):
    arm = arm_of_test()
    arm.write = lambda command, write=arm.write: (write(command), [2000, 3000, 3000])[1]
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


def test_a_late_period_does_not_move_the_next_deadlines():
    clock = Clock(real=False)
    pacer, begun = Pacer(clock, 0.02), []
    for busy in (0.005, 0.05, 0.001, 0.001, 0.001):  # the second one takes two and a half periods
        clock.wait_until(clock.now() + busy)
        pacer.wait()
        begun.append(clock.now())
    np.testing.assert_allclose(begun, [0.02, 0.07, 0.071, 0.08, 0.1], atol=1e-12)
    timing = pacer.timing
    assert (timing.periods, timing.overruns) == (5, 2)
    assert timing.worst == pytest.approx(0.03)
    assert timing.p50 == pytest.approx(0.0, abs=1e-12)
