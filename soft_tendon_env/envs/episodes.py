"""Episodes of a task on a batch of arms: what `reset` and `step` of the single and the vector environment do, for one row or many.

What happens in a row depends on the generator that its episode began with and on its actions, and on nothing else: the same for one
row and for many, bit for bit. Read `begin` and `step` first.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects.contact import ContactForces, contact_forces
from soft_tendon_env.envs.actuation import ActionScale, Actuation
from soft_tendon_env.envs.arms import Arms, Indices, Material, RowEffects
from soft_tendon_env.envs.contacts import INSIDE, Clear, Contacts, Seen, has_contact, tip_depths, tip_radius, why_base_inside, why_inside
from soft_tendon_env.envs.courses import Courses
from soft_tendon_env.envs.effect_ranges import EffectRanges
from soft_tendon_env.envs.goals import GoalReward
from soft_tendon_env.envs.inverse_statics import InverseStatics
from soft_tendon_env.envs.observation import AtRest, History, Layout, Observed, Sizes, units_of
from soft_tendon_env.envs.options import Options, check_fit, groups_of, resolved_scene, sensor_places
from soft_tendon_env.envs.randomization import drawn, own_stream
from soft_tendon_env.envs.rewards import CONTACT_TERMS, Reward, Weight
from soft_tendon_env.envs.sensors import Measured, Sensors
from soft_tendon_env.envs.targets import TARGETS, Course, Setting, ShapeCourse, TargetSamples, make_setting
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.envs.tasks import STATIONS, Task, Tracking
from soft_tendon_env.envs.tasks.base import norm
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.mechanics.motion.pose_errors import pose_errors
from soft_tendon_env.mechanics.motion.status import OK
from soft_tendon_env.model.model import Model, build_model
from soft_tendon_env.model.simulation import State, cause_of, step_control
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.registration import MAX_EPISODE_STEPS
from soft_tendon_env.scene.scene import Array, segment_index
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown

MOST_DRAWS = 100
"""How often obstacles are drawn in which the arm would begin, and targets inside of obstacles, before that is an error."""
LOOKS = 100
"""Times in an episode of the usual length at which targets are looked for inside of obstacles."""
NO_CONTACT = Seen(np.zeros((0, 0, 3)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))


class Snapshot(NamedTuple):
    """Strain, tensions and poses of all rows in one step, copied: what recordings of rows that are reset in the same step need."""

    strain: Array  # (rows, m) as the kernels have it
    tension: Array  # (rows, n_a) [N]
    tip_pose: Array  # (rows, 4, 4)
    target_pose: Array  # (rows, 4, 4)
    target_backbone: Array  # (rows, stations, 3) [m]


class Episodes:
    """Rows of episodes of one task.

    After `begin` or `step`: `errors` (name to (rows,)), `terms` (likewise), `reward` (rows,), `diverged` (rows,);
    `observation()` and `info()` make what environments return. `step_count` (rows,), `tension` (rows, n_a) [N] applied at last and
    `target` (TargetSamples of rows, 1 + previews, `ahead` (1 + previews,) [s] of now) are the present ones. `start_tension` (n_a,) [N] is
    that at reset and `start_command` (n_a,) what holds it, `actuation` makes commands of actions, `sensors` (s,) [m] the arc lengths of
    strain sensors. `arms.reading` and
    `arms.rows` are written in place at every step; `last` is what `remember` kept.
    """

    def __init__(self, task: Task, options: Options, rows: int, threads: int | None = None) -> None:
        """Raises ConfigurationError where the options do not fit the task or the scene."""
        scene = resolved_scene(options)
        check_fit(options, task, scene)
        groups = groups_of(options, task, scene)
        self.task, self.options, self.size, self.period = task, options, rows, options.control_period
        self.model = model = build_model(scene)
        self._effects = EffectRanges(options.randomize.effects, model)
        stations = np.linspace(0.0, model.length, STATIONS + 1)[1:] if task.shapes else np.empty(0)
        self.sensors = sensors = sensor_places(options, scene)
        self.arms = Arms(model, rows, self.period, stations, sensors, threads)
        self.limits = np.array([tendon.tension_limits for tendon in scene.tendons])
        self.start_tension = nearest_to_zero(self.limits)
        rest = static_equilibrium(model, self.start_tension, settle=True)
        if inside := why_inside(model, rest.q):
            text = f"has obstacles in the arm's way: {inside}; move it to where the arm is not"
            raise ConfigurationError([Problem(("scene",), text)], "environment")
        if not rest.converged:
            text = f"leave {shown_numbers(self.start_tension)} N nearest to zero, which cannot hold the arm: {rest.reason}"
            raise ConfigurationError([Problem(("tension_limits",), text)], "environment")
        self._rest = rest.q
        if options.randomize.of_material or self._effects and not self._redraws:
            heaviest = options.randomize.heaviest
            for effects in self._effects.extremes(heaviest.stiffness) if self._effects and not self._redraws else (None,):
                self._rest_of(0, heaviest, effects)
            self.arms.set_material(0, Material())
        self._contacts = Contacts(self.arms, options.contact_sections) if has_contact(model) else None
        self._setting = self._among(make_setting(self.arms, self.limits), rest.q)
        self._target = options.target or TARGETS[task.target](type=task.target)
        self._course = None if self._target.is_random else self._target.draw(np.random.default_rng(0), self._setting)
        ahead = [0, *(round(time / self.period) for time in options.preview)]
        self.ahead = self.period * np.array(ahead, dtype=np.float64)
        free = model if self._setting.free is None else self._setting.free.model  # of obstacles, which it could not follow a target through
        inverse = any(group.of_inverse for group in groups.values())
        inverse_statics = InverseStatics(free, self.limits, self.period, rows) if inverse else None
        self._courses = Courses(self.arms, self.period, ahead, task.shapes, inverse_statics)
        if self._course is not None and (inside := self._target_inside(self._course, model)):
            raise ConfigurationError([Problem(("target",), f"lies inside of an obstacle: {inside}")], "environment")
        self.start_command = start = model.command(self.start_tension, self._rest)
        commands = scene.effects.command_limits(self.limits)
        share = np.diff(commands)[:, 0] / np.diff(self.limits)[:, 0]
        strongest = np.abs(commands).max(axis=1)
        self._rewarded = None if task.goal else _reward_of(task, options, strongest, has_contact(model))
        self.actuation = Actuation(options, commands, start, share, rows, self.arms.substeps)
        randomize = options.randomize
        self._sensors = Sensors(randomize.noise, rows, model.tendon_count, sensors.size) if randomize.of_sensors else None
        sizes = Sizes(model.coordinate_count, model.tendon_count, sensors.size, len(options.preview), options.contact_sections)
        self.layout = Layout(groups, sizes, units_of(model, strongest), options.history)
        self._history = History(rows, options.history, self.layout.kept) if options.history else None
        curvature = np.array([segment.curvature for segment in scene.segments])[segment_index(scene, sensors)]
        stress_free = np.concatenate([curvature, np.tile([1.0, 0.0, 0.0], (sensors.size, 1))], axis=1)
        self._all, self._transmits = np.arange(rows, dtype=np.int64), model.arm.effects.transmit
        self.arms.place(self._all, np.tile(self._rest, (rows, 1)), self.start_tension)
        self._at_rest = AtRest(self.arms.reading.tendon_length[0].copy(), stress_free)
        self.step_count: Indices = np.zeros(rows, dtype=np.int64)
        self.tension = np.tile(self.start_tension, (rows, 1))
        self._applied = np.tile(start, (rows, 1))
        self._action = np.tile(self.actuation.start_action, (rows, 1))
        self._action_change = np.zeros_like(self._action)
        self.diverged = np.zeros(rows, dtype=bool)
        self.target = self._courses.now_and_ahead(self.step_count, self.arms.reading.tip_pose)[0]
        self.last: Snapshot | None = None

    def begin(self, members: Indices, generators: Sequence[np.random.Generator]) -> None:
        """New episodes for the rows `members`, each drawn from its generator."""
        q = np.tile(self._rest, (members.size, 1))
        for i, (row, generator) in enumerate(zip(members.tolist(), generators, strict=True)):
            stream = own_stream(generator) if self._effects else None
            draw = drawn(self.options.randomize, self.model.tendon_count, generator)
            self.actuation.begin(row, draw)
            if self.options.randomize.of_arm:
                q[i] = self._begin_arm(row, draw.material, stream)
            self._begin_course(row, generator, self.model.arm.strain.of_softer_rod(q[i], np.array(draw.material.stiffness)))
            if self._sensors is not None:  # after the target, which is the same with and without noise
                self._sensors.begin(row, int(generator.integers(2**63)))
        self.arms.place(members, q, self.start_tension)
        self.step_count[members] = 0
        self.tension, self._applied = self.tension.copy(), self._applied.copy()
        self.tension[members], self._applied[members] = self.start_tension, self.start_command
        self._action, self._action_change = self._action.copy(), self._action_change.copy()
        self._action[members], self._action_change[members] = self.actuation.start_action, 0.0
        self._look(members)

    @property
    def _redraws(self) -> bool:
        """Whether obstacles are drawn, and drawn again where the arm would begin inside of one."""
        return "contact" in self._effects.names

    def _begin_arm(self, row: int, material: Material, stream: np.random.Generator | None) -> Array:
        """Give a row its material, and effects drawn from `stream` if any are: the coordinates (n,) at which it rests."""
        if stream is None:
            return self._rest_of(row, material)
        for last in range(MOST_DRAWS - 1, -1, -1):
            effects = self._effects.drawn(stream, material.stiffness)
            try:
                q = self._rest_of(row, material, effects)
            except ConfigurationError:
                if last and self._redraws:
                    continue
                raise
            inside = self._course is not None and self._redraws and self._target_inside(self._course, self.arms.model_of(row))
            if not inside:
                return q
        text = f"put the target inside of an obstacle in {MOST_DRAWS} draws out of {MOST_DRAWS}: {inside}"
        raise ConfigurationError([Problem(("randomize", "effects"), text)], "environment")

    def _rest_of(self, row: int, material: Material, effects: RowEffects | None = None) -> Array:
        """Give a row its material and effects: the coordinates (n,) at which it rests. Raises ConfigurationError where it does not."""
        self.arms.set_material(row, material, effects)
        if not (self.model.arm.effects.load or self.start_tension.any()):
            return self._rest
        own = self.arms.model_of(row)
        inside = why_base_inside(own, self._rest)
        if not inside:
            rest = self.arms.rest(row, self.start_tension)
            inside = why_inside(own, rest.q)
        if inside or not rest.converged:
            drawn = {name: f"{value:.4g}" for name, value in material._asdict().items()}
            if effects is not None:
                drawn |= {name: shown(value.tolist()) for name, value in self._effects.values(effects.effects).items()}
            listed = ", ".join(f"{name} {value}" for name, value in drawn.items())
            if inside:
                text = f"can make arms that begin inside of an obstacle: {listed}: {inside}"
            else:
                text = f"can make arms that {shown_numbers(self.start_tension)} N, nearest to zero, cannot hold: {listed}: {rest.reason}"
            raise ConfigurationError([Problem(("randomize",), text)], "environment")
        return rest.q

    def _begin_course(self, row: int, generator: np.random.Generator, rest: Array) -> None:
        """Give a row its target; one that is drawn keeps clear of the row's obstacles, as the arm at `rest` (n,) does, where that is so.

        Raises ConfigurationError.
        """
        if self._course is not None:
            self._courses.begin(row, self._course)
            return
        setting = self._setting
        if self._redraws:
            setting = self._among(setting._replace(model=self.arms.model_among(row)), rest)
        for _ in range(MOST_DRAWS):
            course = self._target.draw(generator, setting)
            if isinstance(course, ShapeCourse) or not (inside := self._target_inside(course, setting.model)):
                self._courses.begin(row, course)
                return
        text = f"lay inside of an obstacle in {MOST_DRAWS} draws out of {MOST_DRAWS}, at last {inside}"
        raise ConfigurationError([Problem(("target",), text)], "environment")

    def _among(self, setting: Setting, rest: Array) -> Setting:
        """The setting with the space that its model's obstacles leave free; as it is where the arm at rest (n,) is not in that."""
        if self._contacts is None:
            return setting
        free = Clear(self.arms, setting.model)
        return setting._replace(free=free if free.holds(rest[None]).all() else None)

    def _target_inside(self, course: Course, model: Model) -> str:
        """Which obstacle that stands still a target's tip is inside of, as the end of a sentence; "": of none."""
        if self._contacts is None:
            return ""
        times = self.period * np.linspace(0.0, MAX_EPISODE_STEPS, LOOKS)
        depth, obstacle = tip_depths(model, self._courses.tip_positions(course, times))
        if depth <= INSIDE * tip_radius(model):
            return ""
        return f"the tip would be {1e3 * depth:.3g} mm deep in {obstacle}"

    def step(self, action: Array, members: Indices | None = None) -> None:
        """One control period of the rows `members` (all by default) with actions (rows, n_a), taken as within [-1, 1]."""
        members = self._all if members is None else members
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        commands, durations = self.actuation.apply(action, members)
        self.arms.step(commands, members, durations)
        change, applied = action - self._action, commands[:, -1]
        tension = self.arms.reading.tension.copy() if self._transmits else applied
        if members.size == self.size:
            self.step_count += 1
            self.tension, self._applied, self._action, self._action_change = tension, applied, action, change
        else:  # rows that have just begun keep what they began with
            self.step_count[members] += 1
            self.tension, self._applied = self.tension.copy(), self._applied.copy()
            self.tension[members], self._applied[members] = tension[members], applied[members]
            self._action, self._action_change = self._action.copy(), np.zeros_like(change)
            self._action[members], self._action_change[members] = action[members], change[members]
        self._look(members)

    def _look(self, members: Indices) -> None:
        """Compare the arms with their targets, after the rows `members` have moved on."""
        self._courses.prepare(self.step_count, members)
        reading = self.arms.reading
        wanted, error, off = self._courses.now_and_ahead(self.step_count, reading.tip_pose)
        self.target = wanted
        seen: Reading | Measured = reading
        seen_error = error
        if self._sensors is not None:
            seen, seen_error = self._sensors.measured(reading, self.step_count, members), np.empty_like(error)
            pose_errors(seen.tip_pose, wanted.tip_pose, seen_error)
        met = NO_CONTACT if self._contacts is None else self._contacts.look(members)
        observed = Observed(self.arms, seen, seen_error, wanted, self._action, self.actuation.command, met, self._at_rest)
        self._present = self.layout.present(observed)
        if self.task.goal is not None:
            self._goals = self._goals_of(observed)
        if self._history is not None:
            self._history.keep(self._present, self.step_count, members)
        tracking = Tracking(self.arms, wanted, error[:, 0], off)
        self.errors = {error.name: error.value(tracking) for error in self.task.errors}
        if self._contacts is not None:
            self.errors |= {"penetration": met.penetration, "contact_force": met.load}
        self.diverged = self.arms.outcome.status != OK
        if self.options.tip_speed_limit is not None:
            self.diverged |= norm(reading.tip_twist[:, 3:]) > self.options.tip_speed_limit
        self.terms, self.reward = self._judged()
        self.reward[self.diverged] = 0.0

    @property
    def actions(self) -> ActionScale:
        """The action scaling."""
        return self.actuation.actions

    def _judged(self) -> tuple[dict[str, Array], Array]:
        """Reward terms by name and what they make the reward, (rows,) each, new arrays."""
        if self._rewarded is None:
            assert self.task.goal is not None
            return {}, self.task.goal.reward(*self._goals, self.goal_kind, self.options.threshold)
        return self._rewarded.of(self.errors, self._applied, self._action_change)

    def target_at(self, row: int, times: Array) -> TargetSamples:
        """A row's target at times (m,) [s] from the beginning of its episode."""
        return self._courses.at(row, times)

    def target_ahead(self, periods: int) -> TargetSamples:
        """The targets of all rows (rows, 1 + periods, ..) now and in the periods ahead. Raises ValueError beyond the longest preview."""
        return self._courses.until(self.step_count, periods)

    @property
    def target_pose(self) -> Array:
        """Of the tip (rows, 4, 4)."""
        return self.target.tip_pose[:, 0]

    @property
    def target_backbone(self) -> Array:
        """(rows, stations, 3) [m]; no stations unless the task compares shapes."""
        return self.target.backbone[:, 0]

    @property
    def goal_kind(self) -> GoalReward:
        """ "sparse" or "dense", for goal-conditioned tasks."""
        return self.options.reward if self.options.reward in ("sparse", "dense") else "sparse"

    def _goals_of(self, observed: Observed) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Achieved and desired goals: tip positions as measured and as wanted (rows, 3) [m], clipped to their space."""
        reach = np.float32(self.goal_bound)
        positions = observed.tip_pose[:, :3, 3], self.target_pose[:, :3, 3]
        achieved, desired = (np.minimum(np.maximum(position.astype(np.float32), -reach), reach) for position in positions)
        return achieved, desired

    @property
    def goal_bound(self) -> float:
        """Largest coordinate [m] of goals."""
        return 2.0 * self.model.length

    def observation(self) -> Any:
        """A new array (rows, size) float32, or for goal-conditioned tasks a dictionary of them."""
        flat = self._present.copy() if self._history is None else np.concatenate([self._present, self._history.changes], axis=1)
        if not self.task.goal:
            return flat
        achieved, desired = self._goals
        return {"observation": flat, "achieved_goal": achieved.copy(), "desired_goal": desired.copy()}

    @property
    def model_seconds(self) -> Array:
        """Time (rows,) [s] that a control period of what rows observe takes on the model: that of inverse statics, which a policy that
        observes them needs as much as its own. They are computed ahead, several poses at a time."""
        return self._courses.seconds

    def info(self) -> dict[str, NDArray[Any]]:
        """Errors, reward terms as "reward_<term>", "diverged", "rejected_steps" and for goals "is_success", new arrays (rows,)."""
        info: dict[str, NDArray[Any]] = {**self.errors, **{f"reward_{name}": value for name, value in self.terms.items()}}
        info["diverged"] = self.diverged
        info["rejected_steps"] = self.arms.outcome.rejected.copy()
        if self.task.goal:
            info["is_success"] = self.task.goal.distance(*self._goals) <= self.options.threshold
        return info

    def remember(self) -> None:
        """Keep where the rows stand in `last`."""
        rows, reading = self.arms.rows, self.arms.reading
        self.last = Snapshot(rows.xi.copy(), self.tension.copy(), reading.tip_pose.copy(), self.target_pose, self.target_backbone)

    def cause(self, row: int) -> str:
        """Why the last step of a row failed."""
        if self.arms.outcome.status[row] == OK:
            speed = float(norm(self.arms.reading.tip_twist[row, 3:]))
            return f"the tip moved at {speed:.3g} m/s, tip_speed_limit is {self.options.tip_speed_limit:g}"
        return cause_of(int(self.arms.outcome.status[row]), self.model, step_control(self.model, self.period))

    def state(self, row: int) -> State:
        """The motion of a row, as Simulation has it."""
        rows = self.arms.rows
        time, step = float(rows.clock[row, 0]), float(rows.step[row])
        strain = self.model.grid.unpacked(rows.xi[row])
        names = self.arms.model_of(row).state_names
        return State(time, rows.q[row].copy(), rows.q_dot[row].copy(), strain, step, rows.state[row].copy(), names)

    def contact_forces(self, row: int) -> ContactForces:
        """Contact of a row with its obstacles now, per obstacle and along the arm. Raises ValueError where the scene has no contact."""
        return contact_forces(self.arms.model_of(row), self.state(row))

    def drawn_effects(self, row: int) -> dict[str, Array]:
        """What `randomize.effects` has drawn for a row's episode: by key, () or (m,)."""
        return self._effects.values(self.arms.effects_of(row))


def _reward_of(task: Task, options: Options, strongest: Array, contact: bool) -> Reward:
    given = options.reward
    weights = given if isinstance(given, dict) else {name: Weight(weight=weight) for name, weight in task.reward.items()}
    missing = [name for name in weights if name in CONTACT_TERMS and not contact]
    if missing:
        problems = [Problem(("reward", name), "needs a scene with obstacles, effects.contact") for name in missing]
        raise ConfigurationError(problems, "environment")
    return Reward(weights, {**task.terms, **(CONTACT_TERMS if contact else {})}, strongest, "environment")


def episodes_of(env: Any) -> Episodes:
    """The episodes that an environment of this package runs, single, vector or for Stable-Baselines3, wrapped or not. Raises TypeError."""
    inner = env.unwrapped if isinstance(env, gym.Env | gym.vector.VectorEnv) else getattr(env, "env", None)
    episodes = getattr(inner, "episodes", None)
    if not isinstance(episodes, Episodes):
        raise TypeError(f"env should be an environment of soft_tendon_env, not {inner or type(env).__name__}")
    return episodes
