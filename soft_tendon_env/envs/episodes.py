"""Episodes of a task on a batch of arms: what `reset` and `step` of the single and the vector
environment do, for one row or many.

What happens in a row depends on the generator that its episode began with and on its actions, and
on nothing else: the same for one row and for many, bit for bit. Read `begin` and `step` first.
"""

from collections.abc import Mapping, Sequence
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
from soft_tendon_env.envs.randomization import DRAWN, Measured, Sensors
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

MANY = 16  # rows from which on all motions of a bank are computed when an environment is made
THRESHOLD = 0.01  # distance, in lengths of the rod, within which a goal is reached by default


class Beginning(NamedTuple):
    """How an episode of a row is to begin."""

    target: Target | Course  # one that is drawn, or the course of one that is not
    state: State | None = None  # in which the arm begins; None: at rest


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
        self.task, self.options, self.size, self.period = (
            task,
            options,
            rows,
            options.control_period,
        )
        self.model = model = build_model(scene)
        self.goal_bound, self.sensors = (
            GOAL_BOUND * model.length + options.farthest_base(scene),
            options.sensor_places(scene),
        )
        stations = np.linspace(0.0, model.length, STATIONS + 1)[1:] if task.shapes else np.empty(0)
        self.arms = Arms(model, rows, self.period, stations, self.sensors, threads)
        starts = self._make_draws(options, task)
        self._make_actuation(options, rows)
        if task.goal is None:
            given = options.reward if isinstance(options.reward, dict) else weights_of(task.reward)
            self._reward_terms = Reward(given, task.terms, self._strongest, model.length)
        noise, sizes = options.randomize.noise, (rows, model.tendon_count, self.sensors.size)
        self._sensors = (
            Sensors(noise, *sizes, options.randomize.omit) if noise != SensorNoise() else None
        )
        self._all, self._transmits, self._simulated = (
            np.arange(rows, dtype=np.int64),
            model.arm.effects.transmission.acts,
            True,
        )
        self.arms.place(self._all, np.tile(starts.q, (rows, 1)), self.start_tension)
        reading = self.arms.reading
        self._rest_values = RestValues(
            reading.tendon_length[0].copy(), stress_free_strain(scene, self.sensors)
        )
        self.step_count: Indices = np.zeros(rows, dtype=np.int64)
        self.errors = {error.name: np.full(rows, np.nan) for error in task.errors}
        self.diverged, self.terms = np.zeros(rows, dtype=bool), dict[str, Array]()
        self.target, error, _ = self.trajectories.now_and_ahead(self.step_count, reading.tip_pose)
        self.observed = self._seen(reading, error)
        self.history = History(rows, options.history, self.layout.kept) if options.history else None

    def _make_draws(self, options: Options, task: Task) -> Starts:
        """Make what episodes begin with: starts and targets."""
        ahead = [0, *(round(time / self.period) for time in options.preview)]
        self.ahead = self.period * np.array(ahead, dtype=np.float64)
        self.trajectories = TargetTrajectories(self.arms, self.period, ahead, task.shapes)
        self.starts = starts = Starts(options, self.arms)
        self.limits, self.start_tension, self.start_command = (
            starts.limits,
            starts.tension,
            starts.command,
        )
        self.threshold = (
            THRESHOLD * self.model.length if options.threshold is None else options.threshold
        )
        self._draws = TargetDraws(
            starts.setting, self.trajectories, self.period, self.threshold if task.goal else 0.0
        )
        self._usual, self.generators = (
            [usual := Beginning(self._settled(None))] * self.size,
            dict[int, np.random.Generator](),
        )
        if (
            self.size >= MANY and self.model.scene.effects.contact is None
        ):  # among obstacles a motion can take seconds
            self._draws.fill_bank(usual.target)
        return starts

    def _settled(self, target: Target | None) -> Target | Course:
        found = checked_target(target, self.options, self.task, self.model.scene)
        return (
            found if found.is_random else found.draw(np.random.default_rng(0), self.starts.setting)
        )

    def _make_actuation(self, options: Options, rows: int) -> None:
        """Make the actuators, and what they did last."""
        commands = self.model.scene.effects.command_limits(self.limits)
        share, self._strongest = (
            np.diff(commands)[:, 0] / np.diff(self.limits)[:, 0],
            np.abs(commands).max(axis=1),
        )
        self.actuation = Actuation(
            options, commands, self.start_command, share, rows, self.arms.substeps
        )
        self.actions = self.actuation.actions
        self.tension, self._applied = (
            np.tile(self.start_tension, (rows, 1)),
            np.tile(self.start_command, (rows, 1)),
        )
        self._action, self._action_change = (
            np.tile(self.actuation.start_action, (rows, 1)),
            np.zeros_like(self.tension),
        )

    def attach(self, arms: Arms) -> None:
        """Take other arms of the same model in place of the simulated ones, as measured ones: their
        readings have noise of their own."""
        self.arms, self._sensors, self._simulated = arms, None, False

    @cached_property
    def layout(self) -> Layout:
        """The layout of observations."""
        units = Units(
            self.model.length,
            self.model.coordinate_scale(),
            self._strongest,
            self.options.farthest_base(self.model.scene),
        )
        return Layout(
            groups_of(self.options, self.task), units, self.observed, self.options.history
        )

    def __getstate__(self) -> dict[str, Any]:
        """All but what is found again, whose functions have no names. Raises TypeError."""
        if not self._simulated:
            raise TypeError(
                "an environment whose arm is a robot cannot be copied: there is one robot"
            )
        return {name: value for name, value in self.__dict__.items() if name != "layout"}

    def beginnings(
        self, given: Mapping[int, ResetOptions], members: Indices
    ) -> dict[int, Beginning]:
        """How those of the rows `members` begin that are given options. Raises ConfigurationError,
        TypeError, ValueError."""
        found = {}
        for row in members.tolist() if given else ():
            options = given[row]
            if options.state is not None:
                self._refuse_states_of_robots()
                if not self.options.randomize.numbers:
                    checked_motion(self.model, options.state)
            wanted = options.goal or options.target
            found[row] = Beginning(
                self._settled(wanted) if wanted else self._usual[row].target, options.state
            )
        return found

    def begin(
        self,
        members: Indices,
        generators: Sequence[np.random.Generator],
        beginnings: Mapping[int, Beginning] | None = None,
    ) -> None:
        """New episodes for the rows `members`, each drawn from its generator; `beginnings` of rows
        that do not begin as usual."""
        hows = [(beginnings or {}).get(row, self._usual[row]) for row in members.tolist()]
        rows, drawn, command = (
            list(zip(members.tolist(), hows, generators, strict=True)),
            dict[int, Drawn](),
            self.start_command,
        )
        for row, _, generator in rows:
            drawn[row] = self.starts.begin(row, generator)
            self.actuation.begin(row, generator, command)
            self.generators[row] = generator
        motions = {
            row: checked_motion(drawn[row].model, how.state)
            for row, how, _ in rows
            if how.state is not None
        }
        tensions, commands = (
            np.tile(start, (members.size, 1)) for start in (self.start_tension, command)
        )
        self.arms.place(members, np.array([start.rest for start in drawn.values()]), tensions)
        self.step_count[members] = 0
        self._keep(
            members,
            tensions,
            commands,
            self.actions.action(commands, commands),
            np.zeros_like(commands),
        )
        if motions:
            self._put(motions)
        for row, how, generator in rows:
            self._draws.begin(row, how.target, generator, self.arms.reading.tip_pose[row, :3, 3])
            if (
                self._sensors is not None
            ):  # after the target, which is the same with and without noise
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
        for row in members.tolist():
            self._usual[row] = usual
            if row in self.generators:
                now = self.arms.reading.tip_pose[row, :3, 3], int(self.step_count[row])
                self._draws.begin(row, usual.target, self.generators[row], *now)
        self.trajectories.prepare(self.step_count, members)
        self._observe(self._all[:0])

    def _refuse_states_of_robots(self) -> None:
        if not self._simulated:
            raise ConfigurationError(
                [Problem((), "should have no state: robots begin at rest")], "options"
            )

    def _put(self, motions: dict[int, tuple[Motion, float]]) -> None:
        """Put rows into motions, each with the step [s] to try next."""
        rows, members = self.arms.rows, np.array([*motions], dtype=np.int64)
        for row, (motion, _) in motions.items():
            for name, values in motion._asdict().items():
                getattr(rows, name)[row] = values
        command = np.ascontiguousarray(self._applied[:, None])
        self.arms.step(command, members, np.zeros((self.size, 1)))  # for no time: it reads them
        for row, (_, step) in motions.items():
            rows.step[row] = step  # as it was
        if self._transmits:
            self.tension = _replace(self.tension, members, self.arms.reading.tension[members])

    def step(self, action: Array, members: Indices | None = None, tape: Tape | None = None) -> None:
        """One control period of the rows `members` (all by default) with actions (rows, n_a), taken
        as within [-1, 1]; tape: see Arms."""
        members = self._all if members is None else members
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        commands, durations = self.actuation.apply(action, members)
        self.arms.step(commands, members, durations, tape, begins=durations is None)
        change, applied = action - self._action, commands[:, -1]
        tension = self.arms.reading.tension.copy() if self._transmits else applied
        if members.size == self.size:
            self.step_count += 1
            self.tension, self._applied, self._action, self._action_change = (
                tension,
                applied,
                action,
                change,
            )
        else:  # rows that have just begun keep what they began with
            self.step_count[members] += 1
            self._keep(
                members, tension[members], applied[members], action[members], change[members]
            )
        self._observe(members)

    def _keep(self, members: Indices, *new: Array) -> None:
        """Keep tension, command, action and its change (members, n_a) of the rows `members`, in new
        arrays."""
        before = self.tension, self._applied, self._action, self._action_change
        parts = (_replace(old, members, value) for old, value in zip(before, new, strict=True))
        self.tension, self._applied, self._action, self._action_change = parts

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
        now = self.target, self._applied, self._action_change, self.step_count
        tracking = Tracking(self.arms, reading, error[:, 0], off[0], off[1], *now)
        self.errors = {error.name: error.value(tracking) for error in self.task.errors}
        self.diverged = self.arms.outcome.status != OK
        if self.options.tip_speed_limit is not None:
            self.diverged |= norm(reading.tip_twist[:, 3:]) > self.options.tip_speed_limit
        if self.task.goal is None:
            self.terms, self.reward = self._reward_terms.of(self.errors, tracking)
        else:
            bound, positions = (
                np.float32(self.goal_bound),
                (measured.tip_pose[:, :3, 3], self.target_pose[:, :3, 3]),
            )
            achieved, desired = (
                np.minimum(np.maximum(position.astype(np.float32), -bound), bound)
                for position in positions
            )
            self._goals = (
                achieved,
                desired,
            )  # tip positions (rows, 3) [m] as measured and as wanted, within their space
            self.reward = self.goal_reward(achieved, desired)
        self.reward[self.diverged] = 0.0

    def _seen(self, measured: Reading | Measured, error: Array) -> Observed:
        return Observed(
            self.arms,
            measured,
            error,
            self.target,
            self._action,
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
        flat = (
            self.present.copy()
            if self.history is None
            else np.concatenate([self.present, self.history.changes], axis=1)
        )
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
        info: dict[str, NDArray[Any]] = {
            **self.errors,
            **{f"reward_{name}": value for name, value in self.terms.items()},
        }
        info["diverged"] = self.diverged
        info["rejected_steps"] = self.arms.outcome.rejected.copy()
        if self.task.goal:
            info["is_success"] = goal_distance(*self._goals) <= self.threshold
        return info

    def drawn(self, row: int) -> dict[str, Any]:
        """Info of what `randomize` has drawn for a row's episode, if anything: numbers of its scene
        by dotted keys, of its actuators."""
        return (
            {DRAWN: found}
            if (found := {**self.starts.numbers[row], **self.actuation.drawn(row)})
            else {}
        )

    def drawn_shares(self) -> Array:
        """How far from least to greatest every number (rows, numbers) that `randomize` draws is, 0
        to 1: what a policy can find out."""
        return np.concatenate([self.starts.shares(), self.actuation.shares()], axis=1)

    def cause(self, row: int) -> str:
        """Why the last step of a row failed."""
        if self.arms.outcome.status[row] == OK:
            speed = float(norm(self.arms.reading.tip_twist[row, 3:]))
            return (
                f"the tip moved at {speed:.3g} m/s, tip_speed_limit is"
                f" {self.options.tip_speed_limit:g}"
            )
        return cause_of(
            int(self.arms.outcome.status[row]), self.model, step_control(self.model, self.period)
        )

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
    inner = (
        env.unwrapped
        if isinstance(env, gym.Env | gym.vector.VectorEnv)
        else getattr(env, "env", None)
    )
    episodes = getattr(inner, "episodes", None)
    if not isinstance(episodes, Episodes):
        raise TypeError(
            f"env should be an environment of soft_tendon_env, not {inner or type(env).__name__}"
        )
    return episodes
