"""Log of a run: one row a control period, in CSV, as `soft-tendon identify` reads it.

Columns: `hold`, the motion's name; `time` [s] at which the period begins; `measured_time` on the
robot's clock; commands that were sent (`tension_0` or `displacement_0`, ...) and `commanded_0`,
..., which the policy asked for; and what is sensed, with the zeros of the arm at rest. A motion's
first row, one period before time 0, has the command under which the arm rested until then.
"""

import contextlib
import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.types import COMMANDS, Array


def check_log(path: Path) -> None:
    """Checks that a log can be written.

    Args:
        path: of the file.

    Raises:
        ValueError: for a file that is no .csv.
        FileExistsError: for one that is there: no log is overwritten.
    """
    if path.suffix != ".csv":
        raise ValueError(
            f"the log is {path}: it should be a file *.csv, to which every row goes as soon as it"
            " is there"
        )
    if path.exists():
        others = (path.with_stem(f"{path.stem}_{k}") for k in itertools.count(2))
        unused = (other for other in others if not other.exists())
        free = next(unused)
        raise FileExistsError(
            f"the log {path} is there already, and no log is overwritten: give another name, such"
            f" as {free}"
        )


class RobotLog:
    """Writes a log, which has every row as soon as it is there.

    Without any there is no file in the end. Raises as `check_log`, OSError.
    """

    def __init__(
        self, path: Path, unit: str, senses: tuple[str, ...], tendons: int, sensors: int
    ) -> None:
        check_log(path)
        strains = [f"{s}_{strain}" for s in range(sensors) for strain in STRAINS]
        columns = {
            "tip_pose": [f"tip_{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")],
            "tip_twist": [f"tip_{name}" for name in ("wx", "wy", "wz", "vx", "vy", "vz")],
            "strain": [f"strain_{name}" for name in strains],
            "strain_rate": [f"strain_rate_{name}" for name in strains],
            "tension": [f"measured_tension_{i}" for i in range(tendons)],
            "tendon_length": [f"tendon_length_{i}" for i in range(tendons)],
            "sent": [f"{COMMANDS[unit]}_{i}" for i in range(tendons)],
            "asked": [f"commanded_{i}" for i in range(tendons)],
        }
        self.path = path
        self._motions = 0  # that the file has
        self._senses = senses
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "x", encoding="utf-8", newline="")  # noqa: SIM115 (until `close`)
        self._writer = csv.writer(self._file, lineterminator="\n")
        kinds = ("sent", "asked", *senses)
        measured = [column for name in kinds for column in columns[name]]
        header = ["hold", "time", "measured_time", *measured]
        self._writer.writerow(header)

    def begin(self, period: float, measured_time: float, reading: Reading, command: Array) -> None:
        """Begins another motion, at time 0, from rest under a command (n_a,).

        It has the reading there; period: of control [s].
        """
        self._hold = self.path.stem
        if self._motions:
            self._hold = f"{self._hold}.{self._motions}"
        # for the first period: else it is no motion
        row = self._row(-period, measured_time, reading, command, command)
        self._waiting = [row]

    def append(
        self, time: float, measured_time: float, reading: Reading, asked: Array, sent: Array
    ) -> None:
        """Appends a period that begins at a time [s].

        It has the reading then, and the commands (n_a,) that followed. Raises OSError.
        """
        self._motions += len(self._waiting)
        row = self._row(time, measured_time, reading, asked, sent)
        rows = [*self._waiting, row]
        self._writer.writerows(rows)
        self._waiting = []
        self._file.flush()

    def _row(
        self, time: float, measured_time: float, reading: Reading, asked: Array, sent: Array
    ) -> list[Any]:
        """Cells of a period."""
        numbers = [sent, asked]
        for name in self._senses:
            value = getattr(reading, name)[0]
            if name == "tip_pose":
                matrix = value[:3, :3]
                rotation = Rotation.from_matrix(matrix)
                quaternion = rotation.as_quat(canonical=True, scalar_first=True)
                position = value[:3, 3]
                value = np.concatenate([position, quaternion])
            numbers.append(value.ravel())
        values = np.concatenate(numbers).tolist()
        return [self._hold, round(time, 9), measured_time, *values]

    def close(self) -> None:
        """Closes the file; once."""
        if not self._file.closed:
            # of a full disk: what is left was told of when it was written
            with contextlib.suppress(OSError):
                self._file.close()
            if not self._motions:
                self.path.unlink(missing_ok=True)
