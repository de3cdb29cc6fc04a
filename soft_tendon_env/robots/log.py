"""Log of a run: one row a control period, in CSV, as `soft-tendon identify` and `ReplayRobot` read it.

Columns: `hold`, the motion's name; `time` [s] at which the period begins; `measured_time` on the robot's clock; commands that were sent
(`tension_0` or `displacement_0`, ...) and `commanded_0`, ..., which the policy asked for; and what is sensed, see `columns_of`, with the
zeros of the arm at rest. A motion's first row, one period before time 0, has the command under which the arm rested until then.
"""

import contextlib
import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.robots.clock import SteppedClock
from soft_tendon_env.robots.protocol import COMMANDS, Measurement, Unit
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import Array

POSE = [f"tip_{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
TWIST = [f"tip_{name}" for name in ("wx", "wy", "wz", "vx", "vy", "vz")]


def columns_of(tendons: int, sensors: int) -> dict[str, list[str]]:
    """Names of the columns of the fields of a Measurement."""
    strains = {name: [f"{name}_{s}_{strain}" for s in range(sensors) for strain in STRAINS] for name in ("strain", "strain_rate")}
    each = {"tension": "measured_tension", "tendon_length": "tendon_length"}
    of_tendons = {field: [f"{name}_{i}" for i in range(tendons)] for field, name in each.items()}
    return {"tip_pose": POSE, "tip_twist": TWIST, **of_tendons, **strains}


def check_log(path: Path) -> None:
    """Raises ValueError for a file that is no .csv, and FileExistsError for one that is there: no log is overwritten."""
    if path.suffix != ".csv":
        raise ValueError(f"the log is {path}: it should be a file *.csv, to which every row goes as soon as it is there")
    if path.exists():
        free = next(name for k in itertools.count(2) if not (name := path.with_stem(f"{path.stem}_{k}")).exists())
        raise FileExistsError(f"the log {path} is there already, and no log is overwritten: give another name, such as {free}")


class RobotLog:
    """Writes a log, which has every row as soon as it is there, whatever comes after. Without any row there is no file in the end.

    Raises as `check_log`, and OSError.
    """

    def __init__(self, path: Path, unit: Unit, senses: tuple[str, ...], tendons: int, sensors: int) -> None:
        check_log(path)
        columns = columns_of(tendons, sensors)
        self.path, self._motions, self._fields = path, 0, [name for name in columns if name in senses]
        commands = [f"{kind}_{i}" for kind in (COMMANDS[unit], "commanded") for i in range(tendons)]
        measured = [name for field in self._fields for name in columns[field]]
        self._rows: list[list[Any]] = [["hold", "time", "measured_time", *commands, *measured]]  # that wait for the first period
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "x", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")

    def begin(self, period: float, measured: Measurement, command: Array) -> None:
        """Another motion begins, at time 0, from rest under a command (n_a,), with what is measured there; period: of control [s]."""
        self._hold = f"{self.path.stem}.{self._motions}" if self._motions else self.path.stem
        self._rows = [*(() if self._motions else self._rows[:1]), self._row(-period, measured, command, command)]

    def append(self, time: float, measured: Measurement, commanded: Array, sent: Array) -> None:
        """A period that begins at a time [s], with what was measured then, and the commands (n_a,) that followed. Raises OSError."""
        self._motions += bool(self._rows)
        self._writer.writerows([*self._rows, self._row(time, measured, commanded, sent)])
        self._rows = []
        self._file.flush()

    def _row(self, time: float, measured: Measurement, commanded: Array, sent: Array) -> list[Any]:
        numbers = [sent, commanded]
        for name in self._fields:
            value = getattr(measured, name)
            if name == "tip_pose":
                value = np.r_[value[:3, 3], Rotation.from_matrix(value[:3, :3]).as_quat(canonical=True, scalar_first=True)]
            numbers.append(value.ravel())
        return [self._hold, round(time, 9), measured.time, *np.concatenate(numbers).tolist()]

    def close(self) -> None:
        """Closes the file; once."""
        if not self._file.closed:
            with contextlib.suppress(OSError):  # of a full disk: what is left was told of when it was written
                self._file.close()
            if not self._motions:
                self.path.unlink(missing_ok=True)


class ReplayRobot:
    """Log of a run as a robot, in stepped time: an episode of the log for every one of its environment, of which the first reading is the
    arm at rest. A command changes nothing.

    Raises ValueError, FileNotFoundError for a file that is no log.
    """

    def __init__(self, path: str | Path) -> None:
        table, self._path = read_table(Path(path)), path
        tendons = sum(name.startswith("commanded_") for name in table.header)
        if not tendons or not table.rows:
            raise ValueError(f"{path} is no log of a run: it has no column commanded_0, or no rows")
        sensors = sum(name.startswith("strain_") and name.endswith("_torsion") and "rate" not in name for name in table.header)
        fields = {name: columns for name, columns in columns_of(tendons, sensors).items() if {*columns} <= {*table.header}}
        self.command_unit: Unit = "N" if "tension_0" in table.header else "m"
        self.senses, self.clock = tuple(name for name, columns in fields.items() if columns), SteppedClock()
        values = {name: table.numbers((column, 1.0) for column in fields[name]) for name in self.senses}
        self._episodes, self._left = list[list[Measurement]](), list[Measurement]()
        for k, (time, measured_time) in enumerate(table.numbers([("time", 1.0), ("measured_time", 1.0)])):
            if time < 0.0:
                self._episodes.append([])  # at rest
            else:
                self._episodes[-1].append(_measurement(float(measured_time), {name: value[k] for name, value in values.items()}))

    def begin(self) -> None:
        """Goes to the next episode."""
        self._left = self._episodes.pop(0) if self._episodes else []

    def read(self) -> Measurement:
        """The next measurement. Raises UserError after the last one of the episode."""
        if not self._left:
            raise UserError(f"the log {self._path} has no further row of this episode")
        return self._left.pop(0)

    def write(self, command: Array) -> None:
        """Changes nothing."""

    def close(self) -> None:
        """Nothing is left to let go of."""


def _measurement(time: float, values: dict[str, Array]) -> Measurement:
    """Measurement of a row's numbers by field."""
    shaped = {name: value.reshape(-1, 6) if name.startswith("strain") else value for name, value in values.items()}
    if "tip_pose" in shaped:
        pose, numbers = np.eye(4), shaped["tip_pose"]
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(numbers[3:], scalar_first=True).as_matrix(), numbers[:3]
        shaped["tip_pose"] = pose
    return Measurement(time, **shaped)
