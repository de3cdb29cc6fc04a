"""Whatever ends a run, the tendons go slack within 100 ms, the robot is closed, and the log has every period until then."""

import itertools
import json
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from soft_tendon_env.robots import RobotEnv, read_log, run_policy
from soft_tendon_env.robots.reach import reach_of
from soft_tendon_env.robots.safety import RAMP, TRYING, SafeRobot
from soft_tendon_env.robots.signals import SIGNALS

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


def interrupt(*names):
    """Signals that come at once."""
    numbers = [signal.Signals[name] for name in names]
    signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    for number in numbers:
        signal.raise_signal(number)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)


@pytest.mark.cases(
    "faults, policy, raised, cause, sent",
    [
        ({}, Pulling(), None, "the run ended", 30),
        ({"read": at(12, lost)}, Pulling(), None, "reading failed: OSError, /dev/ttyUSB0: Input/output error", 11),
        ({}, Pulling(at(8, out_of_reach)), ValueError, "ValueError, the target is out of reach", 7),
        ({}, Pulling(at(8, partial(interrupt, "SIGINT"))), KeyboardInterrupt, "interrupted by SIGINT (Ctrl-C)", 7),
        ({}, Pulling(at(9, partial(interrupt, "SIGHUP", "SIGINT", "SIGTERM"))), KeyboardInterrupt, "interrupted by SIGHUP", 8),
        ({}, Pulling(at(5, partial(interrupt, "SIGTSTP"))), KeyboardInterrupt, "interrupted by SIGTSTP", 4),
        ({"read": at(6, partial(sys.exit, 3))}, Pulling(), SystemExit, "SystemExit, 3", 5),
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
    assert not report.stop.slack and not report.finished and arm.closed
    assert TRYING <= report.stop.seconds <= TRYING + SOON and 20 < len(report.stop.failures) < 50


def test_every_later_stop_tries_again(arm_of_test, drawing):
    arm = arm_of_test()
    env = RobotEnv(drawing(), arm, settle=0.0)
    env.reset(seed=0)
    env.step(np.ones(3))
    arm.faults["write"] = at(0, lost)
    assert not env.stop("somebody pressed the button").slack
    del arm.faults["write"]
    env.close()
    assert arm.is_slack and env.stopped.slack and env.stopped.cause == "somebody pressed the button"


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
    env = RobotEnv(drawing(), arm, settle=0.0, patience=40)  # which a busy machine does not use up
    loop = threading.Thread(target=run_policy, args=(Pulling(hang if what == "policy" else lambda count: None), env, 5.0), daemon=True)
    loop.start()
    if what == "policy":  # which nothing can end, and the others are left behind
        wait_until(lambda: env.stopped and env.stopped.slack and "no reading" in env.stopped.cause)
    else:
        loop.join(20.0)
        assert arm.closed and f"ms: {what} does not return" in env.stopped.cause
    assert arm.is_slack and env.stopped.slack and not after_hanging  # while it still hangs
    gate.set()
    loop.join(20.0)
    wait_until(lambda: after_hanging and arm.is_slack)
    assert arm.closed and not loop.is_alive()


def wait_until(holds):
    until = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_a_robot_that_takes_no_command_any_more_is_reported(arm_of_test, drawing, gate, tmp_path):
    arm = arm_of_test(real_time=True, write=lambda count: gate.wait(30.0) if count >= 8 else None)
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, settle=0.0, patience=40), 5.0, report=tmp_path / "run.json")
    assert "write does not return" in report.stop.cause and not report.stop.slack and not report.finished
    assert len(report.stop.failures) > 3 and set(report.stop.failures) == {"TimeoutError, write does not return"}
    assert TRYING <= report.stop.seconds < 3.0 * TRYING and arm.closed  # and no thread but daemons is left
    assert not json.loads((tmp_path / "run.json").read_text())["stop"]["slack"]
    assert all(thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread())


@pytest.mark.cases("seconds, commands", [(0.05, 2), (0.25, 0)])
def test_slow_ports_are_waited_for(seconds, commands, arm_of_test, drawing):
    """Slack is reported also where it is sent by a call that had been left behind."""
    arm, episodes = arm_of_test(real_time=True, write=lambda count: time.sleep(seconds)), drawing().unwrapped.episodes
    robot = SafeRobot(arm, np.array([[0.0, 5.0]] * 3), 0, reach_of(episodes), None, 100, False)
    robot.begin()
    robot.write(np.full(3, 2.0))
    robot.stop("somebody pressed the button")
    wait_until(lambda: robot.stopped.slack and arm.is_slack)
    assert len(robot.stopped.command) >= commands
    robot.close()


def at_instruction(place, act):
    """Trace function that acts once this thread comes to an instruction of the robots' modules, by number, and every tenth after it."""
    count = itertools.count(1)

    def trace(frame, event, argument):
        if "soft_tendon_env/robots" not in (file := frame.f_code.co_filename) or file.endswith("clock.py"):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and (now := next(count)) >= place and (now - place) % 10 == 0:
            act()
        return trace

    return trace


def raise_interrupt():
    raise KeyboardInterrupt


def test_interrupts_between_any_two_instructions(arm_of_test, drawing):
    """As of handlers of one's own, in whatever lets the tendons go."""
    env, interrupted = drawing(), True
    limits = np.stack([env.unwrapped.episodes.actions.least, env.unwrapped.episodes.actions.greatest], axis=1)
    reach = reach_of(env.unwrapped.episodes)
    places = itertools.count(1, 5)
    while interrupted:
        arm, interrupted = arm_of_test(), False
        robot = SafeRobot(arm, limits, 0, reach, None, 3, False)
        robot.begin()
        robot.write(np.full(3, 2.0))
        try:
            sys.settrace(at_instruction(next(places), raise_interrupt))
            robot.write(np.full(3, 3.0))
            robot.read()
            robot.stop("somebody pressed the button")
        except KeyboardInterrupt:
            interrupted = True
        finally:
            sys.settrace(None)
        robot.close()
        assert arm.is_slack and arm.closed and robot.stopped.slack
    assert next(places) > 300


@pytest.mark.cases("place", [10, 100, 700, 1500, 3000, 5000])
def test_signals_at_any_moment_of_a_run(place, arm_of_test, drawing, tmp_path):
    arm, path = arm_of_test(), tmp_path / "run.json"
    env = RobotEnv(drawing(), arm, settle=0.0)
    tracer = sys.gettrace()
    with pytest.raises(KeyboardInterrupt, match="interrupted by SIG"), SIGNALS.held():
        sys.settrace(at_instruction(place, partial(interrupt, "SIGTERM", "SIGINT")))
        try:
            run_policy(Pulling(), env, 0.2, report=path)
        finally:
            sys.settrace(tracer)
    assert not arm.sent or arm.is_slack
    assert arm.closed and json.loads(path.read_text())["stop"]["slack"]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    path.unlink()


def test_signals_that_are_ignored_stay_ignored(arm_of_test, drawing):
    """As SIGHUP under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_policy(Pulling(at(3, partial(interrupt, "SIGHUP"))), RobotEnv(drawing(), arm_of_test(), settle=0.0), 0.2).finished


CHILD = """
import sys, time, gymnasium, numpy as np
from soft_tendon_env.robots import Measurement, RobotEnv
class Arm:
    command_unit, senses, calls = "N", ("tip_pose",), 0
    def read(self): return Measurement(time.perf_counter(), tip_pose=np.diag([1.0, 1.0, 1.0, 1.0]))
    def write(self, command):
        print(command.max(), flush=True)
        self.calls += 1
        if self.calls == int(sys.argv[1]): time.sleep(1e6)
    def close(self): pass
env = gymnasium.make("TendonRod-Reach-v0", scene="three_tendon", fidelity="fast", observation=["tip_position"])
env = RobotEnv(env, Arm(), settle=0.0, patience=50)
env.reset(seed=0)
for _ in range(20): print(env.step(np.ones(3))[4].get("stopped", ""))
raise ValueError("and nothing is closed")
"""


@pytest.mark.slow
@pytest.mark.parametrize("hangs, stop", [(0, ""), (9, "no reading for"), (21, "no reading for")])
def test_the_end_of_the_interpreter_lets_go(hangs, stop):
    ended = subprocess.run([sys.executable, "-c", CHILD, str(hangs)], capture_output=True, text=True, timeout=60)
    assert "and nothing is closed" in ended.stderr and stop in ended.stdout
    assert [float(line) for line in ended.stdout.splitlines() if re.fullmatch(r"[0-9.]+", line)][-1] == 0.0


def test_a_dry_run_sends_nothing(arm_of_test, drawing, tmp_path):
    arm = arm_of_test()
    report = run_policy(Pulling(), RobotEnv(drawing(), arm, log=tmp_path / "dry.csv", dry=True), 0.4)
    assert report.finished and not arm.sent and arm.counts["read"] > 20
    assert (read_log(tmp_path / "dry.csv").sent.max(axis=1) > 1.0).all()  # what would have been
    assert RAMP <= SOON
