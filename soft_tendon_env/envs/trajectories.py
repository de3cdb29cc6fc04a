"""Targets of all rows: how episodes draw them, under loads from a bank of motions, and tables of
what is ahead."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.kernels import TargetTable, targets_ahead
from soft_tendon_env.envs.targets import Course, PoseCourse, Setting, Target, TargetSamples
from soft_tendon_env.envs.targets.shipped import FixedPose
from soft_tendon_env.model.statics import rests_at_tensions
from soft_tendon_env.tools.types import Array

CHUNK = 256  # control periods that are sampled at a time
# those that are sampled when an episode begins, beside the preview: few, so that resets are quick
FIRST_CHUNK = 4
MOST_DRAWS = 200  # how often goals are drawn that are reached already, before they are taken
BANK = 64  # motions in a bank, each with as many beginnings as it has control periods
BANK_SEED = (
    2**64
    # seed of the first motion of a bank; the others follow, one apart: beyond all seeds of `reset`
    # that have a purpose
)


class TargetTrajectories:
    """Rows of target motions."""

    def __init__(self, arms: Arms, period: float, ahead: Sequence[int], shapes: bool) -> None:
        """ahead: control periods at which the target is wanted, 0 for now first; shapes: keep more
        than the tip's pose and twist."""
        model, rows, self._stations = arms.model, arms.size, arms.places.station.size
        self._arms, self._period, self._longest, self._room = (
            arms,
            period,
            max(ahead),
            CHUNK + max(ahead),
        )
        self._course: list[Course] = [FixedPose(np.eye(4))] * rows  # until they begin
        self._first = np.zeros(
            rows, dtype=np.int64
        )  # control period of the course at which the episode begins
        self._until = np.zeros(
            rows, dtype=np.int64
        )  # what has been sampled of each, of which the tables hold the last
        self._periods_left = 0  # in which no row can run out
        sizes = (
            [6, model.coordinate_count, model.tendon_count, 3 * self._stations]
            if shapes
            else [6, 0, 0, 0]
        )
        self._sizes, self._borders = sizes, np.cumsum(sizes).tolist()
        flat = np.empty((rows, len(ahead), 0))
        self._no_shapes = (
            () if shapes else (flat, flat, np.empty((rows, len(ahead), self._stations, 3)))
        )
        self._table = TargetTable(
            pose=np.tile(np.eye(4), (rows, self._room, 1, 1)),
            other=np.zeros(
                (rows, self._room, self._borders[-1])
            ),  # twist, q, tendon lengths and positions of the stations
            ahead=np.array(ahead, dtype=np.int64),
        )

    def begin(self, row: int, course: Course, first: int = 0, now: int = 0) -> None:
        """A new target for a row: control period `first` of its course is in `now` of the
        episode."""
        self._course[row], self._first[row], self._until[row], self._periods_left = (
            course,
            first - now,
            now,
            0,
        )

    def prepare(self, step_count: Indices, members: Indices) -> None:
        """Sample on, where the rows `members` have run out, which are a control period on at the
        most since the last call."""
        self._periods_left -= 1
        if self._periods_left > 0:
            return
        due = members[step_count[members] + self._longest >= self._until[members]].tolist()
        times = []
        for row in due:
            start, count = (
                self._until[row],
                CHUNK if self._until[row] else FIRST_CHUNK + self._longest,
            )
            times.append(self._first[row] + np.arange(start, start + count))
        sampled = self.sample(
            [self._course[row] for row in due], [self._period * periods for periods in times]
        )
        for row, periods, samples in zip(due, times, sampled, strict=True):
            place = (periods - self._first[row]) % self._room
            positions = samples.backbone[..., :3, 3].reshape(len(periods), -1)
            parts = samples.tip_twist, samples.q, samples.tendon_length, positions
            others = [part[:, :size] for part, size in zip(parts, self._sizes, strict=True)]
            self._table.pose[row, place], self._table.other[row, place] = (
                samples.tip_pose,
                np.concatenate(others, axis=1),
            )
            self._until[row] += len(periods)
        self._periods_left = int(np.min(self._until - step_count)) - self._longest

    def at(self, row: int, times: Array) -> TargetSamples:
        """A row's target at times (m,) [s] from the beginning of its episode."""
        return self.sample([self._course[row]], [times + self._period * self._first[row]])[0]

    def sample(self, courses: list[Course], times: list[Array]) -> list[TargetSamples]:
        """Every course at its times (m,); coordinates are pushed through the kinematics all
        together. Raises StrainLimitError."""
        found = {
            i: course.sample(times[i])
            for i, course in enumerate(courses)
            if isinstance(course, PoseCourse)
        }
        motions = {
            i: course.coordinates(times[i])
            for i, course in enumerate(courses)
            if not isinstance(course, PoseCourse)
        }
        if motions:
            q, q_dot = (np.concatenate(parts) for parts in zip(*motions.values(), strict=True))
            read, start = self._read(q, q_dot), 0
            for i, (shape, _) in motions.items():
                found[i] = TargetSamples(*(field[start : start + len(shape)] for field in read))
                start += len(shape)
        return [found[i] for i in range(len(courses))]

    def _read(self, q: Array, q_dot: Array) -> TargetSamples:
        """Targets of coordinates and rates (m, n) that follow one another. Raises StrainLimitError
        where they have no strain."""
        moved = (q[1:] != q[:-1]).any(axis=1) | (q_dot[1:] != q_dot[:-1]).any(axis=1)
        fresh = np.concatenate([[True], moved])  # targets that stay are read once
        reading, good = self._arms.read_samples(q[fresh], q_dot[fresh])
        if not good.all():
            self._arms.model.tip_pose(
                q[fresh][~good][0]
            )  # raises: it says which tendon is at its limit
        found = np.cumsum(fresh) - 1
        return TargetSamples(
            reading.tip_pose[found],
            reading.tip_twist[found],
            q,
            reading.tendon_length[found],
            reading.backbone[found],
        )

    def now_and_ahead(
        self, step_count: Indices, tip_pose: Array
    ) -> tuple[TargetSamples, Array, Array]:
        """The targets (rows, 1 + previews, ..) of rows at their step counts (rows,), the SE(3)
        logarithms (rows, 1 + previews, 6) to them from the poses of the tips (rows, 4, 4), and
        distance [m] and angle [rad] to those of now, (2, rows); new arrays."""
        rows, m = len(step_count), self._table.ahead.size
        pose, other, error = (
            np.empty((rows, m, 4, 4)),
            np.empty((rows, m, self._borders[-1])),
            np.empty((rows, m, 6)),
        )
        off = np.empty((2, rows))
        targets_ahead(self._table, step_count, tip_pose, pose, other, error, off)
        return (
            (
                TargetSamples(pose, other, *self._no_shapes)
                if self._no_shapes
                else self._targets(pose, other)
            ),
            error,
            off,
        )

    def until(self, step_count: Indices, periods: int) -> TargetSamples:
        """The targets (rows, 1 + periods, ..) of now and of the periods ahead. Raises ValueError
        beyond the longest preview."""
        if periods > self._longest:
            raise ValueError(
                f"targets are known for the longest preview, {self._longest} control periods, not"
                f" for {periods}"
            )
        place = (step_count[:, None] + np.arange(1 + periods)) % self._room
        row = np.arange(len(place))[:, None]
        return self._targets(self._table.pose[row, place], self._table.other[row, place])

    def _targets(self, pose: Array, other: Array) -> TargetSamples:
        """Targets of the tables' entries (rows, m, ..), whose backbones are positions (rows, m,
        stations, 3)."""
        twist, q, length, _ = self._borders
        backbone = other[..., length:].reshape(*pose.shape[:2], self._stations, 3)
        return TargetSamples(
            pose, other[..., :twist], other[..., twist:q], other[..., q:length], backbone
        )


class TargetDraws:
    """Draws of targets for the rows of an environment.

    Under loads a motion takes many equilibria. There, one of BANK motions is drawn in place of a
    new one, and the control period of it at which the episode begins. A motion of the bank depends
    on target and number alone, is computed when it is first asked for, and stays.
    """

    def __init__(
        self, setting: Setting, trajectories: TargetTrajectories, period: float, away: float = 0.0
    ) -> None:
        """period: of control [s]; away: distance [m] that goals have from where the tip begins, 0:
        any."""
        self._setting, self._trajectories, self._period, self._away = (
            setting,
            trajectories,
            period,
            away,
        )
        self._has_bank, self._bank = (
            not rests_at_tensions(setting.model),
            dict[tuple[str, int], Course](),
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bank": {}}  # of which every motion can be computed again

    def fill_bank(self, target: Target | Course) -> None:
        """Compute all motions of a target in the bank ahead, so that no reset waits for them.
        Raises ConfigurationError."""
        if self._has_bank and isinstance(target, Target) and target.repeats is not None:
            for number in range(BANK * target.kinds):
                self._motion(target, number)

    def begin(
        self,
        row: int,
        target: Target | Course,
        generator: np.random.Generator,
        tip: Array,
        now: int = 0,
    ) -> None:
        """Give a row its target in control period `now` of its episode, a goal away from the tip
        (3,) unless it begins at rest; where all goals are reached a warning says so."""
        if not isinstance(target, Target):
            self._trajectories.begin(row, target, now=now)
            return
        away = 0.0 if target.begins_at_rest else self._away
        for _ in range(MOST_DRAWS):
            course, first = self._draw(target, generator)
            if not away or self._distance(course, first, tip) > away:
                break
        else:
            text = (
                f"a goal was within the threshold, {1e3 * away:.3g} mm, of where the tip begins in"
                f" {MOST_DRAWS} draws"
            )
            warnings.warn(
                f"{text}: the episode begins solved; choose a smaller threshold, or a larger"
                " fraction of tensions",
                stacklevel=2,
            )
        self._trajectories.begin(row, course, first, now)

    def _draw(self, target: Target, generator: np.random.Generator) -> tuple[Course, int]:
        """A course, and the control period of it to begin at."""
        if not self._has_bank or target.repeats is None:
            return target.draw(generator, self._setting), 0
        mosts = BANK * target.kinds, max(round(target.repeats / self._period), 1)
        number, first = (int(generator.integers(most)) for most in mosts)
        return self._motion(target, number), first

    def _motion(self, target: Target, number: int) -> Course:
        key = target.model_dump_json(), number
        if key not in self._bank:
            self._bank[key] = target.draw(np.random.default_rng(BANK_SEED + number), self._setting)
        return self._bank[key]

    def _distance(self, course: Course, first: int, tip: Array) -> float:
        """Distance [m] from the tip (3,) to where a course begins, as it is observed."""
        start = self._trajectories.sample([course], [np.array([self._period * first])])[0].tip_pose[
            0, :3, 3
        ]
        return float(np.linalg.norm(start.astype(np.float32) - tip))
