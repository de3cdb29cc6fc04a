"""Target trajectories of all rows, sampled ahead of time in tables that move along."""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.targets import Course, PoseCourse, ShapeCourse, TargetSamples
from soft_tendon_env.envs.targets.hold import FixedPose
from soft_tendon_env.model.model import StrainLimitError
from soft_tendon_env.scene.scene import Array

CHUNK = 256
"""Control periods that a table holds beside the preview."""


class Courses:
    """Rows of target motions."""

    def __init__(self, arms: Arms, period: float, ahead: Sequence[int], shapes: bool) -> None:
        """ahead: control periods at which the target is wanted, 0 for now first; shapes: keep more than the tip's pose and twist."""
        model, rows, stations = arms.model, arms.size, arms.places.station.size
        self._arms, self._period = arms, period
        self._ahead = np.array(ahead, dtype=np.int64)
        self._longest = int(self._ahead.max())
        samples = CHUNK + self._longest
        self._course: list[Course] = [FixedPose(np.eye(4))] * rows  # until they begin
        self._first = np.zeros(rows, dtype=np.int64)
        self._row = np.arange(rows)[:, None]
        self._table = TargetSamples(
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
        rows, sampled = due.tolist(), np.where(self._first[due] < 0, 0, self._longest)  # a row that has just begun has nothing yet
        self._first[due] = step_count[due]
        starts, ends = self._first[due] + sampled, self._first[due] + self._longest + CHUNK
        times = [self._period * np.arange(start, end) for start, end in zip(starts, ends, strict=True)]
        found = self._sampled([self._course[row] for row in rows], times)
        for row, start, samples in zip(rows, sampled, found, strict=True):
            self._keep(row, start, samples)

    def at(self, row: int, times: Array) -> TargetSamples:
        """A row's target at times (m,) [s] from the beginning of its episode."""
        return self._sampled([self._course[row]], [times])[0]

    def tip_positions(self, course: Course, times: Array) -> Array:
        """Where (m, 3) [m] a course takes the tip at times (m,) [s]."""
        return np.ascontiguousarray(self._sampled([course], [times])[0].tip_pose[:, :3, 3])

    def _sampled(self, courses: list[Course], times: list[Array]) -> list[TargetSamples]:
        """Every course at its times (m,); coordinates are pushed through the kinematics all together."""
        asked = list(zip(courses, times, strict=True))
        posed = iter(self._posed([course.coordinates(own) for course, own in asked if isinstance(course, ShapeCourse)]))
        return [course.sample(own) if isinstance(course, PoseCourse) else next(posed) for course, own in asked]

    def _posed(self, motions: list[tuple[Array, Array]]) -> list[TargetSamples]:
        """Coordinates and rates (m, n) pushed through the kinematics. Raises StrainLimitError where they have no strain."""
        if not motions:
            return []
        q, q_dot = (np.concatenate(parts) for parts in zip(*motions, strict=True))
        reading, good = self._arms.read_samples(q, q_dot)
        for lost in q[~good][:1]:
            self._arms.model.tip_pose(lost)  # says which tendon is at its limit
            raise StrainLimitError("the target has no strain that could be found")
        borders = np.cumsum([len(own) for own, _ in motions])[:-1]
        fields = (reading.tip_pose, reading.tip_twist, q, reading.tendon_length, reading.backbone)
        return [TargetSamples(*parts) for parts in zip(*(np.split(field, borders) for field in fields), strict=True)]

    def _keep(self, row: int, start: int, samples: TargetSamples) -> None:
        """Move a row's table along and fill it from `start` on."""
        for kept, values in zip(self._table, samples, strict=True):
            if kept.shape[2]:
                kept[row, :start] = kept[row, CHUNK : CHUNK + start]
                kept[row, start:] = values[..., :3, 3] if kept is self._table.backbone else values

    def now_and_ahead(self, step_count: Indices) -> TargetSamples:
        """The targets (rows, 1 + previews, ..) of rows at their step counts (rows,)."""
        index = (step_count - self._first)[:, None] + self._ahead
        empty = (*index.shape, 0)
        return TargetSamples(*(values[self._row, index] if values.size else np.empty(empty + values.shape[3:]) for values in self._table))
