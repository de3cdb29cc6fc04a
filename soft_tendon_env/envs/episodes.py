"""Episodes of a task on a batch of arms: what `reset` and `step` of the single and the vector
environment do, for one row or many.

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
from soft_tendon_env.envs.targets import Course, Target, TargetSamples
from soft_tendon_env.envs.tasks import STATIONS, Task
from soft_tendon_env.envs.tracking import (
    Reward,
    Tracking,
    goal_distance,
    goal_reward,
    norm,
    weights_of,
)
from soft_tendon_env.envs.trajectories import TargetDraws, TargetTrajectories
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

THRESHOLD = 0.01
"""Distance, in lengths of the rod, within which a goal is reached by default."""


class Beginning(NamedTuple):
    """How an episode of a row is to begin."""

    target: Target | Course  # one that is drawn, or the course of one that is not
    state: State | None = None  # in which the arm begins; None: at rest


@dataclass
class LastPeriod:
    """What rows were asked for in their last control period, and what acted: (rows, n_a) each.

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


class Episodes:
    """Rows of episodes of one task.

    After `begin` or `step`: `errors` and `terms` (name to (rows,)), `reward` and `diverged`
    (rows,), `step_count` (rows,), `tension` (rows, n_a) [N] applied at last, `target` (rows, 1 +
    previews, ..) at `ahead` (1 + previews,) [s] of now, and `observed`, of which the observation is
    made. `arms.reading` and `arms.rows` are written in place. `generators`: what each row's episode
    draws from.

    From the options: `limits` of tensions (n_a, 2) [N], `start_tension` (n_a,) [N] at reset and
    `start_command` (n_a,) that holds it, `sensors` (s,) arc lengths [m] of strain sensors,
    `goal_bound` the largest coordinate [m] of goals, `threshold` [m] of reached ones.
    """

    def __init__(self, task: Task, options: Options, rows: int, threads: int | None = None) -> None:
        """Raises ConfigurationError where the options do not fit the task or the scene."""
        scene = resolved_scene(options)
        check_fit(options, task, scene)
        self.task = task
        self.options = options
        self.size = rows
        self.period = options.control_period
        self.model = model = build_model(scene)
        self.goal_bound = GOAL_BOUND * model.length + options.farthest_base(scene)
        self.sensors = options.sensor_places(scene)
        stations = np.empty(0)
        if task.shapes:
            stations = np.linspace(0.0, model.length, STATIONS + 1)[1:]
        self.arms = Arms(model, rows, self.period, stations, self.sensors, threads)
        self._all = np.arange(rows, dtype=np.int64)
        self._transmits = model.arm.effects.transmission.acts
        self._simulated = True
        self._make_draws(options, task)
        self._make_actuation(options, rows)
        self._make_sensors(options.randomize)
        if task.goal is None:
            weights = options.reward
            if not isinstance(weights, dict):
                weights = weights_of(task.reward)
            self._reward_terms = Reward(weights, task.terms, self._strongest, model.length)

        self.arms.place(self._all, np.tile(self.starts.q, (rows, 1)), self.start_tension)
        reading = self.arms.reading
        rest_strain = stress_free_strain(scene, self.sensors)
        self._rest_values = RestValues(reading.tendon_length[0].copy(), rest_strain)
        self.step_count: Indices = np.zeros(rows, dtype=np.int64)
        self.errors = {error.name: np.full(rows, np.nan) for error in task.errors}
        self.terms = dict[str, Array]()
        self.diverged = np.zeros(rows, dtype=bool)
        self.target, error, _ = self.trajectories.now_and_ahead(self.step_count, reading.tip_pose)
        self.observed = self._seen(reading, error)
        self.history: History | None = None
        if options.history:
            self.history = History(rows, options.history, self.layout.kept)

    def _make_draws(self, options: Options, task: Task) -> None:
        """Make what episodes begin with: starts and targets."""
        ahead = [0, *(round(time / self.period) for time in options.preview)]
        self.ahead = self.period * np.array(ahead, dtype=np.float64)
        self.trajectories = TargetTrajectories(self.arms, self.period, ahead, task.shapes)
        self.starts = Starts(options, self.arms)
        self.limits = self.starts.limits
        self.start_tension = self.starts.tension
        self.start_command = self.starts.command
        self.threshold = THRESHOLD * self.model.length
        if options.threshold is not None:
            self.threshold = options.threshold
        self._draws = TargetDraws(
            self.starts.setting,
            self.trajectories,
            self.period,
            self.threshold if task.goal else 0.0,
        )
        usual = Beginning(self._settled(None))
        self._usual = [usual] * self.size
        self.generators = dict[int, np.random.Generator]()
        has_obstacles = self.model.scene.effects.contact is not None
        if self.size >= MANY and not has_obstacles:  # among them a motion can take seconds
            self._draws.fill_bank(usual.target)

    def _settled(self, target: Target | None) -> Target | Course:
        """A target that is drawn for every episode, or the course of one that is not."""
        checked = checked_target(target, self.options, self.task, self.model.scene)
        if checked.is_random:
            return checked
        return checked.draw(np.random.default_rng(0), self.starts.setting)

    def _make_actuation(self, options: Options, rows: int) -> None:
        """Make the actuators, and what they did last."""
        limits = self.model.scene.effects.command_limits(self.limits)
        self._strongest = np.abs(limits).max(axis=1)
        command_range, tension_range = np.diff(limits)[:, 0], np.diff(self.limits)[:, 0]
        self.actuation = Actuation(
            options,
            limits,
            self.start_command,
            command_range / tension_range,
            rows,
            self.arms.substeps,
        )
        self.actions = self.actuation.actions
        self._last = LastPeriod(
            np.tile(self.start_tension, (rows, 1)),
            np.tile(self.start_command, (rows, 1)),
            np.tile(self.actuation.start_action, (rows, 1)),
            np.zeros((rows, self.start_tension.size)),
        )

    def _make_sensors(self, randomize: Randomization) -> None:
        """Make the sensors, if they have noise."""
        self._sensors: Sensors | None = None
        if randomize.noise != SensorNoise():
            tendons, strain_sensors = self.model.tendon_count, self.sensors.size
            self._sensors = Sensors(
                randomize.noise, self.size, tendons, strain_sensors, randomize.omit
            )

    @property
    def tension(self) -> Array:
        """Tensions (rows, n_a) [N] that acted at the end of the last control period."""
        return self._last.tension

    def attach(self, arms: Arms) -> None:
        """Take other arms of the same model in place of the simulated ones, as measured ones: their
        readings have noise of their own."""
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
        """All but what is found again, whose functions have no names. Raises TypeError."""
        if not self._simulated:
            raise TypeError(
                "an environment whose arm is a robot cannot be copied: there is one robot"
            )
        return {name: value for name, value in self.__dict__.items() if name != "layout"}

    def beginnings(
        self, options_of_rows: Mapping[int, ResetOptions], members: Indices
    ) -> dict[int, Beginning]:
        """How those of the rows `members` begin that have options. Raises ConfigurationError,
        TypeError, ValueError."""
        if not options_of_rows:
            return {}
        return {row: self._beginning(row, options_of_rows[row]) for row in members.tolist()}

    def _beginning(self, row: int, options: ResetOptions) -> Beginning:
        """How a row begins by its options. Raises ConfigurationError, TypeError, ValueError."""
        if options.state is not None:
            self._refuse_states_of_robots()
            if not self.options.randomize.numbers:
                checked_motion(self.model, options.state)
        target = options.goal or options.target
        course = self._settled(target) if target else self._usual[row].target
        return Beginning(course, options.state)

    def begin(
        self,
        members: Indices,
        generators: Sequence[np.random.Generator],
        beginnings: Mapping[int, Beginning] | None = None,
    ) -> None:
        """New episodes for the rows `members`, each drawn from its generator; `beginnings` of rows
        that do not begin as usual.

        A row draws its arm, its actuators, its target and the noise of its sensors, in this order.
        """
        rows = members.tolist()
        beginning_of = {row: self._usual[row] for row in rows} | dict(beginnings or {})
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

        tension = np.tile(self.start_tension, (members.size, 1))
        command = np.tile(self.start_command, (members.size, 1))
        self.arms.place(members, np.array([arm.rest for arm in drawn.values()]), tension)
        self.step_count[members] = 0
        action = self.actions.action(command, command)
        at_rest = LastPeriod(tension, command, action, np.zeros_like(command))
        self._last.replace_rows(members, at_rest)
        if motions:
            self._put(motions)

        tips = self.arms.reading.tip_pose[:, :3, 3]
        for row, generator in zip(rows, generators, strict=True):
            self._draws.begin(row, beginning_of[row].target, generator, tips[row])
            # after the target, which is the same with and without noise
            if self._sensors is not None:
                self._sensors.begin(row, int(generator.integers(2**63)))
        self._observe(members)

    def set_state(self, row: int, state: State) -> None:
        """Put a row into a state, and observe it there, with the noise of this control period.
        Raises TypeError or ValueError."""
        self._refuse_states_of_robots()
        self._put({row: checked_motion(self.arms.model_of(row), state)})
        self._observe(self._all[:0])
        if self.history is not None:
            self.history.correct(self.present, self.step_count, row)

    def set_target(self, target: Target | None, members: Indices) -> None:
        """Another target for the rows `members`, in the episodes that run and in later ones. Raises
        ConfigurationError."""
        usual = Beginning(self._settled(target))
        tips = self.arms.reading.tip_pose[:, :3, 3]
        for row in members.tolist():
            self._usual[row] = usual
            has_begun = row in self.generators
            if has_begun:
                periods = int(self.step_count[row])
                self._draws.begin(row, usual.target, self.generators[row], tips[row], periods)
        self.trajectories.prepare(self.step_count, members)
        self._observe(self._all[:0])

    def _refuse_states_of_robots(self) -> None:
        if not self._simulated:
            problem = Problem((), "should have no state: robots begin at rest")
            raise ConfigurationError([problem], "options")

    def _put(self, motions: dict[int, tuple[Motion, float]]) -> None:
        """Put rows into motions, each with the step [s] to try next."""
        rows = self.arms.rows
        members = np.array([*motions], dtype=np.int64)
        for row, (motion, _) in motions.items():
            for name, values in motion._asdict().items():
                getattr(rows, name)[row] = values
        # a step of no time reads the motions, and leaves all but the length of the next step
        command = np.ascontiguousarray(self._last.command[:, None])
        self.arms.step(command, members, np.zeros((self.size, 1)))
        for row, (_, step) in motions.items():
            rows.step[row] = step
        if self._transmits:
            tension = self.arms.reading.tension[members]
            self._last.tension = _replace(self._last.tension, members, tension)

    def step(self, action: Array, members: Indices | None = None, tape: Tape | None = None) -> None:
        """One control period of the rows `members` (all by default) with actions (rows, n_a), taken
        as within [-1, 1]; tape: see Arms."""
        if members is None:
            members = self._all
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        commands, durations = self.actuation.apply(action, members)
        self.arms.step(commands, members, durations, tape, begins=durations is None)
        applied = commands[:, -1]
        tension = self.arms.reading.tension.copy() if self._transmits else applied
        now = LastPeriod(tension, applied, action, action - self._last.action)
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
        self.target, error, off = self.trajectories.now_and_ahead(self.step_count, reading.tip_pose)
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
        tracking = Tracking(
            self.arms,
            reading,
            error[:, 0],
            off[0],
            off[1],
            self.target,
            self._last.command,
            self._last.action_change,
            self.step_count,
        )
        self.errors = {error.name: error.value(tracking) for error in self.task.errors}
        self.diverged = self.arms.outcome.status != OK
        if self.options.tip_speed_limit is not None:
            self.diverged |= norm(reading.tip_twist[:, 3:]) > self.options.tip_speed_limit
        if self.task.goal is None:
            self.terms, self.reward = self._reward_terms.evaluate(self.errors, tracking)
        else:
            achieved = self._goal(measured.tip_pose[:, :3, 3])
            desired = self._goal(self.target_pose[:, :3, 3])
            self._goals = (achieved, desired)
            self.reward = self.goal_reward(achieved, desired)
        self.reward[self.diverged] = 0.0

    def _goal(self, position: Array) -> NDArray[np.float32]:
        """Positions (rows, 3) [m] of the tip as goals, within their space."""
        bound = np.float32(self.goal_bound)
        return np.minimum(np.maximum(position.astype(np.float32), -bound), bound)

    def _seen(self, measured: Reading | Measured, error: Array) -> Observed:
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
        """Rewards (...) of goals (..., 3) [m]. Raises ValueError."""
        return goal_reward(achieved, desired, self.threshold, self.options.reward == "dense")

    def target_ahead(self, periods: int) -> TargetSamples:
        """The targets of all rows (rows, 1 + periods, ..) now and in the periods ahead. Raises
        ValueError beyond the longest preview."""
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
        """A new array (rows, size) float32, or for goal-conditioned tasks a dictionary of them."""
        if self.history is None:
            flat = self.present.copy()
        else:
            flat = np.concatenate([self.present, self.history.changes], axis=1)
        if not self.task.goal:
            return flat
        achieved, desired = self._goals
        return {
            "observation": flat,
            "achieved_goal": achieved.copy(),
            "desired_goal": desired.copy(),
        }

    def info(self) -> dict[str, NDArray[Any]]:
        """Errors, reward terms as "reward_<term>", "diverged", "rejected_steps" and for goals
        "is_success", new arrays (rows,)."""
        info: dict[str, NDArray[Any]] = {**self.errors}
        for name, value in self.terms.items():
            info[f"reward_{name}"] = value
        info["diverged"] = self.diverged
        info["rejected_steps"] = self.arms.outcome.rejected.copy()
        if self.task.goal:
            info["is_success"] = goal_distance(*self._goals) <= self.threshold
        return info

    def drawn(self, row: int) -> dict[str, Any]:
        """Info of what `randomize` has drawn for a row's episode, if anything: numbers of its scene
        by dotted keys, of its actuators."""
        values = {**self.starts.numbers[row], **self.actuation.drawn(row)}
        return {DRAWN: values} if values else {}

    def drawn_shares(self) -> Array:
        """How far from least to greatest every number (rows, numbers) that `randomize` draws is, 0
        to 1: what a policy can find out."""
        return np.concatenate([self.starts.shares(), self.actuation.shares()], axis=1)

    def cause(self, row: int) -> str:
        """Why the last step of a row failed."""
        status = int(self.arms.outcome.status[row])
        if status == OK:
            speed = float(norm(self.arms.reading.tip_twist[row, 3:]))
            return (
                f"the tip moved at {speed:.3g} m/s, tip_speed_limit is"
                f" {self.options.tip_speed_limit:g}"
            )
        return cause_of(status, self.model, step_control(self.model, self.period))

    def state(self, row: int) -> State:
        """The motion of a row, as Simulation has it."""
        motion = Motion(*(getattr(self.arms.rows, name)[row] for name in Motion._fields))
        return state_of(self.arms.model_of(row), motion, float(self.arms.rows.step[row]))


def _replace(values: Array, members: Indices, new: Array) -> Array:
    """A copy of values (rows, ..) with new ones in the rows `members`."""
    values = values.copy()
    values[members] = new
    return values


def episodes_of(env: Any) -> Episodes:
    """The episodes that an environment of this package runs, single, vector or for
    Stable-Baselines3, wrapped or not. Raises TypeError."""
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
