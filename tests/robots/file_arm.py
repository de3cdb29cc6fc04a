"""Driver for tests of other processes: a motionless arm that writes what it is sent into a file."""

from pathlib import Path
from time import perf_counter

import numpy as np

from soft_tendon_env.robots import Measurement
from soft_tendon_env.robots.clock import Clock

POSE = np.eye(4)
POSE[0, 3] = 0.29


class FileArm:
    """Three tendons; the greatest tension of every command is a line of the file."""

    command_unit = "N"
    senses = ("tip_pose",)
    own_process = True

    def __init__(self, path, fails=""):
        if fails == "begins":
            raise OSError(2, "No such file or directory", path)
        self._file = open(path, "a", encoding="utf-8")  # noqa: SIM115 (until `close`)
        self._fails = fails

    def read(self):
        if self._fails == "reading":
            raise ConnectionError("the tracker is gone")
        return Measurement(perf_counter(), tip_pose=POSE)

    def write(self, command):
        print(command.max(), file=self._file, flush=True)
        return command

    def close(self):
        print("closed", file=self._file, flush=True)
        self._file.close()


class SteppedArm(FileArm):
    """The same in stepped time."""

    def __init__(self, path):
        super().__init__(path)
        self.clock = Clock(real=False)


def lines(path):
    """What an arm wrote, without a line that is not finished."""
    if not Path(path).exists():
        return []
    text = Path(path).read_text(encoding="utf-8")
    return text[: text.rfind("\n") + 1].splitlines()


def tensions(path):
    """Greatest tensions that were sent, in their order."""
    return [float(line) for line in lines(path) if line != "closed"]
