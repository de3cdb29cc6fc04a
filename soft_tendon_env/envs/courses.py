"""Target trajectories of all rows, sampled ahead of time in tables that move along, and the inverse statics of their poses."""

import time
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.control.feedforward import StaticFeedforward, StaticMemory
from soft_tendon_env.control.objectives import TipPose
from soft_tendon_env.control.protocol import Reference
from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.kernels import TargetTable, targets_ahead
from soft_tendon_env.envs.targets import Course, PoseCourse, ShapeCourse, TargetSamples
from soft_tendon_env.envs.targets.set_points import FixedPose
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.types import Array

CHUNK = 256
"""Control periods that are sampled at a time."""
INVERSE_CHUNK = 32
"""Those with inverse statics, which take a millisecond or two each: so few that little is in vain where an episode ends."""
FIRST_CHUNK = 4
"""Those that are sampled when an episode begins, beside the preview: few, so that resets are quick."""
SEAM = 1e-6
"""Share of the rod's length by which a tendon may be longer or shorter where a course of a pool begins again."""
ANGLE_WEIGHT = 0.1
"""Weight of a radian beside errors of position, as a share of the rod's length."""


class TargetPool(NamedTuple):
    """Courses for many episodes, at every control period until they repeat, as the tables of `Courses` have them."""

    pose: Array  # (courses, periods, 4, 4) of the tip
    other: Array  # (courses, periods, size)


class InverseStatics:
    """Inverse statics along the target poses of rows, with the least effort: several Gauss-Newton steps for the first pose of an episode
    and one for every other, so that poses that jump are reached after a few. What is out of reach is followed as near as the statics come.
    """

    def __init__(self, model: Model, limits: Array, period: float, rows: int) -> None:
        """`limits` (n_a, 2) [N] of tensions; poses are `period` [s] apart."""
        self._law, self._ahead = StaticFeedforward(model, limits, period, TipPose(ANGLE_WEIGHT * model.length)), np.array([0.0, period])
        self._at: list[StaticMemory | None] = [None] * rows

    def begin(self, row: int) -> None:
        """Another target for a row."""
        self._at[row] = None

    def coordinates(self, row: int, poses: Array) -> Array:
        """Coordinates (m, n) that hold the next poses (m, 4, 4) of a row's target."""
        found, at = [], self._at[row]
        for pose in poses:
            at, _ = self._law.followed(Reference(self._ahead, tip_pose=np.stack([pose, pose])), at)
            found.append(at.q)
        self._at[row] = at
        return np.stack(found)


class Courses:
    """Rows of target motions."""

    def __init__(
        self,
        arms: Arms,
        period: float,
        ahead: Sequence[int],
        shapes: bool,
        inverse_statics: InverseStatics | None = None,
        pool: TargetPool | None = None,
    ) -> None:
        """ahead: control periods at which the target is wanted, 0 for now first; shapes: keep more than the tip's pose and twist;
        inverse_statics: of which tendon lengths are kept, of targets that are poses alone; pool: from which all rows have their targets."""
        model, rows, stations = arms.model, arms.size, arms.places.station.size
        self._arms, self._period, self._shapes, self._stations, self._inverse = arms, period, shapes, stations, inverse_statics
        self._ahead = np.array(ahead, dtype=np.int64)
        self._longest = max(ahead)
        self._room = samples = CHUNK + self._longest
        self._course: list[Course] = [FixedPose(np.eye(4))] * rows  # until they begin
        self._until = np.zeros(rows, dtype=np.int64)  # what has been sampled of each, of which the tables hold the last
        self.pool, self._drawn = pool, np.zeros((rows, 2), dtype=np.int64)  # course of the pool, and the control period that is its first
        self.seconds = np.zeros(rows)  # that inverse statics took, by the poses that were found last for a row
        lengths = model.tendon_count if shapes or inverse_statics is not None else 0
        sizes = [6, model.coordinate_count, lengths, 3 * stations] if shapes else [6, 0, lengths, 0]
        self._sizes, self._borders = sizes, np.cumsum(sizes).tolist()
        self._table = TargetTable(
            pose=np.tile(np.eye(4), (rows, samples, 1, 1)),
            other=np.zeros((rows, samples, self._borders[-1])),  # twist, q, tendon lengths and positions of the stations
            ahead=self._ahead,
        )

    def begin(self, row: int, course: Course) -> None:
        """A new target for a row."""
        self._course[row], self._until[row] = course, 0
        if self._inverse is not None:
            self._inverse.begin(row)

    @property
    def numbers(self) -> int:
        """Number of numbers that tables hold of a target at a control period: its pose, and all else."""
        return 16 + self._borders[-1]

    def begin_in_pool(self, row: int, generator: np.random.Generator) -> None:
        """A new target for a row: one of the pool, from any of its control periods on."""
        assert self.pool is not None
        self._drawn[row], self._until[row] = generator.integers(self.pool.pose.shape[:2]), 0

    def prepare(self, step_count: Indices, members: Indices) -> None:
        """Sample on, where the rows `members` have run out."""
        if np.minimum.reduce(self._until - step_count) > self._longest:
            return
        due = members[step_count[members] + self._longest >= self._until[members]]
        if not due.size:
            return
        rows, starts = due.tolist(), self._until[due]
        is_quick = self._inverse is None or self.pool is not None
        ends = starts + np.where(starts == 0, FIRST_CHUNK + self._longest, CHUNK if is_quick else INVERSE_CHUNK)
        for row, start, (pose, other) in zip(rows, starts, self._entries(rows, starts, ends), strict=True):
            place = np.arange(start, start + len(pose)) % self._room
            self._table.pose[row, place], self._table.other[row, place] = pose, other
        self._until[due] = ends

    def _entries(self, rows: list[int], starts: Indices, ends: Indices) -> list[tuple[Array, Array]]:
        """Poses (m, 4, 4) and what else tables hold (m, size) of rows from their starts to their ends, in control periods."""
        if self.pool is not None:
            periods = self.pool.pose.shape[1]
            drawn = [(*self._drawn[row], np.arange(start, end)) for row, start, end in zip(rows, starts, ends, strict=True)]
            places = [(course, (first + step) % periods) for course, first, step in drawn]
            return [(self.pool.pose[place], self.pool.other[place]) for place in places]
        times = [self._period * np.arange(start, end) for start, end in zip(starts, ends, strict=True)]
        found = self._sampled([self._course[row] for row in rows], times)
        if self._inverse is not None:
            found = self._with_lengths(self._inverse, rows, found)
        return [self._entry(samples) for samples in found]

    def one_period(self, row: int, periods: int) -> tuple[Array, Array] | None:
        """Poses (periods, 4, 4) and what else tables hold (periods, size) of a row's target, which repeats after so many control periods.

        Inverse statics go around with it, and on until they are where they were a round before; None: they never are.
        """
        (samples,) = self._sampled([self._course[row]], [self._period * np.arange(periods, dtype=np.float64)])
        if self._inverse is None:
            return self._entry(samples)
        (samples,) = self._with_lengths(self._inverse, [row], [samples])
        for start in range(0, periods, INVERSE_CHUNK):
            part = slice(start, start + INVERSE_CHUNK)
            before = samples.tendon_length[part]
            (again,) = self._with_lengths(self._inverse, [row], [TargetSamples(*(field[part] for field in samples))])
            is_closed = np.abs(again.tendon_length[-1] - before[-1]).max() <= SEAM * self._arms.model.length
            samples.tendon_length[part] = again.tendon_length
            if is_closed:
                return self._entry(samples)
        return None

    def at(self, row: int, times: Array) -> TargetSamples:
        """A row's target at times (m,) [s] from the beginning of its episode. Raises ValueError for targets of a pool."""
        if self.pool is not None:
            raise ValueError("targets of a pool are known at control periods alone: leave target.pool out to have them at any time")
        return self._sampled([self._course[row]], [times])[0]

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
        parts = _parts([len(own) for own, _ in motions])
        return [TargetSamples(*(field[part] for field in fields)) for part in parts]

    def _with_lengths(self, inverse: InverseStatics, rows: list[int], found: list[TargetSamples]) -> list[TargetSamples]:
        """The next samples of rows with the tendon lengths (m, n_a) at which the arm holds their poses."""
        held = []
        for row, samples in zip(rows, found, strict=True):
            started = time.perf_counter()
            held.append(inverse.coordinates(row, samples.tip_pose))
            self.seconds[row] = (time.perf_counter() - started) / len(samples.tip_pose)
        q = np.concatenate(held)
        length = self._arms.read_samples(q, np.zeros_like(q))[0].tendon_length
        parts = _parts([len(samples.tip_pose) for samples in found])
        return [samples._replace(tendon_length=length[part]) for samples, part in zip(found, parts, strict=True)]

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


def _parts(sizes: list[int]) -> list[slice]:
    """Slices of parts of these sizes, one after another."""
    return [slice(start, end) for start, end in pairwise([0, *np.cumsum(sizes).tolist()])]


def _differ_from_the_last(q: Array, q_dot: Array) -> NDArray[np.bool_]:
    """Marks of the samples q, q_dot (m, n) that differ from the one before them, the first always."""
    fresh = np.ones(len(q), dtype=bool)
    alike = 1 + np.flatnonzero(q[1:, 0] == q[:-1, 0])  # most motions move every coordinate at all times
    fresh[alike] = (q[alike] != q[alike - 1]).any(axis=1) | (q_dot[alike] != q_dot[alike - 1]).any(axis=1)
    return fresh
