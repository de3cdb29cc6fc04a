"""Interface of a real arm: measurements are read, and commands of its tendons written.

See docs/how_to/robots.md.
"""

from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.types import Array

Unit = Literal["N", "m"]
# tolerance of the entries of a measured pose: rotations that are sent with four digits, or as
# float32, keep it
RIGID = 1e-3


PARTS = ("read", "write", "close", "command_unit", "senses")  # of a robot


class Measurement(NamedTuple):
    """Sensor readings of an arm, in SI units; None: not measured.

    There are n_a tendons and s strain sensors.

    A reading whose time is not later than that of the one before is no new reading. The slowest
    sensor counts: a tracker that has lost sight is noticed although the motors answer.
    """

    # [s] when it was measured, of any clock; without tip_time that of the pose too
    time: float
    tip_pose: Array | None = None  # (4, 4) in the scene's world frame
    tip_twist: Array | None = None  # (6,) body twist, angular before linear
    tension: Array | None = None  # (n_a,) [N]
    tendon_length: Array | None = None  # (n_a,) [m] along the arm, from any zero
    strain: Array | None = None  # (s, 6) torsion, bending, stretch, shear; from any zero
    strain_rate: Array | None = None  # (s, 6)
    # [s] when the tracker measured pose and twist, of any clock; None: at `time`
    tip_time: float | None = None

    @property
    def time_of_pose(self) -> float:
        """Time [s] at which the pose was measured."""
        if self.tip_time is None:
            return self.time
        return self.tip_time


class Robot(Protocol):
    """Tendon-driven arm with its motors and sensors.

    `read` and `write` may raise any exception, which ends a run safely.

    What it may have besides:
        clock: of simulated arms alone, see clock.py; real ones live in real time.
        watch: `watch(slack, patience)`, called as an episode begins. From then on the driver lets
            the tendons go by itself, to the command slack (n_a,), where no call comes for longer
            than patience [s]. `RobotProcess` gives it to every driver.
        own_process: True for classes that `soft-tendon run` makes in a process of their own.
    """

    command_unit: Unit  # "N" where it is tension-driven, "m" where it is displacement-driven
    senses: tuple[str, ...]  # fields of Measurement that it gives

    def read(self) -> Measurement:
        """Reads the newest measurement; it returns soon.

        Returns:
            The measurement.
        """

    def write(self, command: Array) -> Array | None:
        """Sends a command.

        Calls come one at a time; slack comes from the watchdog's thread, also while another call
        hangs.

        Args:
            command: (n_a,) in the unit `command_unit`.

        Returns:
            The command (n_a,) that was sent, in the same unit, after limits and rounding of its
            own; None: as it is.
        """

    def close(self) -> None:
        """Releases the arm, which is slack by then."""


def check_robot(robot: Any) -> None:
    """Raises TypeError for an object without a part of `Robot`."""
    for part in PARTS:
        if not hasattr(robot, part):
            raise TypeError(
                f"{type(robot).__name__} should have {part}, see soft_tendon_env.robots.Robot"
            )


def read_fields(robot: Robot, sensors: int) -> tuple[str, ...]:
    """Fields of Measurement that are read of a robot: without strain sensors no strains."""
    if sensors:
        return tuple(robot.senses)
    return tuple(name for name in robot.senses if name not in ("strain", "strain_rate"))


def check_measurement(
    measured: Any, senses: tuple[str, ...], tendons: int, sensors: int
) -> Measurement:
    """Checks a robot's measurement.

    Args:
        measured: what `read` returned.
        senses: fields that the robot senses.
        tendons: number of them.
        sensors: number of strain sensors.

    Returns:
        The measurement of what it senses, as arrays.

    Raises:
        TypeError: for what is no Measurement, and no numbers.
        ValueError: for other shapes, NaN, what is missing, and a pose that is none.
    """
    if not isinstance(measured, Measurement):
        raise TypeError(f"read should return a Measurement, not {type(measured).__name__}")
    shapes: dict[str, tuple[int, ...]] = {
        "tip_pose": (4, 4),
        "tip_twist": (6,),
        "strain": (sensors, 6),
        "strain_rate": (sensors, 6),
    }
    time = _checked_time("measurement.time", measured.time)
    tip_time = measured.tip_time
    if tip_time is not None:
        tip_time = _checked_time("measurement.tip_time", tip_time)
    arrays = dict[str, Array]()
    for name in senses:
        shape = shapes.get(name, (tendons,))
        value = getattr(measured, name)
        arrays[name] = checked_array(f"measurement.{name}", value, shape)
    if "tip_pose" in arrays:
        _check_pose(arrays["tip_pose"])
    return Measurement(time, tip_time=tip_time, **arrays)


def _checked_time(name: str, time: Any) -> float:
    """A time [s] of any clock. Raises TypeError or ValueError."""
    return checked_number(name, time, -np.inf, "a finite number of seconds")


def _check_pose(pose: Array) -> None:
    """Raises ValueError for a matrix (4, 4) that is no pose."""
    R = pose[:3, :3]
    errors = (
        np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max(),
        np.abs(R @ R.T - np.eye(3)).max(),
        1.0 - np.sign(np.linalg.det(R)),  # of a mirror image 2
    )
    if max(errors) > RIGID:
        raise ValueError(
            "measurement.tip_pose is no pose [[R, r], [0, 0, 0, 1]] with a rotation R, by"
            f" {max(errors):.3g}: is it transposed?"
        )
