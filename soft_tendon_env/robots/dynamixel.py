"""Dynamixel motors that wind tendons, over Protocol 2.0: `pip install "soft_tendon_env[robots]"`.

Registers are those of the X series (XL330 to XH540; Robotis e-Manual, "Control Table"). Two ways to drive: current, in proportion to
tension where the gear runs freely, or position over several turns. Motors watch the bus by themselves (register Bus Watchdog): where the
computer, its cable or its port is lost they stop on their own.

The serial adapter should have a latency timer of 1 ms (of FTDI chips 16 ms by default: /sys/bus/usb-serial/devices/ttyUSB0/latency_timer).
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Annotated, Any, Literal

import dynamixel_sdk as sdk
import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from soft_tendon_env.robots.protocol import Measurement, Unit
from soft_tendon_env.tools.checks import checked_array, checked_number, checked_type
from soft_tendon_env.tools.configuration import Configuration, shown
from soft_tendon_env.tools.types import Array, Positive

TICKS = 4096 / (2.0 * math.pi)  # positions in a radian
WATCHDOG_UNIT = 0.02  # [s]
MODES = {"current": 0, "position": 4}  # current control, extended position control
TRIES = 3  # how often a motor is asked before a run: an answer may be lost on a bus that works
OPERATING_MODE, CURRENT_LIMIT, TORQUE_ENABLE, BUS_WATCHDOG = 11, 38, 64, 98  # addresses of registers
GOALS = {"current": (102, 2), "position": (116, 4)}  # address and size
PRESENT = (126, 10)  # of current (2 bytes), velocity (4) and position (4), side by side


class NoAnswerError(ConnectionError):
    """Raised where a motor does not answer, or with an error."""


class MotorSettings(Configuration):
    """Settings of Dynamixel motors and their bus."""

    current_unit: Positive = 0.00269  # [A] of a step of current: 0.00269 for X motors of 430 and 540, 0.001 for 330
    baud: Annotated[int, Field(ge=1)] = 1_000_000  # [bits/s]
    watchdog: Annotated[float, Field(ge=WATCHDOG_UNIT, le=127 * WATCHDOG_UNIT)] = 0.1  # [s] of silence after which the motors stop


MOTORS = MotorSettings()


class DynamixelRobot:
    """One motor for each tendon. It senses the tendons' lengths, as if they did not stretch, from its positions at the beginning, where
    they should be just taut; and tensions, from the currents. Positions of the tip come from `tip_pose`, if it is given.

    Args:
        port: serial port, "/dev/ttyUSB0" or "COM3".
        ids: of the motors, in the order of the scene's tendons.
        radius: of the spools [m], one for all or one each; negative where a motor winds in the other way.
        torque_constant: torque [N m] of a motor, behind its gear, for an ampere: of an XM430-W350 about 1.8.
        mode: "current" takes tensions [N], "position" displacements [m].
        settings: see MotorSettings.
        tip_pose: function that returns the newest pose (4, 4) of the tip in the scene's world frame, of a tracker.

    Raises ValueError for bad arguments, ConnectionError where the port or a motor does not answer.
    """

    def __init__(
        self,
        port: str,
        ids: Sequence[int],
        radius: ArrayLike,
        torque_constant: float,
        mode: Literal["current", "position"] = "current",
        settings: MotorSettings = MOTORS,
        tip_pose: Callable[[], Array] | None = None,
    ) -> None:
        if mode not in MODES:
            raise ValueError(f"mode is {mode!r}: it should be 'current' or 'position'")
        if not ids or len({*ids}) < len(ids) or not all(isinstance(motor, int) and 0 <= motor <= 252 for motor in ids):
            raise ValueError(f"ids is {shown(list(ids))}: it should be a different number from 0 to 252 for each motor")
        self._radius = checked_array("radius", radius if np.ndim(radius) else np.full(len(ids), radius), (len(ids),))
        if not self._radius.all():
            raise ValueError("radius should not be 0")
        constant = checked_number("torque_constant", torque_constant, 1e-9, "a positive number of N m / A")
        checked_type("settings", settings, MotorSettings, "such as MotorSettings(watchdog=0.2)")
        self._tension_unit, self._watchdog = settings.current_unit * constant / self._radius, settings.watchdog
        self.command_unit: Unit = "N" if mode == "current" else "m"
        self.senses: tuple[str, ...] = ("tension", "tendon_length", *(("tip_pose",) if tip_pose else ()))
        self._ids, self._tip_pose = tuple(ids), tip_pose
        self._open(port, settings.baud)
        self._goal = GOALS[mode]
        self._sender = sdk.GroupSyncWrite(self._port, self._packets, *self._goal)
        self._reader = sdk.GroupSyncRead(self._port, self._packets, *PRESENT)
        self._most = np.zeros(len(ids))
        for i, motor in enumerate(self._ids):
            self._reader.addParam(motor)
            self._set(motor, TORQUE_ENABLE, 0)
            self._set(motor, OPERATING_MODE, MODES[mode])
            limit = partial(self._packets.read2ByteTxRx, self._port, motor, CURRENT_LIMIT)
            self._most[i] = self._asked(f"motor {motor}", limit)
        self._zero = self._present(TRIES)[1]
        if mode == "position":
            self._send(self._zero)
        for motor in self._ids:
            self._set(motor, TORQUE_ENABLE, 1)
        self._heard = -math.inf
        self._newest: Measurement | None = None

    def read(self) -> Measurement:
        """Currents and positions of all motors in one packet, and the tip's pose; those of before where an answer is lost, for the watchdog
        to judge. Raises ConnectionError where the port is."""
        try:
            current, position = self._present(1 if self._newest else TRIES)
        except NoAnswerError:
            if self._newest is None:
                raise
            return self._newest
        tip = None if self._tip_pose is None else self._tip_pose()
        length = (self._zero - position) / TICKS * self._radius
        self._newest = Measurement(perf_counter(), tip_pose=tip, tension=current * self._tension_unit, tendon_length=length)
        return self._newest

    def write(self, command: Array) -> Array:
        """Sends tensions (n_a,) [N], or displacements [m] from where the motors were at the beginning, in one packet; returns them as the
        motors have them, in whole steps, never beyond what was asked, and within their current limits. Raises ConnectionError, ValueError
        for another shape."""
        wanted = checked_array("command", command, (len(self._ids),))
        if self.command_unit == "N":
            ticks = np.clip(_whole(wanted / self._tension_unit), -self._most, self._most)
            sent = ticks * self._tension_unit
        else:
            ticks = self._zero + _whole(wanted / self._radius * TICKS)
            sent = (ticks - self._zero) / TICKS * self._radius
        if perf_counter() - self._heard > 0.5 * self._watchdog:
            self._broadcast(BUS_WATCHDOG, 0)  # a motor that has stopped for the silence goes on
            self._broadcast(BUS_WATCHDOG, round(self._watchdog / WATCHDOG_UNIT))
        self._send(ticks)
        return sent

    def close(self) -> None:
        """Takes the torque off and closes the port, as far as it is there."""
        try:
            self._broadcast(BUS_WATCHDOG, 0)
            self._broadcast(TORQUE_ENABLE, 0)
        finally:
            self._port.closePort()

    def _open(self, port: str, baud: int) -> None:
        """Open the port, and look for the motors. Raises ConnectionError."""
        self._where, self._port, self._packets = port, sdk.PortHandler(port), sdk.PacketHandler(2.0)
        try:
            opened = self._port.openPort() and self._port.setBaudRate(baud)
        except OSError as error:
            raise ConnectionError(f"{port} cannot be opened: {error}") from error
        if not opened:
            raise ConnectionError(f"{port} cannot be opened at {baud} bits/s")
        for motor in self._ids:
            self._asked(f"motor {motor}", partial(self._packets.ping, self._port, motor))

    def _present(self, tries: int) -> Array:
        """Present currents and positions (2, n_a) in steps. Raises ConnectionError."""
        self._asked("the motors", lambda: (None, self._reader.txRxPacket(), 0), tries)
        found = []
        for motor in self._ids:
            if not self._reader.isAvailable(motor, *PRESENT):
                raise NoAnswerError(f"motor {motor} on {self._where} does not answer")
            current, position = (self._reader.getData(motor, PRESENT[0] + place, size) for place, size in ((0, 2), (6, 4)))
            found.append((np.int16(np.uint16(current)), np.int32(np.uint32(position))))  # two's complement
        self._heard = perf_counter()
        return np.array(found, dtype=np.float64).T

    def _send(self, ticks: Array) -> None:
        """Send the goals (n_a,) in steps. Raises ConnectionError."""
        self._sender.clearParam()
        for motor, goal in zip(self._ids, ticks, strict=True):
            self._sender.addParam(motor, int(goal).to_bytes(self._goal[1], "little", signed=True))
        self._asked("the motors", lambda: (None, self._sender.txPacket(), 0), 1)
        self._heard = perf_counter()

    def _set(self, motor: int, register: int, value: int) -> None:
        """Set a register of one byte of a motor. Raises ConnectionError."""
        self._asked(f"motor {motor}", lambda: (None, *self._packets.write1ByteTxRx(self._port, motor, register, value)))

    def _broadcast(self, register: int, value: int) -> None:
        """Set a register of one byte of all motors, which do not answer: one that is lost keeps nobody waiting."""
        write = self._packets.write1ByteTxOnly
        self._asked("the motors", lambda: (None, write(self._port, sdk.BROADCAST_ID, register, value), 0), 1)

    def _asked(self, who: str, call: Callable[[], tuple[Any, int, int]], tries: int = TRIES) -> Any:
        """Value that a call of the SDK returns with its result and error, tried several times if need be; a port that is lost does not stay
        in use. Raises ConnectionError, a NoAnswerError where the port is there."""
        for _ in range(tries):
            try:
                value, result, error = call()
            except BaseException as lost:  # OSError, termios.error, which is none, and KeyboardInterrupt
                self._port.is_using = False
                if not isinstance(lost, Exception):
                    raise
                raise ConnectionError(f"{self._where} is lost: {lost}") from lost
            if result == sdk.COMM_SUCCESS:
                break
        if result != sdk.COMM_SUCCESS or error:
            why = self._packets.getRxPacketError(error) if result == sdk.COMM_SUCCESS else self._packets.getTxRxResult(result)
            raise NoAnswerError(f"{who} on {self._where}: {why}")
        return value


def _whole(steps: Array) -> Array:
    """Whole steps, towards zero: limits in newtons or metres hold for what the motors get. Round-off is no step less."""
    return np.trunc(steps + 1e-9 * np.sign(steps))
