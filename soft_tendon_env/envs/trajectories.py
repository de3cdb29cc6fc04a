"""Targets of all rows: how episodes draw them, under loads from a bank, and tables of them."""

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

CHUNK = 256
"""Control periods of a target that are sampled at a time."""

FIRST_CHUNK = 4
"""Control periods that are sampled when an episode begins, beside the preview: few, so that resets
are quick."""

MOST_DRAWS = 200
"""How often goals are drawn that are reached already, before they are taken."""

BANK = 64
"""Motions in a bank, each with as many beginnings as it has control periods."""

BANK_SEED = 2**64
"""Seed of the first motion of a bank; the others follow, one apart: beyond all seeds of `reset`
that have a purpose."""


POSE_BYTES = 8 * (16 + 6)
"""Memory [bytes] of a sampled pose and twist."""


def least_bytes(preview: Sequence[float], period: float) -> int:
    """Memory [bytes] that the table of a row's targets takes at least.

    Args:
        preview: times [s] ahead.
        period: of control [s].
    """
    periods = (round(time / period) for time in preview)
    longest = max(periods, default=0)
    return (CHUNK + longest) * POSE_BYTES


class TargetTrajectories:
    """Rows of target motions, and a table of each that reaches as far ahead as the preview."""

    def __init__(
        self,
        arms: Arms,
        period: float,
        ahead: Sequence[int],
        shapes: bool,
    ) -> None:
        """Make tables for the rows of arms, whose targets do not move until they begin.

        Args:
            arms: whose kinematics read the targets that are shapes.
            period: of control [s].
            ahead: control periods at which targets are read, 0 for now first.
            shapes: keep more than the tip's pose and twist.
        """
        model = arms.model
        rows = arms.size
        self._arms = arms
        self._period = period
        self._stations = arms.places.station.size
        self._longest = max(ahead)
        self._room = CHUNK + self._longest
        fixed = FixedPose(np.eye(4))
        self._course: list[Course] = [fixed] * rows  # until they begin
        # control period of the course at which the episode begins
        self._first = np.zeros(rows, dtype=np.int64)
        # what has been sampled of each, of which the tables hold the last
        self._until = np.zeros(rows, dtype=np.int64)
        self._periods_left = 0  # in which no row can run out

        # of the parts beside the pose: twist, q, tendon lengths and positions of the stations
        self._sizes = [6, 0, 0, 0]
        if shapes:
            shape_size = 3 * self._stations
            self._sizes = [6, model.coordinate_count, model.tendon_count, shape_size]
        self._borders = np.cumsum(self._sizes).tolist()
        # q, tendon lengths and backbones of targets that are poses alone
        self._no_shapes: tuple[Array, ...] = ()
        if not shapes:
            flat = np.empty((rows, len(ahead), 0))
            shape = (rows, len(ahead), self._stations, 3)
            backbone = np.empty(shape)
            self._no_shapes = (flat, flat, backbone)
        self._table = TargetTable(
            pose=np.tile(np.eye(4), (rows, self._room, 1, 1)),
            other=np.zeros((rows, self._room, self._borders[-1])),
            ahead=np.array(ahead, dtype=np.int64),
        )

    def begin(
        self,
        row: int,
        course: Course,
        first: int = 0,
        now: int = 0,
    ) -> None:
        """Give a row a new target.

        Args:
            row: whose target it is.
            course: the motion of the target.
            first: control period of the course that is in `now`.
            now: control period of the episode.
        """
        self._course[row] = course
        self._first[row] = first - now
        self._until[row] = now
        self._periods_left = 0

    def prepare(self, step_count: Indices, members: Indices) -> None:
        """Sample on, where rows have run out.

        Args:
            step_count: (rows,) control periods since the episodes began.
            members: rows that have moved on, by a control period at the most since the last call.

        Raises:
            StrainLimitError: where a target has no strain.
        """
        self._periods_left -= 1
        if self._periods_left > 0:
            return
        farthest = step_count + self._longest
        ends = self._until[members]
        runs_out = farthest[members] >= ends
        due = members[runs_out].tolist()
        periods = [self._next_periods(row) for row in due]
        courses = [self._course[row] for row in due]
        times = []
        for counts in periods:
            seconds = self._period * counts
            times.append(np.asarray(seconds, dtype=np.float64))
        sampled = self.sample(courses, times)
        for row, counts, samples in zip(due, periods, sampled, strict=True):
            self._keep(row, counts, samples)
        periods_known = self._until - farthest
        self._periods_left = int(np.min(periods_known))

    def _next_periods(self, row: int) -> Indices:
        """Control periods (m,) of a row's course that are to be sampled next."""
        start = self._until[row]
        if start:
            count = CHUNK
        else:
            count = FIRST_CHUNK + self._longest
        counts = np.arange(start, start + count)
        numbers = self._first[row] + counts
        return np.asarray(numbers)

    def _keep(
        self,
        row: int,
        periods: Indices,
        samples: TargetSamples,
    ) -> None:
        """Write samples at control periods (m,) of a row's course into the tables."""
        places = samples.backbone[..., :3, 3]
        positions = places.reshape(len(periods), -1)
        parts = [
            samples.tip_twist,
            samples.q,
            samples.tendon_length,
            positions,
        ]
        # of targets that are poses alone the tables have the twist beside the pose
        others = []
        for part, size in zip(parts, self._sizes, strict=True):
            others.append(part[:, :size])
        # tables hold the last samples: newer ones take the places of older ones
        since_first = periods - self._first[row]
        place = since_first % self._room
        table = self._table
        table.pose[row, place] = samples.tip_pose
        table.other[row, place] = np.concatenate(others, axis=1)
        self._until[row] += len(periods)

    def at(self, row: int, times: Array) -> TargetSamples:
        """Target of a row.

        Args:
            row: whose target it is.
            times: (m,) [s] from the beginning of its episode.

        Returns:
            Samples of the target.

        Raises:
            StrainLimitError: where it has no strain.
        """
        beginning = self._period * self._first[row]
        course = self._course[row]
        (samples,) = self.sample([course], [times + beginning])
        return samples

    def sample(self, courses: list[Course], times: list[Array]) -> list[TargetSamples]:
        """Samples of courses, whose coordinates go through the kinematics all together.

        Args:
            courses: motions of targets.
            times: of each, (m,) [s].

        Returns:
            The samples of each course.

        Raises:
            StrainLimitError: where coordinates have no strain.
        """
        samples: dict[int, TargetSamples] = {}
        motions: dict[int, tuple[Array, Array]] = {}
        for i, course in enumerate(courses):
            if isinstance(course, PoseCourse):
                samples[i] = course.sample(times[i])
            else:
                motions[i] = course.coordinates(times[i])
        if motions:
            every_q, every_q_dot = zip(*motions.values(), strict=True)
            q = np.concatenate(every_q)
            q_dot = np.concatenate(every_q_dot)
            together = self._read(q, q_dot)
            start = 0
            for i, (shapes, _) in motions.items():
                end = start + len(shapes)
                part = (field[start:end] for field in together)
                samples[i] = TargetSamples(*part)
                start = end
        return [samples[i] for i in range(len(courses))]

    def _read(self, q: Array, q_dot: Array) -> TargetSamples:
        """Targets of coordinates and rates (m, n) that follow one another.

        Raises StrainLimitError where they have no strain.
        """
        # targets that stay are read once
        changes = q[1:] != q[:-1]
        is_elsewhere = changes.any(axis=1)
        changes_of_rate = q_dot[1:] != q_dot[:-1]
        has_other_rates = changes_of_rate.any(axis=1)
        is_new_by_row = [[True], is_elsewhere | has_other_rates]
        is_new = np.concatenate(is_new_by_row)
        new_q = q[is_new]
        reading, has_strain = self._arms.read_samples(new_q, q_dot[is_new])
        if not has_strain.all():
            # this raises, and says which tendon is at its limit
            strained = new_q[~has_strain][0]
            self._arms.model.tip_pose(strained)
        number = np.cumsum(is_new) - 1
        return TargetSamples(
            reading.tip_pose[number],
            reading.tip_twist[number],
            q,
            reading.tendon_length[number],
            reading.backbone[number],
        )

    def now_and_ahead(
        self, step_count: Indices, tip_pose: Array
    ) -> tuple[TargetSamples, Array, Array]:
        """Targets of all rows now and at the preview times, and the tips' errors to them, new.

        Args:
            step_count: (rows,) control periods since the episodes began.
            tip_pose: (rows, 4, 4) of the tips.

        Returns:
            The targets (rows, 1 + previews, ..), the SE(3) logarithms (rows, 1 + previews, 6) to
            them from the tips, and distance [m] and angle [rad] to those of now, (2, rows).
        """
        rows = len(step_count)
        count = self._table.ahead.size
        pose = np.empty((rows, count, 4, 4))
        width = self._borders[-1]
        shape = (rows, count, width)
        other = np.empty(shape)
        error = np.empty((rows, count, 6))
        offset = np.empty((2, rows))
        targets_ahead(
            self._table,
            step_count,
            tip_pose,
            pose,
            other,
            error,
            offset,
        )
        if self._no_shapes:
            samples = TargetSamples(pose, other, *self._no_shapes)
            return samples, error, offset
        return self._targets(pose, other), error, offset

    def until(self, step_count: Indices, periods: int) -> TargetSamples:
        """Targets of all rows (rows, 1 + periods, ..) of now and of the periods ahead.

        Args:
            step_count: (rows,) control periods since the episodes began.
            periods: control periods ahead, at most those of the longest preview.

        Returns:
            The targets (rows, 1 + periods, ..).

        Raises:
            ValueError: beyond the longest preview.
        """
        if periods > self._longest:
            raise ValueError(
                f"targets are known for the longest preview, {self._longest} control periods, not"
                f" for {periods}"
            )
        ahead = np.arange(1 + periods)
        numbers = step_count[:, None] + ahead
        place = numbers % self._room
        rows = np.arange(len(place))
        row = rows[:, None]
        pose = self._table.pose[row, place]
        other = self._table.other[row, place]
        return self._targets(pose, other)

    def _targets(self, pose: Array, other: Array) -> TargetSamples:
        """Targets of the tables' entries (rows, m, ..).

        Their backbones are positions (rows, m, stations, 3).
        """
        twist_end, q_end, length_end, _ = self._borders
        positions = other[..., length_end:]
        return TargetSamples(
            pose,
            other[..., :twist_end],
            other[..., twist_end:q_end],
            other[..., q_end:length_end],
            positions.reshape(*pose.shape[:2], self._stations, 3),
        )


class TargetDraws:
    """Draws of targets for the rows of an environment.

    Under loads a motion takes many equilibria. There, one of BANK motions is drawn in place of a
    new one, and the control period of it at which the episode begins. A motion of the bank depends
    on target and number alone, is computed when it is first asked for, and stays.
    """

    def __init__(
        self,
        setting: Setting,
        trajectories: TargetTrajectories,
        period: float,
        away: float = 0.0,
    ) -> None:
        """Make an empty bank.

        Args:
            setting: of the arms that targets are drawn for.
            trajectories: which get the drawn targets.
            period: of control [s].
            away: distance [m] that goals have from where the tip begins, 0: any.
        """
        self._setting = setting
        self._trajectories = trajectories
        self._period = period
        self._away = away
        self._has_bank = not rests_at_tensions(setting.model)
        self._bank = dict[tuple[str, int], Course]()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bank": {}}  # of which every motion can be computed again

    def fill_bank(self, target: Target | Course) -> None:
        """Compute all motions of a target in the bank ahead, so that no reset waits for them.

        Args:
            target: one that is drawn; the course of one that is not has no bank.

        Raises:
            ConfigurationError: where the arm can hold none.
        """
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
        """Give a row its target, and warn where all goals of many draws are reached already.

        Args:
            row: whose target it is.
            target: one that is drawn, or the course of one that is not.
            generator: of the row's episode.
            tip: position (3,) [m] of the tip, from which goals are away.
            now: control period of the episode.

        Raises:
            ConfigurationError: where the arm can hold none.
        """
        if not isinstance(target, Target):
            self._trajectories.begin(row, target, now=now)
            return
        away = self._away
        if target.begins_at_rest:
            away = 0.0
        for _ in range(MOST_DRAWS):
            course, first = self._draw(target, generator)
            is_far_enough = not away or self._distance(course, first, tip) > away
            if is_far_enough:
                break
        else:
            warnings.warn(
                f"a goal was within the threshold, {1e3 * away:.3g} mm, of where the tip begins in"
                f" {MOST_DRAWS} draws: the episode begins solved; choose a smaller threshold, or a"
                " larger fraction of tensions",
                stacklevel=2,
            )
        self._trajectories.begin(row, course, first, now)

    def _draw(self, target: Target, generator: np.random.Generator) -> tuple[Course, int]:
        """A course, and the control period of it to begin at."""
        if not self._has_bank or target.repeats is None:
            return target.draw(generator, self._setting), 0
        motions = BANK * target.kinds
        periods = target.repeats / self._period
        beginnings = max(round(periods), 1)
        number = int(generator.integers(motions))
        first = int(generator.integers(beginnings))
        return self._motion(target, number), first

    def _motion(self, target: Target, number: int) -> Course:
        """A motion of the bank by its number."""
        key = target.model_dump_json(), number
        if key not in self._bank:
            generator = np.random.default_rng(BANK_SEED + number)
            self._bank[key] = target.draw(generator, self._setting)
        return self._bank[key]

    def _distance(
        self,
        course: Course,
        first: int,
        tip: Array,
    ) -> float:
        """Distance [m] from the tip (3,) to where a course begins, as it is observed."""
        seconds = self._period * first
        time = np.array([seconds])
        (samples,) = self._trajectories.sample([course], [time])
        position = samples.tip_pose[0, :3, 3]
        start = position.astype(np.float32)
        return float(np.linalg.norm(start - tip))
