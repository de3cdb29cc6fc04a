"""The targets of all rows, sampled ahead of time in tables that move along."""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.targets import Course, PoseCourse, Samples, ShapeCourse
from soft_tendon_env.scene import Array

CHUNK = 256
"""Control periods that a table holds beside the preview."""


class Courses:
    """Rows of target motions."""

    def __init__(self, arms: Arms, period: float, ahead: Sequence[int], shapes: bool) -> None:
        """ahead: control periods at which the target is wanted, 0 for now first; shapes: keep more than the tip's pose and twist."""
        model, rows, stations = arms.model, arms.size, arms.places.station.size
        self._arms, self._period = arms, period
        self._ahead = np.array(ahead, dtype=np.int64)
        samples = CHUNK + int(self._ahead.max())
        self._course: list[Course | None] = [None] * rows
        self._first = np.zeros(rows, dtype=np.int64)
        self._row = np.arange(rows)[:, None]
        self._table = Samples(
            tip_pose=np.tile(np.eye(4), (rows, samples, 1, 1)),
            tip_twist=np.zeros((rows, samples, 6)),
            q=np.zeros((rows, samples, model.coordinate_count if shapes else 0)),
            tendon_length=np.zeros((rows, samples, model.tendon_count if shapes else 0)),
            backbone=np.zeros((rows, samples, stations, 3)),
        )

    def begin(self, row: int, course: Course) -> None:
        """A new target for a row."""
        self._course[row], self._first[row] = course, -CHUNK

    def prepare(self, step_count: Indices, members: Indices) -> None:
        """Sample on, where the rows `members` have run out."""
        due = members[step_count[members] >= self._first[members] + CHUNK]
        self._first[due] = step_count[due]
        courses = {row: self._course[row] for row in due.tolist()}
        shapes = {row: course for row, course in courses.items() if isinstance(course, ShapeCourse)}
        for row, samples in zip(shapes, self._posed([course.coordinates(self._times(row)) for row, course in shapes.items()]), strict=True):
            self._keep(row, samples)
        for row, course in courses.items():
            if isinstance(course, PoseCourse):
                self._keep(row, course.sample(self._times(row)))

    def at(self, row: int, times: Array) -> Samples:
        """A row's target at times (m,) [s] from the beginning of its episode."""
        course = self._course[row]
        if isinstance(course, PoseCourse):
            return course.sample(times)
        assert course is not None, "a row begins before it is looked at"
        return self._posed([course.coordinates(times)])[0]

    def _times(self, row: int) -> Array:
        return self._period * (self._first[row] + np.arange(self._table.tip_pose.shape[1]))

    def _posed(self, motions: list[tuple[Array, Array]]) -> list[Samples]:
        """Coordinates and rates (samples, n) pushed through the kinematics, all together."""
        if not motions:
            return []
        q, q_dot = (np.stack(parts) for parts in zip(*motions, strict=True))
        reading, good = self._arms.read_motions(q, q_dot, self._period)
        fields = (reading.tip_pose, reading.tip_twist, q, reading.tendon_length, reading.backbone)
        found = [Samples(*parts) for parts in zip(*fields, strict=True)]
        for samples, count in zip(found, good, strict=True):
            if count < q.shape[1]:  # no strain between two knots: wait where there was one
                for values in samples:
                    values[count:] = values[max(count - 1, 0)]
                samples.tip_twist[count:] = 0.0
        return found

    def _keep(self, row: int, samples: Samples) -> None:
        for kept, values in zip(self._table, samples, strict=True):
            if kept.shape[2]:
                kept[row] = values[..., :3, 3] if kept is self._table.backbone else values

    def now_and_ahead(self, step_count: Indices) -> Samples:
        """The targets (rows, 1 + previews, ..) of rows at their step counts (rows,)."""
        index = (step_count - self._first)[:, None] + self._ahead
        empty = (*index.shape, 0)
        return Samples(*(values[self._row, index] if values.size else np.empty(empty + values.shape[3:]) for values in self._table))
