"""Target trajectories of all rows, sampled ahead of time in tables that move along."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.kernels import TargetTable, targets_ahead
from soft_tendon_env.envs.targets import Course, PoseCourse, ShapeCourse, TargetSamples
from soft_tendon_env.envs.targets.set_points import FixedPose
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.types import Array

CHUNK = 256
"""Control periods that are sampled at a time."""
FIRST_CHUNK = 4
"""Those that are sampled when an episode begins, beside the preview: few, so that resets are quick."""


class Courses:
    """Rows of target motions."""

    def __init__(self, arms: Arms, period: float, ahead: Sequence[int], shapes: bool) -> None:
        """ahead: control periods at which the target is wanted, 0 for now first; shapes: keep more than the tip's pose and twist."""
        model, rows, stations = arms.model, arms.size, arms.places.station.size
        self._arms, self._period, self._stations = arms, period, stations
        self._ahead = np.array(ahead, dtype=np.int64)
        self._longest = max(ahead)
        self._room = samples = CHUNK + self._longest
        self._course: list[Course] = [FixedPose(np.eye(4))] * rows  # until they begin
        self._first = np.zeros(rows, dtype=np.int64)  # control period of the course at which the episode begins
        self._until = np.zeros(rows, dtype=np.int64)  # what has been sampled of each, of which the tables hold the last
        sizes = [6, model.coordinate_count, model.tendon_count, 3 * stations] if shapes else [6, 0, 0, 0]
        self._sizes, self._borders = sizes, np.cumsum(sizes).tolist()
        self._table = TargetTable(
            pose=np.tile(np.eye(4), (rows, samples, 1, 1)),
            other=np.zeros((rows, samples, self._borders[-1])),  # twist, q, tendon lengths and positions of the stations
            ahead=self._ahead,
        )

    def begin(self, row: int, course: Course, first: int = 0) -> None:
        """A new target for a row, from control period `first` of its course on."""
        self._course[row], self._first[row], self._until[row] = course, first, 0

    def prepare(self, step_count: Indices, members: Indices) -> None:
        """Sample on, where the rows `members` have run out."""
        if np.minimum.reduce(self._until - step_count) > self._longest:
            return
        due = members[step_count[members] + self._longest >= self._until[members]]
        if not due.size:
            return
        rows, starts = due.tolist(), self._until[due]
        ends = starts + np.where(starts == 0, FIRST_CHUNK + self._longest, CHUNK)
        first = self._first[due]
        times = [self._period * np.arange(start, end) for start, end in zip(starts + first, ends + first, strict=True)]
        sampled = self._sampled([self._course[row] for row in rows], times)
        for row, start, (pose, other) in zip(rows, starts, map(self._entry, sampled), strict=True):
            place = np.arange(start, start + len(pose)) % self._room
            self._table.pose[row, place], self._table.other[row, place] = pose, other
        self._until[due] = ends

    def at(self, row: int, times: Array) -> TargetSamples:
        """A row's target at times (m,) [s] from the beginning of its episode."""
        return self._sampled([self._course[row]], [times + self._period * self._first[row]])[0]

    def tip_positions(self, course: Course, times: Array) -> Array:
        """Tip positions (m, 3) [m] of a course at times (m,) [s]."""
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
        fresh = _differ_from_the_last(q, q_dot)  # targets that stay are read once
        read = (q, q_dot) if fresh.all() else (q[fresh], q_dot[fresh])
        reading, good = self._arms.read_samples(*read)
        if not good.all():
            self._arms.model.tip_pose(read[0][~good][0])  # says which tendon is at its limit
            raise StrainLimitError("the target has no strain that could be found")
        fields = [reading.tip_pose, reading.tip_twist, reading.tendon_length, reading.backbone]
        if len(read[0]) < len(q):
            found = np.cumsum(fresh) - 1
            fields = [field[found] for field in fields]
        fields.insert(2, q)
        borders = np.cumsum([0, *(len(own) for own, _ in motions)]).tolist()
        return [TargetSamples(*(field[first:last] for field in fields)) for first, last in pairwise(borders)]

    def _entry(self, samples: TargetSamples) -> tuple[Array, Array]:
        """Poses (m, 4, 4) and what else tables hold (m, size) of samples."""
        positions = samples.backbone[..., :3, 3].reshape(len(samples.tip_pose), -1)
        parts = samples.tip_twist, samples.q, samples.tendon_length, positions
        return samples.tip_pose, np.concatenate([part[:, :size] for part, size in zip(parts, self._sizes, strict=True)], axis=1)

    def now_and_ahead(self, step_count: Indices, tip_pose: Array) -> tuple[TargetSamples, Array, Array]:
        """The targets (rows, 1 + previews, ..) of rows at their step counts (rows,), the SE(3) logarithms (rows, 1 + previews, 6) to them
        from the poses of the tips (rows, 4, 4), and distance [m] and angle [rad] to those of now, (2, rows); new arrays."""
        rows, m = len(step_count), self._ahead.size
        pose, other, error = np.empty((rows, m, 4, 4)), np.empty((rows, m, self._borders[-1])), np.empty((rows, m, 6))
        off = np.empty((2, rows))
        targets_ahead(self._table, step_count, tip_pose, pose, other, error, off)
        return self._targets(pose, other), error, off

    def until(self, step_count: Indices, periods: int) -> TargetSamples:
        """The targets (rows, 1 + periods, ..) of now and of the periods ahead. Raises ValueError beyond the longest preview."""
        if periods > self._longest:
            most = f"{self._longest} control periods, {self._longest * self._period:g} s: the longest preview"
            raise ValueError(f"targets are known for {most}, and asked for {periods} ahead")
        place = (step_count[:, None] + np.arange(1 + periods)) % self._room
        row = np.arange(len(place))[:, None]
        return self._targets(self._table.pose[row, place], self._table.other[row, place])

    def _targets(self, pose: Array, other: Array) -> TargetSamples:
        """Targets of the tables' entries (rows, m, ..), whose backbones are positions (rows, m, stations, 3)."""
        twist, q, length, _ = self._borders
        backbone = other[..., length:].reshape(*pose.shape[:2], self._stations, 3)
        return TargetSamples(pose, other[..., :twist], other[..., twist:q], other[..., q:length], backbone)


def _differ_from_the_last(q: Array, q_dot: Array) -> NDArray[np.bool_]:
    """Marks of the samples q, q_dot (m, n) that differ from the one before them, the first always."""
    fresh = np.ones(len(q), dtype=bool)
    alike = 1 + np.flatnonzero(q[1:, 0] == q[:-1, 0])  # most motions move every coordinate at all times
    fresh[alike] = (q[alike] != q[alike - 1]).any(axis=1) | (q_dot[alike] != q_dot[alike - 1]).any(axis=1)
    return fresh
