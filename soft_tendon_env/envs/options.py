"""Keyword arguments of the environments, and options of their `reset`: plain values, so that specs
serialise and workers get them."""

import contextlib
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

# control periods by which a preview looks ahead: every row keeps its target for that long
MOST_AHEAD = 10_000
GOAL_BOUND = (
    2.0  # largest distance of goals from the base along the world's axes, in lengths of the rod
)
MASK = (  # key of the rows that a vector environment resets, (rows,) bool; the others go on
    "reset_mask"
)


DIFFICULTIES: Mapping[str, Mapping[str, float]] = {
    "easy": {"fraction": 0.25, "knot_period": 1.0},
    "medium": {"fraction": 0.4, "knot_period": 0.6},
    "hard": {"fraction": 0.6, "knot_period": 0.3},
}
"""Settings of drawn targets by difficulty; "easy" are their defaults."""
Difficulty = Literal["easy", "medium", "hard"]


def at_difficulty(target: Target, difficulty: Difficulty | None) -> Target:
    """The target, or those that it draws from, with the settings of a difficulty that it leaves
    open; the same where there are none."""
    if difficulty is None or not target.is_random:
        return target
    given: dict[str, Any] = {name: getattr(target, name) for name in target.model_fields_set}
    more: dict[str, Any] = (
        {"of": [at_difficulty(one, difficulty) for one in given["of"]]} if "of" in given else {}
    )
    if isinstance(target, DrawnShapes):
        more = {
            name: value
            for name, value in DIFFICULTIES[difficulty].items()
            if name in type(target).model_fields and name not in given
        }
    return type(target)(**given | more) if more else target


class Options(Configuration):
    """The keyword arguments of every environment.

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
            tensions may jump.
        target: name of a target ("random", "hold", "circle", "ramp", "steps", "out_of_reach" or
            another of TARGETS), a table with that `type` and its settings, or a target object. None
            takes the task's default.
        difficulty: "easy", "medium" or "hard" sets what a drawn target leaves open: `fraction` to
            0.25, 0.4 or 0.6, and `knot_period`, of random motions, to 1.0, 0.6 or 0.3 s. None
            leaves it to the target, whose defaults are easy.
        observation: "full", "measurable" (tip pose, tendon lengths, strain sensors), or a list of
            observation groups.
        preview: times ahead [s] at which the target is observed too, rounded to whole control
            periods (1 to 10,000). The default is 0.1 and 0.2 s, or one and two control periods
            where a period is longer than that.
        history: number of past control periods that are observed too, for the groups that describe
            the arm.
        sensors: arc lengths [m] of strain sensors, or their number; then each is in the middle of
            one of as many equal parts of the rod.
        reward: weight of each reward term, a number or a table with `weight` and `scale`; None
            takes the task's. Reach takes "sparse" (the default) or "dense".
        threshold: distance [m] to the goal within which Reach counts as successful; None takes a
            hundredth of the rod's length. Drawn goals are farther than that from where the tip
            begins.
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
    target: NamedTarget | None = None
    difficulty: Difficulty | None = None
    observation: str | tuple[str, ...] = "full"
    preview: tuple[Positive, ...] = Field(
        default_factory=lambda given: tuple(
            max(0.1 * k, k * given.get("control_period", 0.0)) for k in (1, 2)
        )
    )
    history: int = Field(
        default=0, ge=0, le=1_000
    )  # every row keeps its observations for that long
    sensors: (
        Annotated[int, Field(ge=1, le=10_000)]
        | Annotated[tuple[NotNegative, ...], Field(max_length=10_000)]
    ) = ()
    reward: dict[str, Weight] | GoalReward | None = None
    threshold: Annotated[Positive, Field(ge=1e-9)] | None = None
    randomize: Randomization = Field(default=Randomization())
    tip_speed_limit: Positive | None = None

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """As of every configuration. Raises TypeError for `frameskip`, which TorchRL tries, and
        leaves out where that is raised."""
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
        return scene_to_dict(scene) if isinstance(scene, Scene) else scene

    @field_validator("reward", mode="before")
    @classmethod
    def _plain_weights(cls, reward: Any) -> Any:
        return weights_of(reward) if isinstance(reward, dict) else reward

    def sensor_places(self, scene: Scene) -> Array:
        """Arc lengths (s,) [m] of the strain sensors."""
        many = self.sensors
        return (
            rod_length(scene) * (np.arange(many) + 0.5) / many
            if isinstance(many, int)
            else np.array(many, dtype=np.float64)
        )

    def farthest_base(self, scene: Scene) -> float:
        """Largest coordinate [m] that the base has in the world, also where its position is
        drawn."""
        drawn = [
            one for one in self.randomize.ranges(scene) if one.name.startswith("base.position")
        ]
        ends = [
            number
            for one in drawn
            for end in (one.least, one.greatest)
            for number in one.changes(end).values()
        ]
        return max(map(abs, (*scene.base.position, *ends)))


class ResetOptions(Configuration):
    """Entries of `reset(options={...})` for one episode; None, as without the entry: what the
    environment's own arguments say.

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
        shape = np.shape(goal) if isinstance(goal, list | tuple | np.ndarray) else ()
        if shape not in ((3,), (4, 4)):
            raise ValueError("should be a position of three numbers [m], or a pose, 4 x 4")
        return Hold(position=goal) if shape == (3,) else Hold(pose=goal)


def reset_options(options: Any, rows: int | None = None) -> dict[int, ResetOptions]:
    """The options of a reset by row: one value for every key of each of `rows`, None for what is
    usual; `rows` None: those of row 0. Raises ConfigurationError, TypeError where they are no
    table."""
    if not isinstance(options, dict | None):
        raise TypeError(f"options should be a dict or None, not {type(options).__name__}")
    allowed = {*ResetOptions.model_fields, *([] if rows is None else [MASK])}
    if unknown := [str(key) for key in options or () if key not in allowed]:
        raise ConfigurationError(
            [
                Problem((key,), f"is no option of reset: {not_among(key, allowed)}")
                for key in unknown
            ],
            "options",
        )
    given = {
        key: value for key, value in (options or {}).items() if value is not None and key != MASK
    }
    if rows is None:
        return {0: ResetOptions.parse(given, "options")} if given else {}
    for key, value in given.items():
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != rows:
            raise ConfigurationError(
                [
                    Problem(
                        (key,),
                        f"should have one value per row, {rows}, each None for what is usual",
                    )
                ],
                "options",
            )
    tables = [
        {key: values[row] for key, values in given.items() if values[row] is not None}
        for row in range(rows)
    ]
    return (
        {
            row: ResetOptions.parse(table, f"options of row {row}")
            for row, table in enumerate(tables)
        }
        if given
        else {}
    )


def row_seeds(seed: Any, rows: int) -> list[int | None]:
    """A seed of a reset for each row, None to go on. Raises TypeError or ValueError."""
    if seed is None:
        return [None] * rows
    if isinstance(seed, list | tuple | np.ndarray) and np.ndim(seed):
        if len(seed) != rows:
            raise ValueError(f"seed should be an int or a list of {rows}, not of {len(seed)}")
        return [
            None if one is None else checked_count(f"seed[{i}]", one, 0)
            for i, one in enumerate(seed)
        ]
    first = checked_count("seed", seed, 0)
    return [first + i for i in range(rows)]


def resolved_scene(options: Options) -> Scene:
    """The scene of the options: at their fidelity, with their tension limits, and, where it leaves
    them open, as many columns of extrapolation as suit the least damping and the greatest stiffness
    that can be drawn. Raises ConfigurationError."""
    scene = at_fidelity(given_scene(options.scene), options.fidelity)
    tendons = range(0 if options.tension_limits is None else len(scene.tendons))
    changes: dict[str, Any] = {
        f"tendons.{i}.tension_limits": options.tension_limits for i in tendons
    }
    ends: dict[str, float] = {}
    for drawn in options.randomize.ranges(scene):
        if kind := re.search(
            r"^segments\..*?\.(young_modulus|damping|retardation_time)\b", drawn.name
        ):
            ends |= drawn.changes(drawn.greatest if kind[1] == "young_modulus" else drawn.least)
    with contextlib.suppress(
        ConfigurationError
    ):  # an end that cannot be is told with its key, when the arms are drawn
        if ends and (
            columns := extrapolation_columns(scene.replace(ends))
        ) != extrapolation_columns(scene):
            changes["integrator.columns"] = columns
    return scene.replace(changes) if changes else scene


def given_scene(scene: Any) -> Scene:
    """The scene that the option `scene` names, as it is written. Raises ConfigurationError,
    FileNotFoundError."""
    if isinstance(scene, Scene):
        return scene
    if not isinstance(scene, dict):
        return load_scene(scene)
    if "segments" in scene:
        return Scene.parse(scene, "scene")
    changes = dict(scene)
    return given_scene(changes.pop("scene", "paper")).replace(changes)


def groups_of(options: Options, task: Task) -> dict[str, Group]:
    """The chosen observation groups by name. Raises ConfigurationError."""
    chosen, allowed = options.observation, task.observable
    if isinstance(chosen, str):
        if chosen not in task.observations:
            _fail(
                "observation",
                f"is {chosen!r}: {not_among(chosen, task.observations)}, or a list of groups",
            )
        chosen = task.observations[chosen]
    for name in chosen:
        if name not in allowed:
            _fail("observation", f"names {name!r}: {not_among(name, allowed)}")
    if not chosen or len(set(chosen)) < len(chosen):
        _fail("observation", f"is {list(chosen)}: it should name at least one group, each once")
    return {name: allowed[name] for name in chosen}


def check_fit(options: Options, task: Task, scene: Scene) -> None:
    """Raises ConfigurationError where options do not fit the task or the scene, or times would be
    rounded to something else."""
    period, length = options.control_period, rod_length(scene)
    for i, time in enumerate(options.preview):
        if not 0.5 < time / period <= MOST_AHEAD:
            allowed = (
                f"more than half a control period, {period / 2:g} s, and at most {MOST_AHEAD} of"
                f" them, {MOST_AHEAD * period:g} s"
            )
            _fail(f"preview[{i}]", f"is {time:g}: it should be {allowed}")
    if (farthest := options.sensor_places(scene).max(initial=0.0)) > length:
        _fail("sensors", f"names {farthest:g}: it should be at most the rod's length, {length:g}")
    target = options.target or usual_target(task)
    if checked_target(None, options, task, scene) is target and options.difficulty is not None:
        _fail(
            "difficulty",
            f"is {options.difficulty!r}, and the target {target.type!r} leaves neither fraction nor"
            " knot_period open",
        )
    if options.reward is not None and (task.goal is not None) == isinstance(options.reward, dict):
        _fail(
            "reward",
            (
                "should be 'sparse' or 'dense'"
                if task.goal
                else "should be a table of weights by term"
            ),
        )


def usual_target(task: Task) -> Target:
    """The target of a task whose options name none."""
    return TARGETS[task.target](type=task.target)


def checked_target(given: Target | None, options: Options, task: Task, scene: Scene) -> Target:
    """A target, by default that of the options or the task, at their difficulty. Raises
    ConfigurationError where it does not fit the task or the scene."""
    target = at_difficulty(given or options.target or usual_target(task), options.difficulty)
    for one in getattr(target, "of", ()):
        checked_target(one, options, task, scene)
    if task.shapes and not target.gives_shapes:
        kind = target.type
        _fail(
            "target",
            f"is {kind!r}, which is a pose alone: {task.name} needs one that is made of tensions,"
            " such as random or ramp",
        )
    if isinstance(target, Hold) and target.given is not None:
        place, bound = target.given[:3, 3], GOAL_BOUND * rod_length(scene)
        home = (
            f", around the base at {shown(scene.base.position)} m"
            if any(scene.base.position)
            else ""
        )
        if task.goal is None and target.position is not None:
            _fail("target.position", f"is a position alone: {task.name} needs a pose, 4 x 4")
        if task.goal is not None and np.abs(place - scene.base.position).max() > bound:
            key = "target.pose" if target.position is None else "target.position"
            allowed = f"within ±{bound:g} m, {GOAL_BOUND:g} lengths of the rod{home}"
            _fail(key, f"is at {shown(place.tolist())} m: goals should lie {allowed}")
    target.check(scene)
    return target


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)], "environment")
