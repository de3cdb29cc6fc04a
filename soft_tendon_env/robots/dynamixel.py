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
# addresses of registers
OPERATING_MODE = 11
CURRENT_LIMIT = 38
TORQUE_ENABLE = 64
BUS_WATCHDOG = 98
CURRENT_CONTROL = 0  # the operating mode
GOAL = (102, 2)  # address and size of the goal current
# address and size of current (2 bytes), velocity (4) and position (4), side by side
PRESENT = (126, 10)
FORMAT = "<hii"  # how they are read
GOAL_FORMAT = "<h"  # how the goal current is written
EVERYBODY = 254  # id of all motors, which do not answer to it: a lost one keeps nobody waiting
GREATEST_ID = 252  # of a motor
MOST_WATCHDOG = 127 * WATCHDOG_UNIT  # [s]
ROUND_OFF = 1e-9  # of a step of current, which is no step less


@dataclass(eq=False)
class DynamixelRobot:
    """Dynamixel motors, one for each tendon, which take tensions [N].

    Currents give the measured tensions. Positions give the lengths of the tendons, as if these did
    not stretch; at the beginning the tendons should be just taut. `tip_pose` gives the pose of the
    tip with its time, so that a tracker that has lost sight is noticed. A pose alone counts as new
    where it differs from the last one in any bit.

    Raises:
        TypeError: for arguments of wrong types.
        ValueError: for bad arguments.
        OSError: where the port cannot be opened.
        ConnectionError: where a motor does not answer.
    """

    port: str  # serial port, "/dev/ttyUSB0" or "COM3"
    ids: Sequence[int]  # of the motors, in the order of the scene's tendons
    # of the spools [m], one for all or one each; negative where a motor winds in the other way
    radius: ArrayLike
    # torque [N m] of a motor, behind its gear, for an ampere: of an XM430-W350 about 1.8
    torque_constant: float
    # returns the newest time [s], of any clock, and pose (4, 4) of the tip in the scene's world
    # frame that a tracker has measured; or that pose alone
    tip_pose: Callable[[], tuple[float, Array] | Array] | None = None
    # of a step of current [A], of X motors of 430 and 540; 0.001 for 330
    current_unit: float = 0.00269
    watchdog: float = 0.1  # silence [s] after which the motors stop, in steps of 0.02 s
    command_unit: ClassVar[Unit] = "N"
    own_process: ClassVar[bool] = True  # see Robot

    def __post_init__(self) -> None:
        import dynamixel_sdk as sdk  # here: it is an extra

        self.senses: tuple[str, ...] = ("tension", "tendon_length")
        if self.tip_pose:
            self.senses = (*self.senses, "tip_pose")
        self._check_ids()
        count = len(self.ids)
        if np.ndim(self.radius):
            radius = self.radius
        else:
            radius = np.full(count, self.radius)
        self._radius = checked_array("radius", radius, (count,))
        constant = checked_number(
            "torque_constant", self.torque_constant, 1e-9, "a positive number of N m / A"
        )
        has_radii = self._radius.all()
        if not has_radii or not WATCHDOG_UNIT <= self.watchdog <= MOST_WATCHDOG:
            raise ValueError(
                f"radius should not be 0, and watchdog from {WATCHDOG_UNIT} to {MOST_WATCHDOG:g} s"
            )
        torque_unit = self.current_unit * constant
        self._tension_unit = torque_unit / self._radius  # [N] of a step of current
        self._most = list[int]()  # steps of current that the motors allow
        self._port = sdk.PortHandler(self.port)
        self._packets = sdk.PacketHandler(2.0)
        self._success = sdk.COMM_SUCCESS
        is_open = self._port.openPort()
        if not (is_open and self._port.setBaudRate(BAUD)):
            raise ConnectionError(f"{self.port} cannot be opened at {BAUD} bits/s")
        self._sender = sdk.GroupSyncWrite(self._port, self._packets, *GOAL)
        self._reader = sdk.GroupSyncRead(self._port, self._packets, *PRESENT)
        for motor in self.ids:
            self._reader.addParam(motor)
            # the mode can be set without torque alone
            self._set(motor, TORQUE_ENABLE, 0)
            self._set(motor, OPERATING_MODE, CURRENT_CONTROL)
            limit = partial(self._packets.read2ByteTxRx, self._port, motor, CURRENT_LIMIT)
            most = self._ask(f"motor {motor}", limit)
            self._most.append(most)
        _, _, self._zero = self._read_present()
        for motor in self.ids:
            self._set(motor, TORQUE_ENABLE, 1)
        self._heard = -math.inf  # [s] when the motors were talked to last
        self._bare_pose: Array | None = None  # the last one that came without its time
        self._bare_time = 0.0  # [s] when it came first

    def _check_ids(self) -> None:
        """Raises ValueError for ids that no motors have, or two of them."""
        allowed = range(GREATEST_ID + 1)
        are_ids = all(isinstance(motor, int) and motor in allowed for motor in self.ids)
        different = set(self.ids)
        are_different = len(different) == len(self.ids)
        if not self.ids or not are_ids or not are_different:
            raise ValueError(
                f"ids is {shown(list(self.ids))}: it should be a different number from 0 to"
                f" {GREATEST_ID} for each motor"
            )

    def read(self) -> Measurement:
        """Reads currents and positions of all motors in one packet, and the tip's pose with time.

        Returns:
            The measurement.

        Raises:
            ConnectionError: where the port is lost, or a motor does not answer.
            TypeError: for what `tip_pose` should not return.
        """
        current, _, position = self._read_present()
        tip_time, tip_pose = self._read_tip()
        turned = (self._zero - position) / TICKS  # [rad], in which the motors wind
        return Measurement(
            perf_counter(),
            tip_pose=tip_pose,
            tension=current * self._tension_unit,
            tendon_length=turned * self._radius,
            tip_time=tip_time,
        )

    def _read_tip(self) -> tuple[float | None, Array | None]:
        """Time [s] and pose (4, 4) of the tip as the tracker has them. Raises TypeError."""
        if self.tip_pose is None:
            return None, None
        newest = self.tip_pose()
        if isinstance(newest, tuple):
            if len(newest) != 2:
                raise TypeError(
                    f"tip_pose should return (time, pose), not a tuple of {len(newest)}"
                )
            return newest
        pose = np.array(newest)
        # measured poses have noise: one that stays the same to the last bit was not measured anew
        if self._bare_pose is None or not np.array_equal(pose, self._bare_pose):
            self._bare_pose = pose
            self._bare_time = perf_counter()
        return self._bare_time, pose

    def write(self, command: Array) -> Array:
        """Sends tensions in one packet.

        Args:
            command: (n_a,) [N].

        Returns:
            The tensions (n_a,) [N] that were sent: whole steps of current, never beyond what was
            asked, within the motors' limits.

        Raises:
            ConnectionError: where the port is lost, or a motor does not answer.
            TypeError: for what is no array of numbers.
            ValueError: for another shape.
        """
        shape = (len(self.ids),)
        tension = checked_array("command", command, shape)
        steps = tension / self._tension_unit
        direction = np.sign(steps)
        rounded = steps + ROUND_OFF * direction
        whole = np.trunc(rounded)
        most = np.array(self._most)
        ticks = np.clip(whole, -most, most)
        silence = perf_counter() - self._heard
        if silence > 0.5 * self.watchdog:
            # a motor that has stopped for the silence goes on
            self._set(EVERYBODY, BUS_WATCHDOG, 0)
            units = round(self.watchdog / WATCHDOG_UNIT)
            self._set(EVERYBODY, BUS_WATCHDOG, units)
        self._sender.clearParam()
        for motor, goal in zip(self.ids, ticks, strict=True):
            packed = struct.pack(GOAL_FORMAT, int(goal))
            self._sender.addParam(motor, packed)
        # once: the next period sends anew
        self._ask("the motors", lambda: (None, self._sender.txPacket(), 0), tries=1)
        self._heard = perf_counter()
        return np.asarray(ticks * self._tension_unit)

    def close(self) -> None:
        """Takes the torque off and closes the port, as far as it is there.

        Raises:
            ConnectionError: where the port is lost.
        """
        try:
            self._set(EVERYBODY, BUS_WATCHDOG, 0)
            self._set(EVERYBODY, TORQUE_ENABLE, 0)
        finally:
            self._port.closePort()

    def _read_present(self) -> Array:
        """Present currents, velocities and positions (3, n_a) in steps.

        Raises ConnectionError.
        """
        self._ask("the motors", lambda: (None, self._reader.txRxPacket(), 0))
        self._heard = perf_counter()
        answers = [bytes(self._reader.data_dict[motor]) for motor in self.ids]
        rows = [struct.unpack(FORMAT, answer) for answer in answers]
        return np.array(rows, dtype=float).T

    def _set(self, motor: int, register: int, value: int) -> None:
        """Set a register of one byte of a motor, or of EVERYBODY.

        Raises ConnectionError.
        """

        def write() -> tuple[None, int, int]:
            result, error = self._packets.write1ByteTxRx(self._port, motor, register, value)
            return None, result, error

        self._ask(f"motor {motor}", write)

    def _ask(self, who: str, call: Callable[[], tuple[Any, int, int]], tries: int = TRIES) -> Any:
        """Value that a call of the SDK returns with its result and error.

        A lost port does not stay in use. Raises ConnectionError.
        """
        for _ in range(tries):
            try:
                value, result, error = call()
            except BaseException as lost:
                # OSError, termios.error, which is none, and KeyboardInterrupt
                self._port.is_using = False
                if not isinstance(lost, Exception):
                    raise
                raise ConnectionError(f"{self.port} is lost: {lost}") from lost
            succeeded = result == self._success
            if succeeded and not error:
                return value
        if result == self._success:
            reason = self._packets.getRxPacketError(error)
        else:
            reason = self._packets.getTxRxResult(result)
        message = f"{who} on {self.port}: {reason}"
        raise ConnectionError(message)
