"""Target that follows a path from a CSV file."""

from typing import Literal

import numpy as np
from pydantic import field_validator
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from soft_tendon_env.envs.targets import Course, PoseCourse, Setting, Target, TargetSamples, pose_samples, register_target
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

COLUMNS = ("time", "x", "y", "z", "qw", "qx", "qy", "qz")
ROUNDED = 1e-3  # by which the length of a quaternion may be off
FARTHEST_POSE = 2.0  # largest coordinate of the poses, in lengths of the rod: more is not in metres


@register_target
class File(Target):
    """The tip follows poses of a CSV file, joined by cubic splines, the first held before and the last after them. `path`: a file with the
    columns time [s], x, y, z [m], qw, qx, qy, qz in the world frame; Reach ignores the orientation."""

    type: Literal["file"] = "file"
    path: str

    @field_validator("path")
    @classmethod
    def _has_poses(cls, path: str) -> str:
        FileCourse(path)
        return path

    def check(self, scene: Scene) -> None:
        course, bound = FileCourse(self.path), FARTHEST_POSE * rod_length(scene)
        farthest = np.abs(course.place(course.times)).max()
        if farthest > bound:
            allowed = f"within ±{bound:g} m, {FARTHEST_POSE:g} lengths of the rod"
            raise ConfigurationError([Problem(("target", "path"), f"has a pose at {farthest:g} m: it should lie {allowed}")], "environment")

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return FileCourse(self.path)


class FileCourse(PoseCourse):
    """Poses of a file as splines of time. Raises OSError, and ValueError for a table without poses or times that grow."""

    def __init__(self, path: str) -> None:
        try:
            table = np.genfromtxt(path, delimiter=",", names=True, ndmin=1, encoding="utf-8-sig")
        except ValueError as error:
            raise ValueError(f"should be a table with commas between the columns {', '.join(COLUMNS)}") from error
        if missing := [name for name in COLUMNS if name not in (table.dtype.names or ())]:
            raise ValueError(f"has no column {missing[0]!r}: it should have {', '.join(COLUMNS)}")
        rows = np.stack([table[name] for name in COLUMNS], axis=1)
        if len(rows) < 2 or not np.isfinite(rows).all() or np.diff(rows[:, 0]).min() <= 0.0:
            raise ValueError("should have at least two rows of numbers, with times that grow")
        if (off := np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1.0)).max() > ROUNDED:
            raise ValueError(f"has a quaternion of length 1 ± {off.max():.2g} in row {off.argmax() + 1}: it should be 1 ± {ROUNDED:g}")
        self.times = rows[:, 0]
        self.place = CubicSpline(self.times, rows[:, 1:4], bc_type="clamped")
        self._turn = RotationSpline(self.times, Rotation.from_quat(rows[:, 4:], scalar_first=True))

    def sample(self, times: Array) -> TargetSamples:
        held = np.clip(times, self.times[0], self.times[-1])
        R = self._turn(held).as_matrix()
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, :3], pose[:, :3, 3] = R, self.place(held)
        linear = (R * self.place(held, 1)[:, :, None]).sum(axis=1)
        return pose_samples(pose, (held == times)[:, None] * np.concatenate([self._turn(held, 1), linear], axis=1))
