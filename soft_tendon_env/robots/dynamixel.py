"""Dynamixel motors that wind tendons, over Protocol 2.0: `pip install "soft_tendon_env[robots]"`.

Registers are those of the X series (Robotis e-Manual, "Control Table"). Motors are driven by
current, in proportion to tension where the gear runs freely, and stop by themselves where the bus
is silent (register Bus Watchdog), as when its cable is lost. The serial adapter should have a
latency timer of 1 ms (of FTDI chips 16 ms by default:
/sys/bus/usb-serial/devices/ttyUSB0/latency_timer).
"""

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.robots.protocol import Measurement, Unit
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.types import Array

BAUD = 1_000_000  # [bits/s]
TICKS = 4096 / (2.0 * math.pi)  # positions in a radian
WATCHDOG_UNIT = 0.02  # [s]
TRIES = 3  # how often a motor is asked: an answer may be lost on a bus that works
OPERATING_MODE, CURRENT_LIMIT, TORQUE_ENABLE, BUS_WATCHDOG = (
    11,
    38,
    64,
    98,
)  # addresses of registers
GOAL = (102, 2)  # address and size of the goal current
PRESENT, FORMAT = (
    (126, 10),
    "<hii",
)  # of current (2 bytes), velocity (4) and position (4), side by side, and how they are read
EVERYBODY = (
    254  # id of all motors, which do not answer to it: one that is lost keeps nobody waiting
)


@dataclass(eq=False)
class DynamixelRobot:
    """Dynamixel motors, one for each tendon, which take tensions [N]. Currents give the measured
    tensions. Positions give the lengths of the tendons, as if these did not stretch; at the
    beginning the tendons should be just taut. `tip_pose` gives the pose of the tip.

    Raises ValueError for bad arguments, OSError where the port cannot be opened, ConnectionError
    where a motor does not answer.
    """

    port: str  # serial port, "/dev/ttyUSB0" or "COM3"
    ids: Sequence[int]  # of the motors, in the order of the scene's tendons
    # of the spools [m], one for all or one each; negative where a motor winds in the other way
    radius: ArrayLike
    torque_constant: (
        float  # torque [N m] of a motor, behind its gear, for an ampere: of an XM430-W350 about 1.8
    )
    tip_pose: Callable[[], Array] | None = (
        None  # returns the newest pose (4, 4) of the tip in the scene's world frame, of a tracker
    )
    current_unit: float = (
        0.00269  # of a step of current [A], of X motors of 430 and 540; 0.001 for 330
    )
    watchdog: float = 0.1  # silence [s] after which the motors stop, in steps of 0.02 s
    command_unit: ClassVar[Unit] = "N"

    def __post_init__(self) -> None:
        import dynamixel_sdk as sdk  # here: it is an extra

        ids, self.senses = (
            self.ids,
            ("tension", "tendon_length", *(("tip_pose",) if self.tip_pose else ())),
        )
        if (
            not ids
            or len({*ids}) < len(ids)
            or not all(isinstance(motor, int) and 0 <= motor <= 252 for motor in ids)
        ):
            raise ValueError(
                f"ids is {shown(list(ids))}: it should be a different number from 0 to 252 for each"
                " motor"
            )
        self._radius = checked_array(
            "radius",
            self.radius if np.ndim(self.radius) else np.full(len(ids), self.radius),
            (len(ids),),
        )
        constant = checked_number(
            "torque_constant", self.torque_constant, 1e-9, "a positive number of N m / A"
        )
        if not self._radius.all() or not WATCHDOG_UNIT <= self.watchdog <= 127 * WATCHDOG_UNIT:
            raise ValueError(
                f"radius should not be 0, and watchdog from {WATCHDOG_UNIT} to"
                f" {127 * WATCHDOG_UNIT:g} s"
            )
        self._tension_unit, self._most = self.current_unit * constant / self._radius, list[int]()
        self._port, self._packets, self._success = (
            sdk.PortHandler(self.port),
            sdk.PacketHandler(2.0),
            sdk.COMM_SUCCESS,
        )
        if not (self._port.openPort() and self._port.setBaudRate(BAUD)):
            raise ConnectionError(f"{self.port} cannot be opened at {BAUD} bits/s")
        self._sender = sdk.GroupSyncWrite(self._port, self._packets, *GOAL)
        self._reader = sdk.GroupSyncRead(self._port, self._packets, *PRESENT)
        for motor in ids:
            self._reader.addParam(motor)
            self._set(motor, TORQUE_ENABLE, 0)
            self._set(motor, OPERATING_MODE, 0)  # current control
            self._most.append(
                self._ask(
                    f"motor {motor}",
                    partial(self._packets.read2ByteTxRx, self._port, motor, CURRENT_LIMIT),
                )
            )
        self._zero = self._read_present()[2]
        for motor in ids:
            self._set(motor, TORQUE_ENABLE, 1)
        self._heard = -math.inf

    def read(self) -> Measurement:
        """Currents and positions of all motors in one packet, and the tip's pose. Raises
        ConnectionError."""
        current, _, position = self._read_present()
        tip = None if self.tip_pose is None else self.tip_pose()
        length = (self._zero - position) / TICKS * self._radius
        return Measurement(
            perf_counter(), tip_pose=tip, tension=current * self._tension_unit, tendon_length=length
        )

    def write(self, command: Array) -> Array:
        """Sends tensions (n_a,) [N] in one packet; returns them in whole steps, never beyond what
        was asked, within the motors' limits. Raises ConnectionError, ValueError for another
        shape."""
        steps, most = (
            checked_array("command", command, (len(self.ids),)) / self._tension_unit,
            np.array(self._most),
        )
        ticks = np.clip(
            np.trunc(steps + 1e-9 * np.sign(steps)), -most, most
        )  # round-off is no step less
        if perf_counter() - self._heard > 0.5 * self.watchdog:
            self._set(
                EVERYBODY, BUS_WATCHDOG, 0
            )  # a motor that has stopped for the silence goes on
            self._set(EVERYBODY, BUS_WATCHDOG, round(self.watchdog / WATCHDOG_UNIT))
        self._sender.clearParam()
        for motor, goal in zip(self.ids, ticks, strict=True):
            self._sender.addParam(motor, struct.pack("<h", int(goal)))
        self._ask("the motors", lambda: (None, self._sender.txPacket(), 0), 1)
        self._heard = perf_counter()
        return np.asarray(ticks * self._tension_unit)

    def close(self) -> None:
        """Takes the torque off and closes the port, as far as it is there."""
        try:
            self._set(EVERYBODY, BUS_WATCHDOG, 0)
            self._set(EVERYBODY, TORQUE_ENABLE, 0)
        finally:
            self._port.closePort()

    def _read_present(self) -> Array:
        """Present currents, velocities and positions (3, n_a) in steps. Raises ConnectionError."""
        self._ask("the motors", lambda: (None, self._reader.txRxPacket(), 0))
        self._heard = perf_counter()
        return np.array(
            [struct.unpack(FORMAT, bytes(self._reader.data_dict[motor])) for motor in self.ids],
            dtype=float,
        ).T

    def _set(self, motor: int, register: int, value: int) -> None:
        """Set a register of one byte of a motor, or of EVERYBODY. Raises ConnectionError."""
        self._ask(
            f"motor {motor}",
            lambda: (None, *self._packets.write1ByteTxRx(self._port, motor, register, value)),
        )

    def _ask(self, who: str, call: Callable[[], tuple[Any, int, int]], tries: int = TRIES) -> Any:
        """Value that a call of the SDK returns with its result and error; a lost port does not stay
        in use. Raises ConnectionError."""
        for _ in range(tries):
            try:
                value, result, error = call()
            except (
                BaseException
            ) as lost:  # OSError, termios.error, which is none, and KeyboardInterrupt
                self._port.is_using = False
                if not isinstance(lost, Exception):
                    raise
                raise ConnectionError(f"{self.port} is lost: {lost}") from lost
            if result == self._success and not error:
                return value
        why = (
            self._packets.getRxPacketError(error)
            if result == self._success
            else self._packets.getTxRxResult(result)
        )
        raise ConnectionError(f"{who} on {self.port}: {why}")
