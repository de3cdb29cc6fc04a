"""The targets of all rows, sampled ahead of time in tables that move along."""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.targets import Course, Samples
from soft_tendon_env.scene import Array

CHUNK = 128
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

    def prepare(self, step_count: Array, members: Indices) -> None:
        """Sample on, where the rows `members` have run out."""
        due = members[step_count[members] >= self._first[members] + CHUNK]
        if due.size:
            self._first[due] = step_count[due]
            self._arms.each(self._sample, due.tolist())

    def _sample(self, row: int) -> None:
        course = self._course[row]
        assert course is not None
        times = self._period * (self._first[row] + np.arange(self._table.tip_pose.shape[1]))
        samples = course.sample(times)
        for kept, values in zip(self._table, samples, strict=True):
            if kept.shape[2]:
                kept[row] = values[..., :3, 3] if kept is self._table.backbone else values

    def now_and_ahead(self, step_count: Array) -> Samples:
        """The targets (rows, 1 + previews, ..) of rows at their step counts (rows,)."""
        index = (step_count - self._first)[:, None] + self._ahead
        return Samples(*(values[self._row, index] for values in self._table))
