"""Episodes of a task on rows of arms: `reset` and `step` of single and vector environments.

What happens in a row depends on the generator that its episode began with and on its actions, and
on nothing else: the same for one row and for many, bit for bit. Read `begin` and `step` first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.control.protocol import SensorNoise
from soft_tendon_env.envs.actuation import Actuation
from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.observation import (
    History,
    Layout,
    Observed,
    RestValues,
    Units,
    stress_free_strain,
)
from soft_tendon_env.envs.option_units import warn_of_memory, warn_of_options
from soft_tendon_env.envs.options import (
    GOAL_BOUND,
    Options,
    ResetOptions,
    check_fit,
    checked_target,
    groups_of,
    resolved_scene,
)
from soft_tendon_env.envs.randomization import DRAWN, Measured, Randomization, Sensors
from soft_tendon_env.envs.starts import Drawn, Starts
from soft_tendon_env.envs.targets import Course, Setting, Target, TargetSamples
from soft_tendon_env.envs.tasks import STATIONS, Task
from soft_tendon_env.envs.tracking import (
    Reward,
    Tracking,
    goal_distance,
    goal_reward,
    norm,
    weights_of,
)
from soft_tendon_env.envs.trajectories import TargetDraws, TargetTrajectories, least_bytes
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors
from soft_tendon_env.mechanics.motion.scratch import Motion, Tape
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.state import State, checked_motion, state_of
from soft_tendon_env.model.step_control import cause_of, step_control
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

MANY = 16
"""Rows from which on all motions of a bank are computed when an environment is made."""


class Beginning(NamedTuple):
    """How an episode of a row is to begin."""

    target: Target | Course  # one that is drawn, or the course of one that is not
    state: State | None = None  # in which the arm begins; None: at rest


@dataclass
class LastPeriod:
    """Commands and actions of rows in their last control period, (rows, n_a) each.

    Arrays are replaced and never written to: observations and recordings keep them.
    """

    tension: Array  # [N] at the end of the period
    command: Array  # with the errors of actuators, at the end of the period
    action: Array  # in [-1, 1]
    action_change: Array  # from the period before

    def replace_all(self, new: "LastPeriod") -> None:
        """Take the values of another period in every row."""
        self.tension = new.tension
        self.command = new.command
        self.action = new.action
        self.action_change = new.action_change

    def replace_rows(self, members: Indices, new: "LastPeriod") -> None:
        """Take the values of another period, (members, n_a), in the rows `members`."""
        self.tension = _replace(self.tension, members, new.tension)
        self.command = _replace(self.command, members, new.command)
        self.action = _replace(self.action, members, new.action)
        self.action_change = _replace(self.action_change, members, new.action_change)

    def of_rows(self, members: Indices) -> "LastPeriod":
        """The values of the rows `members`."""
        return LastPeriod(
            self.tension[members],
            self.command[members],
            self.action[members],
            self.action_change[members],
        )


class Targets:
    """Targets of rows of episodes: how rows begin, what they draw, and their trajectories.

    Attributes:
        ahead: (1 + previews,) [s] of now, at which targets are observed.
        trajectories: of all rows.
        draws: of new targets.
        generators: what each row's episode draws from, by row.
    """

    def __init__(
        self,
        task: Task,
        options: Options,
        arms: Arms,
        setting: Setting,
    ) -> None:
        """Make the targets of rows that have not begun.

        Args:
            task: of the environment.
            options: of the environment.
            arms: whose kinematics targets go through.
            setting: of the arms that targets are drawn for.

        Raises:
            ConfigurationError: where the target does not fit, or the arm cannot hold it.
        """
        self._task = task
        self._options = options
        self._scene = arms.model.scene
        self._setting = setting
        period = options.control_period
        periods = (round(time / period) for time in options.preview)
        ahead = [0, *periods]
        counts = np.array(ahead, dtype=np.float64)
        self.ahead = period * counts
        self.trajectories = TargetTrajectories(arms, period, ahead, task.shapes)
        # goals are drawn away from where the tip begins
        if task.goal:
            away = options.threshold_of(arms.model.length)
        else:
            away = 0.0
        self.draws = TargetDraws(setting, self.trajectories, period, away)
        self.generators = dict[int, np.random.Generator]()
        usual = Beginning(self.settled(None))
        self._usual = [usual] * arms.size
        has_obstacles = self._scene.effects.contact is not None
        if arms.size >= MANY and not has_obstacles:  # among them a motion can take seconds
            self.draws.fill_bank(usual.target)

    def settled(self, target: Target | None) -> Target | Course:
        """A target that is drawn for every episode, or the course of one that is not.

        Args:
            target: None for that of the environment.

        Returns:
            The target or its course.

        Raises:
            ConfigurationError: where it does not fit, or the arm cannot hold it.
        """
        checked = checked_target(target, self._options, self._task, self._scene)
        if checked.is_random:
            return checked
        generator = np.random.default_rng(0)
        return checked.draw(generator, self._setting)

    def usual(self, row: int) -> Beginning:
        """How episodes of a row begin without options."""
        return self._usual[row]

    def begin(
        self,
        row: int,
        target: Target | Course,
        tip: Array,
        now: int = 0,
    ) -> None:
        """Give a row its target, drawn by its generator.

        Args:
            row: whose target it is.
            target: one that is drawn, or the course of one that is not.
            tip: position (3,) [m] of the tip.
            now: control period of the episode.

        Raises:
            ConfigurationError: where the arm can hold none.
        """
        self.draws.begin(
            row,
            target,
            self.generators[row],
            tip,
            now,
        )

    def replace(
        self,
        target: Target | None,
        members: Indices,
        step_count: Indices,
        tips: Array,
    ) -> None:
        """Give rows another target, in the episodes that run and in later ones.

        Args:
            target: None for that of the environment.
            members: the rows.
            step_count: (rows,) control periods since the episodes began.
            tips: positions (rows, 3) [m] of the tips.

        Raises:
            ConfigurationError: where it does not fit, or the arm cannot hold it.
        """
        usual = Beginning(self.settled(target))
        for row in members.tolist():
            self._usual[row] = usual
            has_begun = row in self.generators
            if has_begun:
                steps = int(step_count[row])
                self.begin(row, usual.target, tips[row], steps)
        self.trajectories.prepare(step_count, members)


class Episodes:
    """Rows of episodes of one task.

    Attributes:
        arms: whose `reading` and `rows` are written in place.
        errors: tracking errors (rows,) by name, after `begin` or `step`, as what follows.
        terms: reward terms (rows,) by name.
        reward: (rows,).
        reward_terms: of which the reward is made; None: it is that of goals.
        diverged: (rows,) bool.
        step_count: (rows,) control periods since the episodes began.
        target: (rows, 1 + previews, ..) at `ahead` (1 + previews,) [s] of now.
        observed: of which the observation is made.
        generators: what each row's episode draws from, by row.
        limits: of tensions (n_a, 2) [N].
        start_tension: (n_a,) [N] at reset.
        start_command: (n_a,) that holds it.
        sensors: (s,) arc lengths [m] of strain sensors.
        goal_bound: largest coordinate [m] of goals.
        threshold: [m] within which goals are reached.
    """

    def __init__(
        self,
        task: Task,
        options: Options,
        rows: int,
        threads: int | None = None,
    ) -> None:
        """Make rows that rest and have not begun.

        Args:
            task: of the environment.
            options: its keyword arguments.
            rows: of episodes.
            threads: at most this many; None: by the number of processors.

        Raises:
            ConfigurationError: where the options do not fit the task or the scene.
        """
        scene = resolved_scene(options)
        check_fit(options, task, scene)
        warn_of_options(options, scene)
        warn_of_memory(rows, least_bytes(options.preview, options.control_period))
        model = build_model(scene)
        self.task = task
        self.options = options
        self.size = rows
        self.period = options.control_period
        self.model = model
        reach = GOAL_BOUND * model.length
        farthest = options.farthest_base(scene)
        self.goal_bound = reach + farthest
        self.threshold = options.threshold_of(model.length)
        self.sensors = options.sensor_places(scene)
        stations = np.empty(0)
        if task.shapes:
            with_base = np.linspace(0.0, model.length, STATIONS + 1)
            stations = with_base[1:]
        self.arms = Arms(
            model,
            rows,
            self.period,
            stations,
            self.sensors,
            threads,
        )
        self._all = np.arange(rows, dtype=np.int64)
        self._transmits = model.arm.effects.transmission.acts
        self._simulated = True

        # what episodes begin with
        self.starts = Starts(options, self.arms)
        self.limits = self.starts.limits
        self.start_tension = self.starts.tension
        self.start_command = self.starts.command
        self._targets = Targets(task, options, self.arms, self.starts.setting)
        self.ahead = self._targets.ahead
        self.trajectories = self._targets.trajectories
        self.generators = self._targets.generators

        # what they are asked for and how it is rewarded
        command_limits = model.scene.effects.command_limits(self.limits)
        self._strongest = np.abs(command_limits).max(axis=1)
        self.actuation = self._make_actuation(command_limits)
        self.actions = self.actuation.actions
        self._last = LastPeriod(
            tension=np.tile(self.start_tension, (rows, 1)),
            command=np.tile(self.start_command, (rows, 1)),
            action=np.tile(self.actuation.start_action, (rows, 1)),
            action_change=np.zeros((rows, self.start_tension.size)),
        )
        self._sensors = self._make_sensors(options.randomize)
        self.reward_terms: Reward | None = None
        if task.goal is None:
            weights = options.reward
            if not isinstance(weights, dict):
                weights = weights_of(task.reward)
            self.reward_terms = Reward(weights, task.terms, self._strongest, model.length)

        # what is observed of them at rest
        q = np.tile(self.starts.q, (rows, 1))
        self.arms.place(self._all, q, self.start_tension)
        reading = self.arms.reading
        rest_strain = stress_free_strain(scene, self.sensors)
        tendon_length = reading.tendon_length[0].copy()
        self._rest_values = RestValues(tendon_length, rest_strain)
        self.step_count: Indices = np.zeros(rows, dtype=np.int64)
        self.errors = {error.name: np.full(rows, np.nan) for error in task.errors}
        self.terms = dict[str, Array]()
        self.diverged = np.zeros(rows, dtype=bool)
        tip_pose = reading.tip_pose
        self.target, error, _ = self.trajectories.now_and_ahead(self.step_count, tip_pose)
        self.observed = self._seen(reading, error)
        self.history: History | None = None
        if options.history:
            self.history = History(rows, options.history, self.layout.kept)

    def _make_actuation(self, limits: Array) -> Actuation:
        """Actuators whose commands are within limits (n_a, 2).

        Raises ConfigurationError.
        """
        command_range = np.diff(limits)[:, 0]
        widths = np.diff(self.limits)
        tension_range = widths[:, 0]
        return Actuation(
            self.options,
            limits,
            self.start_command,
            command_range / tension_range,
            self.size,
            self.arms.substeps,
        )

    def _make_sensors(self, randomize: Randomization) -> Sensors | None:
        """Sensors, if they have noise."""
        if randomize.noise == SensorNoise():
            return None
        return Sensors(
            randomize.noise,
            self.size,
            self.model.tendon_count,
            self.sensors.size,
            randomize.omission("noise"),
        )

    @property
    def tension(self) -> Array:
        """Tensions (rows, n_a) [N] that acted at the end of the last control period."""
        return self._last.tension

    def attach(self, arms: Arms) -> None:
        """Take other arms of the same model in place of the simulated ones, as measured ones.

        Their readings have noise of their own.

        Args:
            arms: of as many rows.
        """
        self.arms = arms
        self._sensors = None
        self._simulated = False

    @cached_property
    def layout(self) -> Layout:
        """The layout of observations."""
        units = Units(
            self.model.length,
            self.model.coordinate_scale(),
            self._strongest,
            self.options.farthest_base(self.model.scene),
        )
        groups = groups_of(self.options, self.task)
        return Layout(groups, units, self.observed, self.options.history)

    def __getstate__(self) -> dict[str, Any]:
        """All but what is found again, whose functions have no names.

        Raises TypeError.
        """
        if not self._simulated:
            raise TypeError(
                "an environment whose arm is a robot cannot be copied: there is one robot"
            )
        return {name: value for name, value in self.__dict__.items() if name != "layout"}

    def beginnings(
        self, options_of_rows: Mapping[int, ResetOptions], members: Indices
    ) -> dict[int, Beginning]:
        """How rows begin that have options.

        Args:
            options_of_rows: by row; empty without options.
            members: rows that begin.

        Returns:
            Beginnings by row.

        Raises:
            ConfigurationError: where options do not fit.
            TypeError: for states that are none.
            ValueError: for states of other arms.
        """
        if not options_of_rows:
            return {}
        beginnings = {}
        for row in members.tolist():
            options = options_of_rows[row]
            beginnings[row] = self._beginning(row, options)
        return beginnings

    def _beginning(self, row: int, options: ResetOptions) -> Beginning:
        """How a row begins by its options.

        Raises ConfigurationError, TypeError, ValueError.
        """
        if options.state is not None:
            self._refuse_states_of_robots()
            if not self.options.randomize.numbers:
                checked_motion(self.model, options.state)
        target = options.goal or options.target
        if target is None:
            usual = self._targets.usual(row)
            return Beginning(usual.target, options.state)
        return Beginning(self._targets.settled(target), options.state)

    def begin(
        self,
        members: Indices,
        generators: Sequence[np.random.Generator],
        beginnings: Mapping[int, Beginning] | None = None,
    ) -> None:
        """Begin new episodes.

        A row draws its arm, its actuators, its target and the noise of its sensors, in this order.

        Args:
            members: rows that begin.
            generators: of each, which its episode draws from.
            beginnings: of rows that do not begin as usual.

        Raises:
            ConfigurationError: where an arm or a target that is drawn cannot be.
            TypeError: for states that are none.
            ValueError: for states of other arms.
        """
        rows = members.tolist()
        beginning_of = {row: self._targets.usual(row) for row in rows}
        if beginnings is not None:
            beginning_of |= beginnings
        drawn = dict[int, Drawn]()
        motions = dict[int, tuple[Motion, float]]()
        for row, generator in zip(rows, generators, strict=True):
            drawn[row] = self.starts.begin(row, generator)
            self.actuation.begin(row, generator, self.start_command)
            self.generators[row] = generator
        for row in rows:
            state = beginning_of[row].state
            if state is not None:
                motions[row] = checked_motion(drawn[row].model, state)

        repeats = (members.size, 1)
        tension = np.tile(self.start_tension, repeats)
        command = np.tile(self.start_command, repeats)
        rest_rows = [arm.rest for arm in drawn.values()]
        rests = np.array(rest_rows)
        self.arms.place(members, rests, tension)
        self.step_count[members] = 0
        action = self.actions.action(command, command)
        no_change = np.zeros_like(command)
        at_rest = LastPeriod(tension, command, action, no_change)
        self._last.replace_rows(members, at_rest)
        if motions:
            self._put(motions)

        tips = self.arms.reading.tip_pose[:, :3, 3]
        for row, generator in zip(rows, generators, strict=True):
            target = beginning_of[row].target
            self._targets.begin(row, target, tips[row])
            # after the target, which is the same with and without noise
            if self._sensors is not None:
                seed = int(generator.integers(2**63))
                self._sensors.begin(row, seed)
        self._observe(members)

    def set_state(self, row: int, state: State) -> None:
        """Put a row into a state, and observe it there, with the noise of this control period.

        Args:
            row: that is put there.
            state: of the row's arm.

        Raises:
            ConfigurationError: for robots.
            TypeError: for what is no state.
            ValueError: for states of other arms.
        """
        self._refuse_states_of_robots()
        motion = checked_motion(self.arms.model_of(row), state)
        self._put({row: motion})
        self._observe(self._all[:0])
        if self.history is not None:
            self.history.correct(self.present, self.step_count, row)

    def set_target(self, target: Target | None, members: Indices) -> None:
        """Give rows another target, in the episodes that run and in later ones.

        Args:
            target: None for that of the environment.
            members: the rows.

        Raises:
            ConfigurationError: where it does not fit, or the arm cannot hold it.
        """
        tips = self.arms.reading.tip_pose[:, :3, 3]
        self._targets.replace(target, members, self.step_count, tips)
        self._observe(self._all[:0])

    def _refuse_states_of_robots(self) -> None:
        if not self._simulated:
            problem = Problem((), "should have no state: robots begin at rest")
            raise ConfigurationError([problem], "options")

    def _put(self, motions: dict[int, tuple[Motion, float]]) -> None:
        """Put rows into motions, each with the step [s] to try next."""
        rows = self.arms.rows
        arrays = rows.fields()
        for row, (motion, _) in motions.items():
            for name, values in motion._asdict().items():
                arrays[name][row] = values
        # a step of no time reads the motions, and leaves all but the length of the next step
        members = np.array([*motions], dtype=np.int64)
        held = self._last.command[:, None]
        command = np.ascontiguousarray(held)
        no_time = np.zeros((self.size, 1))
        self.arms.step(command, members, no_time)
        for row, (_, step) in motions.items():
            rows.step[row] = step
        if self._transmits:
            tension = self.arms.reading.tension[members]
            self._last.tension = _replace(self._last.tension, members, tension)

    def step(
        self,
        action: Array,
        members: Indices | None = None,
        tape: Tape | None = None,
    ) -> None:
        """Take one control period.

        Args:
            action: (rows, n_a), taken as within [-1, 1].
            members: rows that are stepped, by default all.
            tape: that keeps what the adjoint needs, see `Arms.step`.

        Raises:
            StrainLimitError: where a target has no strain.
            ValueError: where a user's reward term has other values than it may have.
        """
        if members is None:
            members = self._all
        raised = np.maximum(action, -1.0)
        action = np.minimum(raised, 1.0)
        commands, durations = self.actuation.apply(action, members)
        self.arms.step(
            commands,
            members,
            durations,
            tape,
            begins=durations is None,
        )
        applied = commands[:, -1]
        if self._transmits:
            tension = self.arms.reading.tension.copy()
        else:
            tension = applied
        change = action - self._last.action
        now = LastPeriod(tension, applied, action, change)
        if members.size == self.size:
            self.step_count += 1
            self._last.replace_all(now)
        else:  # rows that have just begun keep what they began with
            self.step_count[members] += 1
            self._last.replace_rows(members, now.of_rows(members))
        self._observe(members)

    def _observe(self, members: Indices) -> None:
        """Compare the arms with their targets, after the rows `members` moved on."""
        self.trajectories.prepare(self.step_count, members)
        reading = self.arms.reading
        self.target, error, offset = self.trajectories.now_and_ahead(
            self.step_count, reading.tip_pose
        )
        # what sensors say of the arms, and the errors as policies see them
        measured: Reading | Measured = reading
        measured_error = error
        if self._sensors is not None:
            measured = self._sensors.measured(reading, self.step_count, members)
            measured_error = np.empty_like(error)
            pose_errors(measured.tip_pose, self.target.tip_pose, measured_error)
        self.observed = self._seen(measured, measured_error)
        self.present = self.layout.present(self.observed)
        if self.history is not None:
            self.history.keep(self.present, self.step_count, members)
        distance, angle = offset
        tracking = Tracking(
            arms=self.arms,
            reading=reading,
            error=error[:, 0],
            distance=distance,
            angle=angle,
            target=self.target,
            command=self._last.command,
            action_change=self._last.action_change,
            step_count=self.step_count,
        )
        self._judge(tracking, measured)

    def _judge(self, tracking: Tracking, measured: Reading | Measured) -> None:
        """Find errors, divergence and rewards of all rows, those of goals as measured."""
        self.errors = {error.name: error.value(tracking) for error in self.task.errors}
        self.diverged = self.arms.outcome.status != OK
        most_speed = self.options.tip_speed_limit
        if most_speed is not None:
            velocity = tracking.reading.tip_twist[:, 3:]
            speed = norm(velocity)
            self.diverged |= speed > most_speed
        if self.reward_terms is not None:
            self.terms, self.reward = self.reward_terms.evaluate(self.errors, tracking)
        else:
            position = measured.tip_pose[:, :3, 3]
            achieved = self._goal(position)
            target_position = self.target_pose[:, :3, 3]
            desired = self._goal(target_position)
            self._goals = (achieved, desired)
            self.reward = self.goal_reward(achieved, desired)
        # so that no episode gains by ending
        self.reward[self.diverged] = 0.0

    def _goal(self, position: Array) -> NDArray[np.float32]:
        """Positions (rows, 3) [m] of the tip as goals, within their space."""
        bound = np.float32(self.goal_bound)
        single = position.astype(np.float32)
        raised = np.maximum(single, -bound)
        return np.minimum(raised, bound)

    def _seen(self, measured: Reading | Measured, error: Array) -> Observed:
        """Quantities that observation groups are computed from, with these errors (rows, m, 6)."""
        return Observed(
            self.arms,
            measured,
            error,
            self.target,
            self._last.action,
            self.actuation.command,
            self._rest_values,
        )

    def goal_reward(self, achieved: ArrayLike, desired: ArrayLike) -> Array:
        """Rewards of goals, as compute_reward of the environment.

        Args:
            achieved: positions (..., 3) [m].
            desired: likewise, of the same shape.

        Returns:
            Rewards (...).

        Raises:
            ValueError: for other shapes.
        """
        is_dense = self.options.reward == "dense"
        return goal_reward(achieved, desired, self.threshold, is_dense)

    def target_ahead(self, periods: int) -> TargetSamples:
        """Targets of all rows now and in the periods ahead.

        Args:
            periods: control periods ahead.

        Returns:
            Targets (rows, 1 + periods, ..).

        Raises:
            ValueError: beyond the longest preview.
        """
        return self.trajectories.until(self.step_count, periods)

    @property
    def target_pose(self) -> Array:
        """Target poses of the tip (rows, 4, 4)."""
        return self.target.tip_pose[:, 0]

    @property
    def target_backbone(self) -> Array:
        """Target backbones (rows, stations, 3) [m], no stations unless the task compares shapes."""
        return self.target.backbone[:, 0]

    def observation(self) -> Any:
        """Observation of all rows, new: (rows, size) float32, for goals a dictionary of such."""
        if self.history is None:
            flat = self.present.copy()
        else:
            parts = [self.present, self.history.changes]
            flat = np.concatenate(parts, axis=1)
        if not self.task.goal:
            return flat
        achieved, desired = self._goals
        return {
            "observation": flat,
            "achieved_goal": achieved.copy(),
            "desired_goal": desired.copy(),
        }

    def info(self) -> dict[str, NDArray[Any]]:
        """Info of all rows: new arrays (rows,) by name.

        They are errors, reward terms as "reward_<term>", "diverged", "rejected_steps" and for goals
        "is_success".
        """
        info: dict[str, NDArray[Any]] = {**self.errors}
        for name, value in self.terms.items():
            info[f"reward_{name}"] = value
        info["diverged"] = self.diverged
        info["rejected_steps"] = self.arms.outcome.rejected.copy()
        if self.task.goal:
            distance = goal_distance(*self._goals)
            info["is_success"] = distance <= self.threshold
        return info

    def drawn(self, row: int) -> dict[str, Any]:
        """Info of what `randomize` has drawn for a row's episode, if anything.

        It has numbers of the row's scene by dotted keys, and those of its actuators.
        """
        of_arm = self.starts.numbers[row]
        of_actuators = self.actuation.drawn(row)
        values = {**of_arm, **of_actuators}
        if values:
            return {DRAWN: values}
        return {}

    def drawn_shares(self) -> Array:
        """Drawn numbers (rows, numbers) as shares of their ranges, 0 for the least, 1 the greatest.

        They are what a policy can find out.
        """
        of_arm = self.starts.shares()
        of_actuators = self.actuation.shares()
        return np.concatenate([of_arm, of_actuators], axis=1)

    def cause(self, row: int) -> str:
        """Why the last step of a row failed."""
        code = self.arms.outcome.status[row]
        status = int(code)
        if status == OK:
            velocity = self.arms.reading.tip_twist[row, 3:]
            speed = float(norm(velocity))
            return (
                f"the tip moved at {speed:.3g} m/s, tip_speed_limit is"
                f" {self.options.tip_speed_limit:g}"
            )
        control = step_control(self.model, self.period)
        return cause_of(status, self.model, control)

    def state(self, row: int) -> State:
        """The motion of a row, as Simulation has it."""
        rows = self.arms.rows
        arrays = rows.fields()
        of_row = (arrays[name][row] for name in Motion._fields)
        motion = Motion(*of_row)
        model = self.arms.model_of(row)
        time = float(rows.step[row])
        return state_of(model, motion, time)


def _replace(values: Array, members: Indices, new: Array) -> Array:
    """A copy of values (rows, ..) with new ones in the rows `members`."""
    values = values.copy()
    values[members] = new
    return values


def episodes_of(env: Any) -> Episodes:
    """Episodes that an environment of this package runs.

    Args:
        env: single, vector or for Stable-Baselines3, wrapped or not.

    Returns:
        The episodes.

    Raises:
        TypeError: for environments of other packages.
    """
    inner: Any
    if isinstance(env, gym.Env | gym.vector.VectorEnv):
        inner = env.unwrapped
    else:  # as those of Stable-Baselines3
        inner = getattr(env, "env", None)
    episodes = getattr(inner, "episodes", None)
    if not isinstance(episodes, Episodes):
        raise TypeError(
            f"env should be an environment of soft_tendon_env, not {inner or type(env).__name__}"
        )
    return episodes
