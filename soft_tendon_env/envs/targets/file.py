"""Target that follows a path from a CSV file."""

from pathlib import Path
from typing import Literal

import numpy as np

from soft_tendon_env.envs.targets import (
    Course,
    PoseCourse,
    Setting,
    Target,
    TargetSamples,
    pose_samples,
    register_target,
)
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import UNIT, Array

COLUMNS = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns of the file."""

FARTHEST_POSE = 2.0
"""Largest coordinate of the poses, in lengths of the rod: more is not in metres."""


@register_target
class File(Target):
    """The tip follows poses of a CSV file, joined by cubic splines.

    The first is held before and the last after them. `path`: a file with the columns time [s],
    x, y, z [m], qw, qx, qy, qz in the world frame; Reach ignores the orientation.
    """

    type: Literal["file"] = "file"
    path: str

    @cached_property
    def course(self) -> "FileCourse":
        """The poses, read once.

        Raises OSError, ValueError.
        """
        return FileCourse(self.path)

    def check(self, scene: Scene) -> None:
        try:
            course = self.course
        except ValueError as error:
            raise _problem(f"is {self.path!r}: {error}") from None
        way = course.place(course.times) - scene.base.position
        farthest = np.abs(way).max()
        bound = FARTHEST_POSE * rod_length(scene)
        if farthest > bound:
            raise _problem(
                f"has a pose {farthest:g} m from the base: it should lie within ±{bound:g} m of the"
                f" base, {FARTHEST_POSE:g} lengths of the rod"
            )

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return self.course


class FileCourse(PoseCourse):
    """Poses of a table as splines of time, see `read_table`."""

    def __init__(self, path: str) -> None:
        """Read a file.

        Raises OSError, ValueError without poses or times that grow.
        """
        # these take longer to import than all else that most targets need
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        rows = _read_poses(path)
        self.times = rows[:, 0]
        self.place = CubicSpline(self.times, rows[:, 1:4], bc_type="clamped")
        turns = Rotation.from_quat(rows[:, 4:], scalar_first=True)
        self._turn = RotationSpline(self.times, turns)

    def sample(self, times: Array) -> TargetSamples:
        held = np.clip(times, self.times[0], self.times[-1])
        R = self._turn(held).as_matrix()
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, :3] = R
        pose[:, :3, 3] = self.place(held)
        velocity = self.place(held, 1)
        angular = self._turn(held, 1)
        linear = (R * velocity[:, :, None]).sum(axis=1)  # R^T velocity
        twist = np.concatenate([angular, linear], axis=1)
        # before the first pose and after the last the tip rests
        twist *= (held == times)[:, None]
        return pose_samples(pose, twist)


def _read_poses(path: str) -> Array:
    """Rows (m, 8) of a file, by COLUMNS.

    Raises OSError, ValueError.
    """
    table = read_table(Path(path), COLUMNS)
    missing = [name for name in COLUMNS if name not in table.header]
    if missing:
        raise ValueError(f"has no column {missing[0]!r}: it should have {', '.join(COLUMNS)}")
    rows = table.numbers((name, 1.0) for name in COLUMNS)
    if len(rows) < 2 or not np.isfinite(rows).all() or np.diff(rows[:, 0]).min() <= 0.0:
        raise ValueError("should have at least two rows of numbers, with times that grow")
    lengths = np.linalg.norm(rows[:, 4:], axis=1)
    deviation = np.abs(lengths - 1.0)
    if deviation.max() > UNIT:
        raise ValueError(
            f"has a quaternion of length 1 ± {deviation.max():.2g} in row {deviation.argmax() + 1}:"
            f" it should be 1 ± {UNIT:g}"
        )
    return rows


def _problem(text: str) -> ConfigurationError:
    return ConfigurationError([Problem(("target", "path"), text)], "environment")
