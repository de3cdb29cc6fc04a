"""Log of a run: one row a control period, in CSV, as `soft-tendon identify` and `ReplayRobot` read it.

    hold                 name of the motion, the file's, with a number behind it where there are several
    time                 beginning of the period [s], from that of the run
    tension_0 ...        sent, and held over the period; displacement_0 ... where the arm is driven by them
    commanded_0 ...      asked for by the policy, before limits of size and rate
    measured_time        of the measurement, on the robot's clock [s]
    tip_x ..., tip_qw ...           measured position [m] and unit quaternion of the tip, world frame; a marker named `tip`
    tip_wx ..., tip_vx ...          body twist, angular [rad/s] and linear [m/s]
    measured_tension_0 ..., tendon_length_0 ...     [N], [m]
    strain_0_torsion ..., strain_rate_0_torsion ... at every sensor: torsion, bend_y, bend_z [1/m], stretch, shear_y, shear_z

A motion's first row, one period before time 0, has the command under which the arm was held until then, and what it measures at rest.
What is measured has the zeros of the arm at rest. Columns of what an arm does not sense are not there.
"""

import contextlib
import csv
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from soft_tendon_env.robots.protocol import COMMANDS, Measurement, Unit
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import Array

POSE = [f"tip_{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
TWIST = [f"tip_{name}" for name in ("wx", "wy", "wz", "vx", "vy", "vz")]


def columns_of(unit: Unit, senses: tuple[str, ...], tendons: int, sensors: int) -> dict[str, list[str]]:
    """Names of the columns by what they hold: "sent", "commanded", and fields of Measurement."""
    each = {
        "tip_pose": POSE,
        "tip_twist": TWIST,
        "tension": [f"measured_tension_{i}" for i in range(tendons)],
        "tendon_length": [f"tendon_length_{i}" for i in range(tendons)],
        **{name: [f"{name}_{s}_{strain}" for s in range(sensors) for strain in STRAINS] for name in ("strain", "strain_rate")},
    }
    commands = {"sent": [f"{COMMANDS[unit]}_{i}" for i in range(tendons)], "commanded": [f"commanded_{i}" for i in range(tendons)]}
    return {**commands, **{name: own for name, own in each.items() if name in senses}}


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
        self.path, self._senses, self._motions = path, senses, 0
        self._columns = columns_of(unit, senses, tendons, sensors)
        names = [name for own in self._columns.values() for name in own]
        self._header = ["hold", "time", "measured_time", *names]
        self._rest: list[Any] | None = None
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "x", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")

    def begin(self, period: float, measured: Measurement, command: Array) -> None:
        """Another motion begins, at time 0, from rest under a command (n_a,), with what is measured there; period: of control [s]."""
        self._hold = f"{self.path.stem}.{self._motions}" if self._motions else self.path.stem
        self._rest = self._row(-period, measured, command, command)

    def append(self, time: float, measured: Measurement, commanded: Array, sent: Array) -> None:
        """A period that begins at a time [s], with what was measured then, and the commands (n_a,) that followed. Raises OSError."""
        rows = [self._row(time, measured, commanded, sent)]
        if self._rest is not None:
            rows = [*([] if self._motions else [self._header]), self._rest, *rows]
            self._rest, self._motions = None, self._motions + 1
        self._writer.writerows(rows)
        self._file.flush()

    def _row(self, time: float, measured: Measurement, commanded: Array, sent: Array) -> list[Any]:
        values = {"sent": sent, "commanded": commanded, **{name: getattr(measured, name) for name in self._senses}}
        if "tip_pose" in values:
            pose = values["tip_pose"]
            values["tip_pose"] = np.r_[pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True, scalar_first=True)]
        numbers = np.concatenate([values[name].ravel() for name in self._columns]).tolist()
        return [self._hold, round(time, 9), measured.time, *numbers]

    def close(self) -> None:
        """Closes the file; once."""
        if self._file.closed:
            return
        with contextlib.suppress(OSError):  # of a full disk: what is left was told of when it was written
            self._file.close()
        if not self._motions:
            self.path.unlink(missing_ok=True)


class LoggedRun(NamedTuple):
    """A log as arrays, one entry a period from time 0 of its episode on."""

    unit: Unit
    time: Array  # (m,) [s]
    sent: Array  # (m, n_a)
    commanded: Array  # (m, n_a)
    measured: tuple[Measurement, ...]
    episode: NDArray[np.int64]  # (m,) from 0 on

    @property
    def senses(self) -> tuple[str, ...]:
        """Fields of Measurement that were measured."""
        return tuple(name for name, value in self.measured[0]._asdict().items() if name != "time" and value is not None)


def read_log(path: str | Path) -> LoggedRun:
    """The log of a run. Raises ValueError where it is none, FileNotFoundError."""
    rows = read_table(Path(path))
    names = [name for name in rows.header if name != "hold"]
    table = dict(zip(names, rows.numbers((name, 1.0) for name in names).T, strict=True))
    units: tuple[Unit, ...] = ("N", "m")
    unit = next((unit for unit in units if f"{COMMANDS[unit]}_0" in table), None)
    tendons = sum(name.startswith("commanded_") for name in table)
    sensors = sum(name.startswith("strain_") and name.endswith("_torsion") and "rate" not in name for name in table)
    every = columns_of(unit or "N", Measurement._fields, max(tendons, 1), sensors)
    there = {name: own for name, own in every.items() if own and (name in ("sent", "commanded") or own[0] in table)}
    needed = ["time", "measured_time", *(name for own in there.values() for name in own)]
    if unit is None or (missing := [name for name in needed if name not in table]):
        lacks = "tension_0 or displacement_0" if unit is None else ", ".join(missing)
        raise ValueError(f"{path} is no log of a run: it has no column {lacks}")
    episode = np.cumsum(np.diff(table["time"], prepend=np.inf) <= 0.0) - 1
    counts = table["time"] >= 0.0
    if not counts.any():
        raise ValueError(f"{path} has no rows beneath the first line: there is nothing to replay")
    values = {name: np.stack([table[column][counts] for column in own], axis=1) for name, own in there.items()}
    sent, commanded = values.pop("sent"), values.pop("commanded")
    times = table["measured_time"][counts]
    measured = [_measurement(time, {name: own[k] for name, own in values.items()}) for k, time in enumerate(times)]
    return LoggedRun(unit, table["time"][counts], sent, commanded, tuple(measured), episode[counts])


def _measurement(time: float, values: dict[str, Array]) -> Measurement:
    """Measurement of a row's numbers by field."""
    shaped = {name: value.reshape(-1, 6) if name.startswith("strain") else value for name, value in values.items()}
    if "tip_pose" in shaped:
        pose, numbers = np.eye(4), shaped["tip_pose"]
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(numbers[3:], scalar_first=True).as_matrix(), numbers[:3]
        shaped["tip_pose"] = pose
    return Measurement(float(time), **shaped)
