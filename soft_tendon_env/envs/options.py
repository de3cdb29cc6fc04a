"""Keyword arguments of the environments, and options of their `reset`.

They are plain values, so that specs serialise and workers get them.
"""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NoReturn, Self

import numpy as np
from pydantic import AfterValidator, Field, InstanceOf, field_validator

from soft_tendon_env.accuracy.fidelity import at_fidelity, checked_fidelity
from soft_tendon_env.envs.observation import Group
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.targets import (
    TARGETS,
    DrawnShapes,
    NamedTarget,
    Target,
    file,  # noqa: F401 (registers its target)
)
from soft_tendon_env.envs.targets.shipped import Hold
from soft_tendon_env.envs.tasks import Task
from soft_tendon_env.envs.tracking import GoalReward, Weight, weights_of
from soft_tendon_env.model.state import State
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import (
    Scene,
    TensionLimits,
    extrapolation_columns,
    rod_length,
    scene_to_dict,
)
from soft_tendon_env.tools.checks import checked_count
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    shown,
)
from soft_tendon_env.tools.types import Array, NotNegative, Positive

MOST_AHEAD = 10_000
"""Control periods by which a preview looks ahead at most: every row keeps its target for that
long."""

GOAL_BOUND = 2.0
"""Largest distance of goals from the base along the world's axes, in lengths of the rod."""

THRESHOLD = 0.01
"""Distance, in lengths of the rod, within which a goal is reached by default."""

MASK = "reset_mask"
"""Key of the rows that a vector environment resets, (rows,) bool; the others go on."""

DIFFICULTIES: Mapping[str, Mapping[str, float]] = {
    "easy": {"fraction": 0.25, "knot_period": 1.0},
    "medium": {"fraction": 0.4, "knot_period": 0.6},
    "hard": {"fraction": 0.6, "knot_period": 0.3},
}
"""Settings of drawn targets by difficulty; "easy" are their defaults."""

EXTRAPOLATED = re.compile(r"^segments\..*?\.(young_modulus|damping|retardation_time)\b")
"""Names of drawn numbers on which the number of columns of extrapolation depends."""

Difficulty = Literal["easy", "medium", "hard"]
SensorCount = Annotated[int, Field(ge=1, le=10_000)]
SensorPlaces = Annotated[tuple[NotNegative, ...], Field(max_length=10_000)]


def at_difficulty(target: Target, difficulty: Difficulty | None) -> Target:
    """Target, or those that it draws from, with the settings of a difficulty that it leaves open.

    Args:
        target: as it was named.
        difficulty: None for the target's own settings.

    Returns:
        The same target where there is nothing to set.
    """
    if difficulty is None or not target.is_random:
        return target
    settings: dict[str, Any] = {}
    for name in target.model_fields_set:
        settings[name] = getattr(target, name)
    more: dict[str, Any] = {}
    if "of" in settings:
        parts = settings["of"]
        set_parts = [at_difficulty(part, difficulty) for part in parts]
        pairs = zip(parts, set_parts, strict=True)
        if any(after is not before for before, after in pairs):
            more["of"] = set_parts
    if isinstance(target, DrawnShapes):
        more = {}
        for name, value in DIFFICULTIES[difficulty].items():
            if name in type(target).model_fields and name not in settings:
                more[name] = value
    if not more:
        return target
    return type(target)(**settings | more)


def _usual_preview(values: dict[str, Any]) -> tuple[float, ...]:
    """Default preview times [s] of options that are valid so far."""
    period = values.get("control_period", 0.0)
    coarser = max(0.2, 2 * period)
    return max(0.1, period), coarser


class Options(Configuration):
    """Keyword arguments of every environment.

    Attributes:
        scene: name of a shipped scene, path of a TOML file, a `Scene`, or a table. A table is a
            whole scene as `scene_to_dict` gives it, or dotted overrides of a scene, such as
            `{"scene": "paper", "effects.gravity.acceleration": [0, 0, -9.81]}`.
        fidelity: accuracy of the simulation. "fast", "standard" and "fine" are presets of strain
            field, quadrature and integrator; "scene" keeps the scene's own settings; a length such
            as "1mm" is an error of the tip. An arm that does not ship gets a trial, once. None
            keeps what the scene sets and takes the rest from "standard".
        control_period: time [s] between actions. The scene's integrator takes equal steps within
            it.
        tension_limits: (minimum, maximum) tension [N] of every tendon; None takes the scene's. With
            a negative minimum tendons push.
        action: "increment" maps [-1, 1] to changes of the tensions, of at most `tension_rate` times
            the control period, 2 N by default, from those asked for before; "tension" maps it to
            the tension limits.
        tension_rate: largest rate of change [N/s] of actions that are increments. Actions that are
            tensions do not use it; `rate_limit` bounds both kinds.
        rate_limit: largest rate of change [N/s] of the commands, whatever the actions are: a
            command moves towards the requested one at no more than this rate. None sets no limit,
            so that actions that are tensions may jump. With `effects.actuators.rate_limit`
            actuators also need time within a period.
        target: name of a target ("random", "hold", "circle", "ramp", "steps", "out_of_reach" or
            another of TARGETS), a table with that `type` and its settings, or a target object. None
            takes the task's default.
        difficulty: "easy", "medium" or "hard" sets what a drawn target leaves open: `fraction` to
            0.25, 0.4 or 0.6, and `knot_period`, of random motions, to 1.0, 0.6 or 0.3 s. None
            leaves it to the target, whose defaults are easy.
        observation: "full", "measurable" (tip pose, tendon lengths, strain sensors), or a list of
            observation groups.
        preview: times ahead [s] at which the target is observed too, rounded to whole control
            periods (1 to 10,000), in the groups whose names end in `preview`. The default is 0.1
            and 0.2 s, or one and two control periods where a period is longer than that.
        history: number of past control periods that are observed too, for the groups that describe
            the arm.
        sensors: arc lengths [m] of strain sensors, or their number; then each is in the middle of
            one of as many equal parts of the rod. The groups `strain` and `strain_rate` observe
            them, and estimators measure them whatever is observed.
        reward: weight of each reward term, a number or a table with `weight` and `scale`; None
            takes the task's. Reach takes "sparse" (the default) or "dense".
        threshold: distance [m] to the goal within which Reach, or another task with a goal, counts
            as successful; None takes a hundredth of the rod's length. Drawn goals are farther than
            that from where the tip begins.
        randomize: domain randomization, parameters that are drawn at every reset.
        tip_speed_limit: tip speed [m/s] above which an episode ends early and counts as diverged;
            None sets no limit. It is for training: a policy that has made the arm oscillate gains
            nothing from the rest of that episode.
    """

    scene: str | dict[str, Any] = "paper"
    fidelity: Annotated[str, AfterValidator(checked_fidelity)] | None = None
    control_period: Annotated[float, Field(ge=1e-6, le=100.0)] = 0.02
    tension_limits: TensionLimits | None = None
    action: Literal["increment", "tension"] = "increment"
    tension_rate: Positive = 100.0
    rate_limit: Positive | None = None
    target: NamedTarget | None = None
    difficulty: Difficulty | None = None
    observation: str | tuple[str, ...] = "full"
    preview: tuple[Positive, ...] = Field(default_factory=_usual_preview)
    history: int = Field(default=0, ge=0, le=1_000)  # every row keeps its observations so long
    sensors: SensorCount | SensorPlaces = ()
    reward: dict[str, Weight] | GoalReward | None = None
    threshold: Annotated[Positive, Field(ge=1e-9)] | None = None
    randomize: Randomization = Field(default=Randomization())
    tip_speed_limit: Positive | None = None

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """Parses the options of keyword arguments, as of every configuration.

        Args:
            values: the arguments by name.
            source: the environment's class, for messages.

        Returns:
            The options.

        Raises:
            ConfigurationError: of all invalid arguments.
            TypeError: for `frameskip`, which TorchRL tries, and leaves out where that is raised.
        """
        if "frameskip" in values:
            raise TypeError(f"{source} got an unexpected keyword argument 'frameskip'")
        return super().parse(values, source)

    @field_validator("scene", mode="before")
    @classmethod
    def _plain_scene(cls, scene: Any) -> Any:
        if not isinstance(scene, str | dict | Scene):
            raise ValueError(
                "should be the name of a shipped scene, the path of a TOML file, a Scene, or a"
                " table as of scene_to_dict"
            )
        if isinstance(scene, Scene):
            return scene_to_dict(scene)
        return scene

    @field_validator("preview", mode="before")
    @classmethod
    def _times(cls, preview: Any) -> Any:
        is_numeric = isinstance(preview, int | float)
        if is_numeric and not isinstance(preview, bool):
            raise ValueError(f"should be a list of times ahead [s]: [{preview}]")
        return preview

    @field_validator("reward", mode="before")
    @classmethod
    def _plain_weights(cls, reward: Any) -> Any:
        if isinstance(reward, dict):
            return weights_of(reward)
        return reward

    def sensor_places(self, scene: Scene) -> Array:
        """Returns the arc lengths of the strain sensors.

        Args:
            scene: of the environment.

        Returns:
            Arc lengths (s,) [m] from the base.
        """
        if not isinstance(self.sensors, int):
            return np.array(self.sensors, dtype=np.float64)
        count = self.sensors
        middles = np.arange(count) + 0.5
        return rod_length(scene) * middles / count

    def threshold_of(self, length: float) -> float:
        """Returns the distance within which goals are reached.

        Args:
            length: of the rod [m].

        Returns:
            Distance [m].
        """
        if self.threshold is None:
            return THRESHOLD * length
        return self.threshold

    def farthest_base(self, scene: Scene) -> float:
        """Returns the largest coordinate of the base in the world.

        It holds also where the base's position is drawn.

        Args:
            scene: of the environment.

        Returns:
            Size of the coordinate [m].
        """
        coordinates = [*scene.base.position]
        for drawn in self.randomize.ranges(scene):
            if drawn.name.startswith("base.position"):
                coordinates += drawn.changes(drawn.least).values()
                coordinates += drawn.changes(drawn.greatest).values()
        return max(map(abs, coordinates))


class ResetOptions(Configuration):
    """Entries of `reset(options={...})` for one episode.

    None, as without the entry, is what the environment's own arguments say.

    Attributes:
        state: `State` in which the arm begins, with its rates, the internal states of effects and
            its time; of an arm like this episode's. Commands before are those of an arm at rest.
        goal: position of the tip to reach, three numbers [m] in the world frame (Reach), or its
            pose, 4 x 4 (Reach, TipPose).
        target: target of this episode, as the argument `target`, unless there is a goal.
        episode_steps: steps after which the episode is truncated, where that is sooner than
            otherwise.
    """

    state: InstanceOf[State] | None = None
    goal: Hold | None = None
    target: NamedTarget | None = None
    episode_steps: int | None = Field(default=None, ge=1)

    @field_validator("goal", mode="before")
    @classmethod
    def _as_hold(cls, goal: Any) -> Any:
        shape: tuple[int, ...] = ()
        if isinstance(goal, list | tuple | np.ndarray):
            shape = np.shape(goal)
        if shape == (3,):
            return Hold(position=goal)
        if shape == (4, 4):
            return Hold(pose=goal)
        raise ValueError("should be a position of three numbers [m], or a pose, 4 x 4")


def reset_options(options: Any, rows: int | None = None) -> dict[int, ResetOptions]:
    """Options of a reset by row.

    Args:
        options: for every key a value of each row, None for what is usual; None: no options.
        rows: of a vector environment; None: the values are those of row 0 themselves.

    Returns:
        The options by row; empty without any.

    Raises:
        ConfigurationError: for other keys and values.
        TypeError: where the options are no table.
    """
    if not isinstance(options, dict | None):
        raise TypeError(f"options should be a dict or None, not {type(options).__name__}")
    table = options or {}
    _check_keys(table, rows)
    values = {}
    for key, value in table.items():
        if value is not None and key != MASK:
            values[key] = value
    if not values:
        return {}
    if rows is None:
        return {0: ResetOptions.parse(values, "options")}
    for key, column in values.items():
        is_column = isinstance(column, list | tuple | np.ndarray)
        if not is_column or len(column) != rows:
            text = f"should have one value per row, {rows}, each None for what is usual"
            raise ConfigurationError([Problem((key,), text)], "options")
    options_of: dict[int, ResetOptions] = {}
    for row in range(rows):
        own = {}
        for key, column in values.items():
            value = column[row]
            if value is not None:
                own[key] = value
        options_of[row] = ResetOptions.parse(own, f"options of row {row}")
    return options_of


def _check_keys(table: Mapping[Any, Any], rows: int | None) -> None:
    """Raises ConfigurationError for keys that are no options of a reset."""
    allowed = {*ResetOptions.model_fields}
    if rows is not None:
        allowed.add(MASK)
    problems = list[Problem]()
    for key in table:
        if key not in allowed:
            name = str(key)
            text = f"is no option of reset: {not_among(name, allowed)}"
            problems.append(Problem((name,), text))
    if problems:
        raise ConfigurationError(problems, "options")


def row_seeds(seed: Any, rows: int) -> list[int | None]:
    """Seeds of a reset for each row, None to go on.

    Args:
        seed: a number, for row i that number + i; a list of one for each row; or None.
        rows: of the environment.

    Returns:
        The seeds.

    Raises:
        TypeError: for what is no integer.
        ValueError: for negative ones and for lists of another length.
    """
    if seed is None:
        return [None] * rows
    if not isinstance(seed, list | tuple | np.ndarray) or np.ndim(seed) == 0:
        first = checked_count("seed", seed, 0)
        return [first + row for row in range(rows)]
    if len(seed) != rows:
        raise ValueError(f"seed should be an int or a list of {rows}, not of {len(seed)}")
    seeds: list[int | None] = []
    for row, own in enumerate(seed):
        if own is None:
            seeds.append(None)
        else:
            row_seed = checked_count(f"seed[{row}]", own, 0)
            seeds.append(row_seed)
    return seeds


def resolved_scene(options: Options) -> Scene:
    """Scene of the options, at their fidelity and with their tension limits.

    Where it leaves them open, it has as many columns of extrapolation as suit the least damping and
    the greatest stiffness that can be drawn.

    Args:
        options: of an environment.

    Returns:
        The scene.

    Raises:
        ConfigurationError: where options do not fit the scene.
    """
    scene = at_fidelity(given_scene(options.scene), options.fidelity)
    changes: dict[str, Any] = {}
    if options.tension_limits is not None:
        for i in range(len(scene.tendons)):
            changes[f"tendons.{i}.tension_limits"] = options.tension_limits
    columns = _columns_of_extremes(options, scene)
    if columns is not None:
        changes["integrator.columns"] = columns
    if changes:
        return scene.replace(changes)
    return scene


def _columns_of_extremes(options: Options, scene: Scene) -> int | None:
    """Columns of extrapolation that suit the stiffest and least damped arm that can be drawn.

    None where they are those of the scene.
    """
    extremes: dict[str, float] = {}
    for drawn in options.randomize.ranges(scene):
        match = EXTRAPOLATED.search(drawn.name)
        if match:
            is_stiffness = match[1] == "young_modulus"
            if is_stiffness:
                extreme = drawn.greatest
            else:
                extreme = drawn.least
            extremes |= drawn.changes(extreme)
    if not extremes:
        return None
    try:
        columns = extrapolation_columns(scene.replace(extremes))
    except ConfigurationError:
        # an end that cannot be is told with its key, when the arms are drawn
        return None
    if columns == extrapolation_columns(scene):
        return None
    return columns


def given_scene(scene: Any) -> Scene:
    """The scene that the option `scene` names, as it is written.

    Raises ConfigurationError, FileNotFoundError.
    """
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, dict):
        return load_scene(scene)
    if "segments" in scene:
        return Scene.parse(scene, "scene")
    changes = dict(scene)
    return given_scene(changes.pop("scene", "paper")).replace(changes)


def groups_of(options: Options, task: Task) -> dict[str, Group]:
    """Chosen observation groups of a task, by name.

    Args:
        options: of an environment.
        task: that the environment is of.

    Returns:
        The groups in their order.

    Raises:
        ConfigurationError: for names that the task does not have, no group, and one twice.
    """
    chosen = options.observation
    allowed = task.observable
    if isinstance(chosen, str):
        if chosen not in task.observations:
            choices = not_among(chosen, task.observations)
            _fail("observation", f"is {chosen!r}: {choices}, or a list of groups")
        chosen = task.observations[chosen]
    for name in chosen:
        if name not in allowed:
            hint = not_among(name, allowed)
            _fail("observation", f"names {name!r}: {hint}")
    different = set(chosen)
    if not chosen or len(different) < len(chosen):
        _fail("observation", f"is {list(chosen)}: it should name at least one group, each once")
    return {name: allowed[name] for name in chosen}


def check_fit(options: Options, task: Task, scene: Scene) -> None:
    """Raise an error where options do not fit the task or the scene.

    Args:
        options: of an environment.
        task: that the environment is of.
        scene: of the options.

    Raises:
        ConfigurationError: also where times would be rounded to something else.
    """
    _check_preview(options)
    length = rod_length(scene)
    farthest = options.sensor_places(scene).max(initial=0.0)
    if farthest > length:
        message = f"names {farthest:g}: it should be at most the rod's length, {length:g}"
        _fail("sensors", message)
    target = options.target or usual_target(task)
    leaves_nothing_open = checked_target(target, options, task, scene) is target
    if leaves_nothing_open and options.difficulty is not None:
        _fail(
            "difficulty",
            f"is {options.difficulty!r}, and the target {target.type!r} leaves neither fraction nor"
            " knot_period open",
        )
    if task.goal is None and options.threshold is not None:
        _fail(
            "threshold",
            f"is {options.threshold:g}, which tasks with a goal have, such as Reach, and"
            f" {task.name} has none",
        )
    groups = groups_of(options, task)
    describes_arm = any(group.of_arm for group in groups.values())
    if options.history and not describes_arm:
        _fail(
            "history",
            f"is {options.history}, and the observation has no group that describes the arm:"
            " no past is observed",
        )
    if options.reward is None:
        return
    has_weights = isinstance(options.reward, dict)
    if task.goal is not None and has_weights:
        _fail("reward", "should be 'sparse' or 'dense'")
    if task.goal is None and not has_weights:
        usual = dict(task.reward)
        _fail(
            "reward",
            f"is {options.reward!r}, which tasks with a goal have, such as Reach: {task.name} takes"
            f" a table of weights by term, such as {usual}",
        )


def _check_preview(options: Options) -> None:
    """Raises ConfigurationError for preview times that would be rounded to now, or are too far."""
    period = options.control_period
    for i, time in enumerate(options.preview):
        if not 0.5 < time / period <= MOST_AHEAD:
            allowed = (
                f"more than half a control period, {period / 2:g} s, and at most {MOST_AHEAD} of"
                f" them, {MOST_AHEAD * period:g} s"
            )
            message = f"is {time:g}: it should be {allowed}"
            _fail(f"preview[{i}]", message)


def usual_target(task: Task) -> Target:
    """The target of a task whose options name none."""
    return TARGETS[task.target](type=task.target)


def checked_target(
    target: Target | None,
    options: Options,
    task: Task,
    scene: Scene,
) -> Target:
    """Target at the difficulty of the options, which fits the task and the scene.

    Args:
        target: None for that of the options, or else of the task.
        options: of an environment.
        task: that the environment is of.
        scene: of the options.

    Returns:
        The target.

    Raises:
        ConfigurationError: where it does not fit the task or the scene.
    """
    named = target or options.target or usual_target(task)
    checked = at_difficulty(named, options.difficulty)
    for part in getattr(checked, "of", ()):
        checked_target(part, options, task, scene)
    if task.shapes and not checked.gives_shapes:
        _fail(
            "target",
            f"is {checked.type!r}, which is a pose alone: {task.name} needs one that is made of"
            " tensions, such as random or ramp",
        )
    if isinstance(checked, Hold) and checked.given_pose is not None:
        _check_pose(checked, checked.given_pose, task, scene)
    checked.check(scene)
    return checked


def _check_pose(
    target: Hold,
    pose: Array,
    task: Task,
    scene: Scene,
) -> None:
    """Raise an error where a pose (4, 4) to hold does not fit the task, or a goal the bounds.

    Raises ConfigurationError.
    """
    if task.goal is None:
        if target.position is not None:
            _fail("target.position", f"is a position alone: {task.name} needs a pose, 4 x 4")
        return
    place = pose[:3, 3]
    base = scene.base.position
    bound = GOAL_BOUND * rod_length(scene)
    distance = np.abs(place - base).max()
    if distance <= bound:
        return
    allowed = f"within ±{bound:g} m, {GOAL_BOUND:g} lengths of the rod"
    if any(base):
        allowed += f", around the base at {shown(base)} m"
    if target.position is None:
        key = "target.pose"
    else:
        key = "target.position"
    place_shown = shown(place.tolist())
    _fail(key, f"is at {place_shown} m: goals should lie {allowed}")


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)], "environment")
