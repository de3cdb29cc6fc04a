"""Recorded run behind the interface of a robot: measurements of a log, one after another, for policies and estimators without an arm."""

from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.robots.clock import SteppedClock
from soft_tendon_env.robots.log import columns_of
from soft_tendon_env.robots.protocol import Measurement, Unit
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import Array


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
        times, measured_times = table.numbers([("time", 1.0), ("measured_time", 1.0)]).T
        episode = np.cumsum(np.diff(times, prepend=np.inf) <= 0.0)
        rows = [
            (int(number), _measurement(float(measured_times[k]), {name: value[k] for name, value in values.items()}))
            for k, number in enumerate(episode)
            if times[k] >= 0.0
        ]
        self._episodes = [[measurement for _, measurement in group] for _, group in groupby(rows, key=lambda row: row[0])]
        self._left: list[Measurement] = []

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
