"""Dynamixel motors, byte by byte: newtons become steps of the registers, motors that are lost are
an error and go slack."""

import numpy as np
import pytest

from soft_tendon_env.robots import RobotEnv, dynamixel, run_policy
from soft_tendon_env.robots.clock import Clock

pytest.importorskip("dynamixel_sdk")
bus_module = pytest.importorskip("tests.robots.dynamixel_bus")
from soft_tendon_env.robots import DynamixelRobot  # noqa: E402

IDS = (1, 2, 5)
SPOOL = {"radius": [0.01, 0.01, -0.01], "torque_constant": 1.8}
UNIT = 0.00269 * 1.8 / 0.01  # [N] of a step of current


@pytest.fixture
def bus(monkeypatch):
    """Three motors, in whose time robots live."""
    motors = bus_module.Bus({1: 2048, 2: -500, 5: 100_000})
    monkeypatch.setattr("dynamixel_sdk.PortHandler", lambda name: bus_module.Port(name, motors))
    monkeypatch.setattr(dynamixel, "perf_counter", motors.clock)
    return motors


@pytest.fixture
def connect(bus):
    """connect(**arguments): the robot on the bus."""
    return lambda **arguments: DynamixelRobot(bus.port, IDS, **{**SPOOL, **arguments})


def test_tensions_are_currents(bus, connect, wait_until):
    robot = connect()
    assert robot.command_unit == "N"
    assert [motor.table[11] for motor in bus.motors.values()] == [
        0,
        0,
        0,
    ]
    sent = robot.write(np.array([3.0, 0.2, 5.0]))
    measured = robot.read()
    assert [motor.goal_current for motor in bus.motors.values()] == [6, 0, -10]
    expected_sent = UNIT * np.array([6, 0, 10])
    np.testing.assert_allclose(sent, expected_sent)
    np.testing.assert_allclose(measured.tension, sent)
    np.testing.assert_allclose(measured.tendon_length, 0.0)
    assert robot.senses == ("tension", "tendon_length")
    assert robot.write(np.array([1e6, 0.0, 0.0]))[0] == UNIT * 1193
    assert robot.read().time > measured.time
    robot.close()
    assert_limp(bus, wait_until)
    assert not robot._port.is_open
    assert not any(motor.table[98] for motor in bus.motors.values())


def assert_limp(bus, wait_until):
    """Torque is off, as soon as the bus comes to it."""
    wait_until(lambda: not any(motor.table[64] for motor in bus.motors.values()))


def test_motors_watch_the_bus_and_go_on_when_it_speaks_again(bus, connect):
    robot = connect()
    robot.write(np.full(3, 5.0))
    robot.read()
    assert bus.motors[1].table[98] == 5
    assert not bus.motors[1].has_stopped
    bus.clock.time += 0.15
    assert bus.motors[1].has_stopped
    robot.write(np.full(3, 1.0))
    robot.read()
    assert bus.motors[1].goal_current == 2
    assert not bus.motors[1].has_stopped


@pytest.mark.parametrize("lose", [lambda bus: bus.silent.add(2), lambda bus: bus.unplug()])
def test_lost_motors_and_ports_end_a_run(lose, bus, connect, drawing, pulling, wait_until):
    clock = Clock(real=False)
    robot = connect(tip_pose=lambda: (clock.now(), np.eye(4)))
    robot.clock = clock
    env = RobotEnv(drawing(), robot, settle=0.0)
    report = run_policy(pulling(lambda count: lose(bus) if count == 5 else None), env, 3.0)
    assert "failed: " in report.stop.cause
    assert not report.finished
    assert report.stop.slack == bool(bus.silent)
    if report.stop.slack:
        assert_limp(bus, wait_until)
        assert [motor.goal_current for motor in bus.motors.values()] == [
            0,
            0,
            0,
        ]  # the one that cannot answer hears it still


def test_lengths_are_those_that_spools_wind_up(bus, connect):
    robot = connect()
    present_position = slice(132, 136)
    for motor, turns in zip(bus.motors.values(), (0.5, -0.25, 1.0), strict=True):
        before = int.from_bytes(motor.table[present_position], "little", signed=True)
        after = before + int(4096 * turns)
        motor.table[present_position] = after.to_bytes(4, "little", signed=True)
    # a spool of 1 cm winds 2 pi cm a turn, and the third one the other way
    wound_turns = np.array([0.5, -0.25, -1.0])
    circumference = 2.0 * np.pi * 0.01
    expected = -circumference * wound_turns
    tendon_length = robot.read().tendon_length
    np.testing.assert_allclose(tendon_length, expected, rtol=1e-12)
    robot.close()


def test_a_pose_comes_with_its_time(bus, connect):
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    newest = [(77.5, pose)]
    robot = connect(tip_pose=lambda: newest[0])
    measured = robot.read()
    assert measured.tip_time == measured.time_of_pose == 77.5
    assert measured.time != 77.5
    assert (measured.tip_pose == pose).all()
    newest[0] = (1, 2, 3)
    with pytest.raises(TypeError, match=r"tip_pose should return \(time, pose\), not a tuple of 3"):
        robot.read()
    robot.close()


@pytest.mark.parametrize("has_time", [True, False])
def test_a_tracker_that_has_lost_sight_stops_a_run(has_time, bus, connect, drawing, pulling):
    """It goes on returning its newest pose, and the motors answer."""
    clock = Clock(real=False)
    count = 0

    def newest():
        nonlocal count
        count += 1
        pose = np.eye(4)
        pose[0, 3] = 0.29 + 1e-7 * min(count, 30)
        if has_time:
            return (0.02 * min(count, 30), pose)
        return pose

    robot = connect(tip_pose=newest)
    robot.clock = clock
    report = run_policy(pulling(), RobotEnv(drawing(), robot, settle=0.0), 3.0)
    assert report.stop.cause.startswith("no reading for ")
    assert report.timing.periods in (32, 33)  # three periods, up to round-off
    assert report.stop.slack


@pytest.mark.parametrize("arguments", [{"radius": 0.0}, {"watchdog": 5.0}, {"radius": [1.0, 2.0]}])
def test_bad_arguments_are_refused(arguments, connect):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        connect(**arguments)


def test_motors_that_are_not_there_are_named(bus):
    with pytest.raises(ConnectionError, match=f"motor 7 on {bus.port}: .*no status packet"):
        DynamixelRobot(bus.port, (1, 7), 0.01, 1.8)
    with pytest.raises(OSError, match="could not open port /dev/none"):
        DynamixelRobot("/dev/none", (1,), 0.01, 1.8)
    with pytest.raises(ValueError, match="ids is "):
        DynamixelRobot(bus.port, (1, 1), **SPOOL)
