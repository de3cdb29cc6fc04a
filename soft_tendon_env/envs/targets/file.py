"""Target that follows a path from a CSV file."""

import warnings
from functools import cache
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
)
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.tables import read_table
from soft_tendon_env.tools.types import UNIT, Array

COLUMNS = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")
"""Columns of the file."""

FARTHEST_POSE = 2.0
"""Largest coordinate of the poses, in lengths of the rod: more is not in metres."""

REACH = 1.1
"""Distance from the base, in lengths of the rod, that a stretched arm may reach."""


class TargetWarning(UserWarning):
    """A target has poses that the arm cannot reach."""


@register("target", "file")
class File(Target):
    """The tip follows poses of a CSV file, joined by cubic curves that never overshoot.

    Between two rows each coordinate lies between theirs (PCHIP, Fritsch and Carlson 1980), and the
    tip turns along the shortest way from one to the other. The first pose is held before and the
    last after them, at rest. `path`: a file with the columns time [s], x, y, z [m], qw, qx, qy, qz
    in the world frame; Reach ignores the orientation.
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
        places = course.place(course.times)
        way = places - scene.base.position
        farthest = np.abs(way).max()
        length = rod_length(scene)
        bound = FARTHEST_POSE * length
        if farthest > bound:
            raise _problem(
                f"has a pose {farthest:g} m from the base: it should lie within ±{bound:g} m of the"
                f" base, {FARTHEST_POSE:g} lengths of the rod"
            )
        distance = np.linalg.norm(way, axis=1)
        row = int(distance.argmax())
        if distance[row] > REACH * length:
            is_beyond = distance > REACH * length
            beyond = int(is_beyond.sum())
            _warn_once(
                f"{self.path} has {beyond} of {distance.size} poses out of reach of an arm of"
                f" {length:g} m: row {row + 1}, at {course.times[row]:g} s, is"
                f" {distance[row]:.3g} m from the base"
            )

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return self.course


@cache
def _warn_once(text: str) -> None:
    """Warns of the poses of a file the first time that an arm gets them."""
    warnings.warn(text, TargetWarning, stacklevel=2)


class FileCourse(PoseCourse):
    """Poses of a table as functions of time that never overshoot, see `read_table`."""

    def __init__(self, path: str) -> None:
        """Read a file.

        Raises OSError, ValueError without poses or times that grow.
        """
        # these take longer to import than all else that most targets need
        from scipy.interpolate import CubicHermiteSpline
        from scipy.spatial.transform import Rotation

        rows = _read_poses(path)
        times = rows[:, 0]
        self.times = times
        places = rows[:, 1:4]
        slopes_of_places = _monotone_slopes(times, places)
        self.place = CubicHermiteSpline(times, places, slopes_of_places)
        # from each row the shortest turn to the next, about an axis in the frame of the row
        quaternions = rows[:, 4:]
        self._rotations = Rotation.from_quat(quaternions, scalar_first=True)
        back = self._rotations[:-1].inv()
        between = back * self._rotations[1:]
        turns = between.as_rotvec()
        angles = np.linalg.norm(turns, axis=1)
        lengths = np.where(angles > 0.0, angles, 1.0)
        self._axes = turns / lengths[:, None]
        # angle [rad] that has been turned through, whose rate falls where the axis changes
        total = np.concatenate([[0.0], np.cumsum(angles)])
        column = total[:, None]
        slopes = _monotone_slopes(times, column)[:, 0]
        slopes[1:-1] *= self._alike_axes()
        self._total = total
        self._angle = CubicHermiteSpline(times, total, slopes)

    def _alike_axes(self) -> Array:
        """Cosines (m - 2,) of the angles between the axes before and after each inner row.

        They are 0 where the axes point away from each other: a turn rests before it goes back.
        """
        # the axis of a turn is the same in the frames of both its ends
        one_axis = self._axes[:-1]
        next_axis = self._axes[1:]
        products = one_axis * next_axis
        cosines = products.sum(axis=1)
        return np.asarray(np.maximum(cosines, 0.0))

    def sample(self, times: Array) -> TargetSamples:
        from scipy.spatial.transform import Rotation

        first = self.times[0]
        last = self.times[-1]
        held = np.clip(times, first, last)
        # the row before each time
        inner = self.times[1:-1]
        before = np.searchsorted(inner, held, side="right")
        axis = self._axes[before]
        total = self._total[before]
        turned = self._angle(held) - total
        vector = turned[:, None] * axis
        turn = Rotation.from_rotvec(vector)
        rotations = self._rotations[before] * turn
        R = rotations.as_matrix()
        shape = (times.size, 1, 1)
        pose = np.tile(np.eye(4), shape)
        pose[:, :3, :3] = R
        pose[:, :3, 3] = self.place(held)
        velocity = self.place(held, 1)
        rate = self._angle(held, 1)[:, None]
        angular = rate * axis  # in the frame of the tip too
        products = R * velocity[:, :, None]
        linear = products.sum(axis=1)  # R^T velocity
        twist = np.concatenate([angular, linear], axis=1)
        # before the first pose and after the last the tip rests
        twist *= (held == times)[:, None]
        return pose_samples(pose, twist)


def _monotone_slopes(times: Array, values: Array) -> Array:
    """Slopes (m, k) of PCHIP at the rows of values (m, k): cubic curves stay between two rows.

    They are 0 at both ends, where the target rests before and after.
    """
    from scipy.interpolate import PchipInterpolator

    interpolant = PchipInterpolator(times, values)
    slopes: Array = interpolant.derivative()(times)
    slopes[[0, -1]] = 0.0
    return slopes


def _read_poses(path: str) -> Array:
    """Rows (m, 8) of a file, by COLUMNS.

    Raises OSError, ValueError.
    """
    table = read_table(Path(path), COLUMNS)
    missing = [name for name in COLUMNS if name not in table.header]
    if missing:
        message = f"has no column {missing[0]!r}: it should have {', '.join(COLUMNS)}"
        raise ValueError(message)
    columns = ((name, 1.0) for name in COLUMNS)
    rows = table.numbers(columns)
    times = rows[:, 0]
    are_numbers = np.isfinite(rows).all()
    if len(rows) < 2 or not are_numbers or np.diff(times).min() <= 0.0:
        raise ValueError("should have at least two rows of numbers, with times that grow")
    quaternions = rows[:, 4:]
    lengths = np.linalg.norm(quaternions, axis=1)
    deviation = np.abs(lengths - 1.0)
    if deviation.max() > UNIT:
        raise ValueError(
            f"has a quaternion of length 1 ± {deviation.max():.2g} in row {deviation.argmax() + 1}:"
            f" it should be 1 ± {UNIT:g}"
        )
    return rows


def _problem(text: str) -> ConfigurationError:
    return ConfigurationError([Problem(("target", "path"), text)], "environment")
