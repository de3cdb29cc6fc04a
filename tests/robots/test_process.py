"""A driver in a process of its own lets the tendons go where the program is silent, holds its
interpreter or is killed."""

import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from soft_tendon_env.cli.robot_settings import load_robot
from soft_tendon_env.robots import RobotProcess
from soft_tendon_env.robots.clock import Clock
from soft_tendon_env.robots.process import RobotLetGo, SteppedTime, WatchedDriver, _portable
from soft_tendon_env.robots.slack import RAMP_STEPS

file_arm = pytest.importorskip("tests.robots.file_arm")
SLACK = np.zeros(3)
PULL = np.array([1.0, 2.0, 0.5])
LONGEST = 1800.0
"""Patience [s] that no busy machine wears out."""


@pytest.fixture
def watched(arm_of_test):
    """A driver in stepped time that pulls, with a patience of 0.3 s."""
    arm = arm_of_test()
    driver = WatchedDriver(arm, arm.clock)
    driver.watch(SLACK, 0.3)
    driver.write(PULL)
    return driver


def passes(driver, seconds):
    """Lets time pass for a driver, whose watchdog then looks."""
    clock = driver.robot.clock
    clock.wait_until(clock.now() + seconds)
    driver.look()


def test_silence_lets_the_tendons_go_evenly(watched):
    passes(watched, 0.29)
    assert watched.stopped is None
    passes(watched, 0.02)
    assert watched.stopped.cause == "no call for 310 ms: patience is 300 ms"
    assert watched.stopped.slack
    times = np.array([time for time, _ in watched.robot.sent[1:]])
    shares = np.array([command[1] for _, command in watched.robot.sent[1:]]) / PULL[1]
    expected_shares = 1.0 - np.arange(1, RAMP_STEPS + 1) / RAMP_STEPS
    np.testing.assert_allclose(shares, expected_shares, atol=1e-12)
    assert times[-1] - times[0] <= 0.03


@pytest.mark.parametrize("call", [lambda driver: driver.read(), lambda driver: driver.write(PULL)])
def test_every_call_is_a_sign_of_life(call, watched):
    for _ in range(5):
        passes(watched, 0.25)
        call(watched)
    assert watched.stopped is None
    passes(watched, 0.31)
    assert watched.robot.is_slack
    with pytest.raises(RobotLetGo, match="has let the tendons go: no call for 310 ms"):
        call(watched)


def test_after_a_stop_slack_alone_is_sent_until_it_begins_again(watched):
    passes(watched, 1.0)
    count = len(watched.robot.sent)
    watched.write(SLACK)
    with pytest.raises(RobotLetGo):
        watched.write(0.5 * PULL)
    assert len(watched.robot.sent) == count + 1
    watched.watch(SLACK, 0.3)
    watched.write(PULL)
    assert not watched.robot.is_slack
    assert watched.read().tip_pose is not None


def test_slack_tendons_may_stay_without_a_call(watched):
    watched.write(SLACK)
    passes(watched, 100.0)
    assert watched.stopped is None
    watched.write(PULL)


def test_slack_that_cannot_be_sent_is_tried_at_every_look(watched):
    def lost(count):
        raise OSError("the port is lost")

    watched.robot.faults["write"] = lost
    passes(watched, 0.31)
    assert not watched.stopped.slack
    assert "the port is lost" in watched.stopped.failures[-1]
    watched.robot.faults.clear()
    passes(watched, 0.01)
    assert watched.stopped.slack
    assert watched.robot.is_slack


def test_the_end_of_the_program_lets_go_and_closes(watched):
    assert not watched.is_letting_go
    watched.close()
    assert watched.robot.is_slack
    assert watched.robot.closed
    assert not watched.is_letting_go


def test_a_driver_that_was_not_told_to_watch_takes_no_command(arm_of_test):
    arm = arm_of_test()
    driver = WatchedDriver(arm, Clock(real=False))
    with pytest.raises(RobotLetGo, match="was not told to watch"):
        driver.write(PULL)
    driver.close()
    assert not arm.sent


def test_a_process_answers_as_its_driver_does_and_lets_go_where_nobody_calls(
    tmp_path, wait_until, monkeypatch
):
    path = tmp_path / "sent"
    folder = tmp_path / "of_a_user"
    folder.mkdir()
    lines = [
        "from tests.robots.file_arm import FileArm",
        "class Arm(FileArm):",
        "    own_process = True  # of a module that this process alone knows where to find",
        "print('what a driver prints')",
    ]
    (folder / "arm_in_a_file.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(folder)
    robot = load_robot("arm_in_a_file:Arm", {"path": str(path)})
    assert isinstance(robot, RobotProcess)
    assert (robot.command_unit, robot.senses) == ("N", ("tip_pose",))
    robot.watch(SLACK, LONGEST)
    np.testing.assert_array_equal(robot.write(PULL), PULL)
    first = robot.read()
    second = robot.read()
    assert second.time > first.time
    np.testing.assert_array_equal(first.tip_pose, file_arm.POSE)
    assert file_arm.tensions(path) == [2.0]
    robot.write(SLACK)
    robot.watch(SLACK, 0.05)
    robot.write(PULL)
    wait_until(lambda: file_arm.tensions(path)[-1] == 0.0)
    with pytest.raises(RobotLetGo, match="no call for "):
        robot.read()
    robot.close()
    assert file_arm.lines(path)[-1] == "closed"
    with pytest.raises((ValueError, OSError)):
        robot.read()


@pytest.mark.slow
def test_what_a_driver_raises_is_raised(tmp_path, wait_until):
    path = str(tmp_path / "sent")
    with pytest.raises(FileNotFoundError, match="No such file"):
        RobotProcess(file_arm.FileArm, path, fails="begins")
    with pytest.raises(SteppedTime, match="a clock of its own needs no process"):
        RobotProcess(file_arm.SteppedArm, path)
    assert file_arm.lines(path) == ["closed"]
    robot = RobotProcess(file_arm.FileArm, path, fails="reading")
    robot.watch(SLACK, LONGEST)
    with pytest.raises(ConnectionError, match="the tracker is gone"):
        robot.read()
    robot.write(PULL)
    os.kill(robot._process.pid, signal.SIGTERM)
    wait_until(lambda: file_arm.lines(path)[-1] == "closed")
    assert file_arm.tensions(path)[-1] == 0.0
    with pytest.raises(OSError):  # noqa: PT011 (a broken pipe, or the end of the process)
        robot.read()


def test_classes_of_the_program_itself_are_refused():
    class Own(file_arm.FileArm):
        pass

    Own.__module__ = "__main__"
    with pytest.raises(TypeError, match="Own of the program itself: put it into a module"):
        RobotProcess(Own, "path")


def test_errors_that_pickle_cannot_carry_become_words():
    class Odd(Exception):
        pass

    assert isinstance(_portable(Odd("the port is odd")), RuntimeError)
    assert "the port is odd" in str(_portable(Odd("the port is odd")))
    kept = ValueError("as it is")
    assert _portable(kept) is kept


PROGRAM = """
    import re, signal, sys, os
    import gymnasium, numpy as np
    from tests.robots.file_arm import FileArm
    from soft_tendon_env.robots import RobotEnv, RobotProcess
    options = {"scene": "three_tendon", "fidelity": "fast", "observation": ["tip_position"]}
    env = gymnasium.make("TendonRod-Reach-v0", action="tension", max_episode_steps=None, **options)
    robot = RobotProcess(FileArm, sys.argv[1])
    env = RobotEnv(env, robot, settle=0.0, patience=100_000)  # as a busy machine may need
    env.reset(seed=0)
    env.step(np.zeros(3))
    robot.watch(np.zeros(3), 2.0)  # from the next command on
    env.step(np.zeros(3))
    print("pulls", flush=True)
    if sys.argv[2] == "holds the interpreter":
        re.match(r"(a+)+$", "a" * 60 + "b")  # one call of C, for longer than anybody waits
    elif sys.argv[2] == "faults":
        signal.raise_signal(signal.SIGSEGV)
    while True:
        env.step(np.zeros(3))
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", ["holds the interpreter", "faults", "SIGKILL", "SIGSTOP"])
def test_tendons_go_slack_whatever_happens_to_the_program(end, tmp_path, wait_until):
    path = tmp_path / "sent"
    program = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), str(path), end], stdout=subprocess.PIPE
    )
    try:
        assert program.stdout.readline() == b"pulls\n"
        assert 2.5 in file_arm.tensions(path)
        if end.startswith("SIG"):
            program.send_signal(getattr(signal, end))
        wait_until(lambda: file_arm.tensions(path)[-1] == 0.0)
        if end in ("SIGKILL", "faults"):
            wait_until(lambda: file_arm.lines(path)[-1] == "closed")
    finally:
        program.kill()
        program.wait()
        program.stdout.close()
