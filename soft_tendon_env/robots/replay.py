"""Recorded run behind the interface of a robot: measurements of a log, one after another, for policies and estimators without an arm."""

from pathlib import Path

import numpy as np

from soft_tendon_env.robots.clock import SteppedClock
from soft_tendon_env.robots.log import read_log
from soft_tendon_env.robots.protocol import Measurement
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError
from soft_tendon_env.tools.types import Array


class ReplayRobot:
    """Log of a run as a robot, in stepped time: an episode of the log for every one of its environment.

    Every reading is the next row of the log, and a command changes nothing: `write` returns what was sent in that period then, and
    `deviation` (m, n_a) tells by how much the commands differ from those that were asked for. The first reading of an episode is the arm
    at rest.

    Raises ValueError, FileNotFoundError for a file that is no log.
    """

    def __init__(self, path: str | Path) -> None:
        self._run = read_log(path)
        self.command_unit, self.senses, self.clock = self._run.unit, self._run.senses, SteppedClock()
        firsts = np.flatnonzero(np.diff(self._run.episode, prepend=-1)).tolist()
        self._borders = [*firsts, len(self._run.time), len(self._run.time)]  # there is nothing after the last episode
        self._episode, self._row, self._asked, self._deviation = 0, -1, list[Array](), list[Array]()

    def begin(self) -> None:
        """Goes to the next episode, unless no reading of this one was taken."""
        if self._row >= self._borders[self._episode] and self._episode + 2 < len(self._borders):
            self._episode += 1
        self._row, self._asked = self._borders[self._episode] - 1, []

    def read(self) -> Measurement:
        """The next measurement. Raises UserError after the last one of the episode."""
        first, end = self._borders[self._episode : self._episode + 2]
        if self._row + 1 == end:
            which = f"episode {self._episode} of the log" if len(self._borders) > 3 else "the log"
            raise UserError(f"{which} ends after {end - first} periods" if end > first else "the log has no further episode")
        self._deviation += [asked - self._run.commanded[self._row] for asked in self._asked[-1:]]
        self._row, self._asked = self._row + 1, []
        return self._run.measured[self._row]

    def write(self, command: Array) -> Array:
        """Takes a command (n_a,); returns what was sent then. Raises ValueError for another number of tendons."""
        given = checked_array("command", command, self._run.sent.shape[1:])
        if self._row < self._borders[self._episode]:
            return given  # where it begins
        self._asked.append(given)
        return self._run.sent[self._row].copy()

    @property
    def deviation(self) -> Array:
        """Commands (m, n_a) of the periods that are over less those that were asked for in the log."""
        return np.array(self._deviation).reshape(-1, self._run.sent.shape[1])

    def close(self) -> None:
        """Nothing is left to let go of."""
