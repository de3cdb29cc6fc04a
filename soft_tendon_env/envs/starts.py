"""How rows begin: at rest, with a material and effects of their own where those are drawn, clear of obstacles, and with a target."""

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, encountered, why_base_inside, why_inside, why_target_inside
from soft_tendon_env.envs.courses import Courses
from soft_tendon_env.envs.drawn_arms import Drawn, DrawnArms
from soft_tendon_env.envs.options import Options, Start, check_start, check_target
from soft_tendon_env.envs.randomization import Draw, draw_actuators, own_stream
from soft_tendon_env.envs.reset_options import ResetOptions
from soft_tendon_env.envs.targets import TARGETS, Course, Setting, ShapeCourse, Target, make_setting
from soft_tendon_env.envs.targets.equilibria import Equilibria
from soft_tendon_env.envs.targets.motions import Random
from soft_tendon_env.envs.targets.statics import HALVINGS, nearest_to_zero
from soft_tendon_env.envs.tasks import Task
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State, checked_motion
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.registration import MAX_EPISODE_STEPS
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array

MOST_DRAWS = 200
"""How often targets inside of obstacles are drawn before that is an error, and goals that are reached already, before they are taken."""
START = 1
"""Purpose of the random stream from which tensions to begin under are drawn."""
BANK_SEED = 2**64
"""Seed of the first course of a bank; the others follow, one apart: beyond all seeds of `reset` that have a purpose."""
THRESHOLD = 0.01
"""Distance within which a goal is reached, as a share of the rod's length, unless options say otherwise."""
EVERYWHERE = 7.0
"""Threshold, in lengths of the rod, beyond which it is asked that every goal be reached: the diagonal of the space that goals are in."""
TARGET_CHECKS = 100
"""Times in an episode of the usual length at which a target is checked not to lie inside of obstacles."""


Shape = tuple[Array, Array, Array]
"""Tensions (n_a,) [N], the command (n_a,) that holds them, and the coordinates (n,) of an arm at rest under them."""


class Beginning(NamedTuple):
    """How an episode of a row is to begin, checked."""

    start: Start
    target: Target | Course  # one that is drawn, or the course of one that is not
    state: State | None = None  # in which the row begins, whatever `start` says
    shape: Shape | None = None  # under `start`; None: it depends on what is drawn


class Begun(NamedTuple):
    """A row in which an episode has begun, at rest."""

    draw: Draw
    tension: Array  # (n_a,) [N]
    command: Array  # (n_a,) that holds it
    q: Array  # (n,)
    setting: Setting  # among which targets are drawn for it


class Starts:
    """Beginnings of rows of episodes.

    `usual` is how they begin unless a reset says otherwise. `tension` (n_a,) [N] and `command` (n_a,) hold the arm at rest, `q` (n,) are
    its coordinates there, where nothing is drawn; `drawn` are the arms that are drawn; within `threshold` [m] of the tip a goal is reached.
    """

    def __init__(self, task: Task, options: Options, arms: Arms, courses: Courses) -> None:
        """Raises ConfigurationError where the arm, or one that can be drawn, does not rest, or begins inside of an obstacle, and where the
        course of a target that is not drawn cannot be."""
        self._task, self._options, self._arms, self._model, self._courses = task, options, arms, arms.model, courses
        self.threshold = THRESHOLD * arms.model.length if options.threshold is None else options.threshold
        self.limits = np.array([tendon.tension_limits for tendon in arms.model.scene.tendons])
        self.tension = nearest_to_zero(self.limits)
        self._meets = encountered(arms.model)
        self.q = self._rest_of_scene()
        self.command = arms.model.command(self.tension, self.q)
        self.drawn = DrawnArms(options.randomize, arms.model, arms.size, self._rest_of, {*self._meets})
        self._setting = self._among(make_setting(arms, self.limits), self.q)
        target = options.target or TARGETS[task.target](type=task.target)
        if self.drawn.redraws and isinstance(target, Random) and target.bank is not None:
            text = f"is {target.bank}: it should be left out where obstacles are drawn, of which every target keeps clear"
            raise _problem(("target", "bank"), text)
        self._bank: dict[int, Course] = {}
        self.usual = Beginning(options.start, self._settled_target(target))

    def _settled_target(self, target: Target) -> Target | Course:
        """The course of a target; one that is drawn as it is. Raises ConfigurationError where the course cannot be, or lies inside of an
        obstacle."""
        if target.is_random:
            return target
        course = target.draw(np.random.default_rng(0), self._setting)
        if inside := self._target_inside(course, self._model):
            raise _problem(("target",), f"lies inside of an obstacle: {inside}")
        return course

    def beginning(self, given: ResetOptions) -> Beginning:
        """How a row with these options begins. Raises ConfigurationError, TypeError or ValueError where it cannot, but for what depends on
        the arm that is drawn for its episode: that is found out when it begins."""
        start, wanted, scene = given.start or self.usual.start, given.goal or given.target, self._model.scene
        check_start(start, scene)
        shape, target = None, self.usual.target
        if not self._options.randomize.of_arm:
            if not isinstance(start, str):
                shape = self._begin_shape(0, start, None, self.q)
            if given.state is not None:
                checked_motion(self._model, given.state)
        if wanted is not None:
            check_target(wanted, self._task, scene)
            target = self._settled_target(wanted)
        return Beginning(start, target, given.state, shape)

    def begin(self, row: int, how: Beginning, generator: np.random.Generator) -> Begun:
        """Give a row its arm and its target, drawn from a generator. Raises ConfigurationError."""
        start = own_stream(generator, START) if how.start == "random" else None
        drawn = self.drawn.draw(row, generator, lambda model: self._check_target(how.target, model))
        self._arms.set_model(row, drawn.model)
        draw = draw_actuators(self._options.randomize, self._model.tendon_count, generator)
        tension, command, q = how.shape or self._begin_shape(row, how.start, start, drawn.rest)
        setting = self._setting
        if isinstance(how.target, Target):
            if self.drawn.redraws:
                setting = self._among(setting._replace(model=self._obstacles_of(drawn)), drawn.rest / self._arms.ratio[row])
            self._courses.begin(row, *self.draw_course(how.target, generator, setting))
        else:
            self._courses.begin(row, how.target)
        return Begun(draw, tension, command, q, setting)

    def may_draw_again(self, target: Target | Course) -> bool:
        """Whether a goal that is reached at the beginning is drawn again: not one that is given, at rest, or with a threshold for all."""
        drawn_away = isinstance(target, Target) and not target.begins_at_rest
        return self._task.goal is not None and drawn_away and self.threshold <= EVERYWHERE * self._model.length

    def _check_target(self, target: Target | Course, model: Model) -> None:
        """Raises ConfigurationError where a target that is given lies inside of an obstacle that was drawn."""
        if self.drawn.redraws and not isinstance(target, Target) and (inside := self._target_inside(target, model)):
            raise _problem(("randomize",), f"can put the target inside of an obstacle: {inside}")

    def _obstacles_of(self, drawn: Drawn) -> Model:
        """The model of the scene's arm among the obstacles of a drawn one."""
        scene, other = self._model.scene, drawn.model.scene.effects.chosen()
        effects = Effects(**{**scene.effects.chosen(), **{name: other[name] for name in self._meets}})
        return self._model.with_scene(scene.model_copy(update={"effects": effects}))

    def _begin_shape(self, row: int, start: Start, stream: np.random.Generator | None, rest: Array) -> Shape:
        """Shape in which a row begins.

        start: of a row that without tension rests at `rest` (n,); tensions drawn from `stream` are halved until the arm holds them, clear
        of obstacles. Raises ConfigurationError where the arm does not hold given ones.
        """
        if start == "rest":
            return self.tension, self.command, rest
        model = self._arms.model_of(row)
        tension = np.array(start) if stream is None else stream.uniform(*self.limits.T)
        least, greatest = model.scene.effects.command_limits(self.limits).T
        for _ in range(HALVINGS):
            q, reason = self._settled(model, tension)
            reason, command = reason or why_inside(model, q), model.command(tension, q)
            if not reason and not ((least <= command) & (command <= greatest)).all():
                reason = f"its actuators would have to be at {shown_numbers(command)} {model.command_unit}, beyond their limits"
            if not reason:
                return tension, command, q
            if stream is None:
                raise _problem(("start",), f"is {shown_numbers(tension)} N, which cannot hold the arm: {reason}")
            tension = 0.5 * (self.tension + tension)
        return self.tension, self.command, rest

    def draw_course(
        self, target: Target, generator: np.random.Generator, setting: Setting, tips: Array | None = None
    ) -> tuple[Course, int]:
        """A course of a target that is drawn, from its bank if it has one, and the control period of it to begin at.

        It keeps clear of the obstacles of the setting, as the arm at rest does where that is so, and its goal is not reached by tips
        (k, 3) [m], but for a warning. Raises ConfigurationError.
        """
        for _ in range(MOST_DRAWS):
            if isinstance(target, Random) and target.bank is not None:
                course, first = self._from_bank(target, target.bank, generator)
            else:
                course, first = target.draw(generator, setting), 0
            inside = "" if isinstance(course, ShapeCourse) else self._target_inside(course, setting.model)
            begins = first if tips is None else self._unreached(course, first, target, tips, generator)
            if not inside and begins is not None:
                return course, begins
        if inside:
            raise _problem(("target",), f"lay inside of an obstacle in {MOST_DRAWS} draws out of {MOST_DRAWS}, at last {inside}")
        text = f"a goal was within the threshold, {1e3 * self.threshold:.3g} mm, of where the tip begins in {MOST_DRAWS} draws"
        warnings.warn(f"{text}: the episode begins solved; choose a smaller threshold, or a larger fraction of tensions", stacklevel=2)
        return course, first

    def _unreached(self, course: Course, first: int, target: Target, tips: Array, generator: np.random.Generator) -> int | None:
        """Control period at which a drawn course begins with a goal that no tip (k, 3) [m] has reached: `first`, or of motions that repeat
        one that is drawn; None: there is none."""
        period = self._options.control_period
        periods: NDArray[np.int64] = first + np.arange(round(target.period / period) if isinstance(target, Random) else 1)
        goals = self._courses.tip_positions(course, period * periods.astype(np.float64)).astype(np.float32)  # as they are observed
        far = periods[np.linalg.norm(goals[:, None] - tips, axis=2).min(axis=1) > self.threshold]
        return None if not far.size else first if far[0] == first else int(generator.choice(far))

    def _from_bank(self, target: Random, size: int, generator: np.random.Generator) -> tuple[Course, int]:
        """A drawn course of the bank, which is made when it is first asked for, and the drawn control period of it to begin at."""
        number = int(generator.integers(size))
        if number not in self._bank:
            self._bank[number] = target.draw(np.random.default_rng(BANK_SEED + number), self._setting)
        return self._bank[number], int(generator.integers(max(round(target.period / self._options.control_period), 1)))

    def _rest_of_scene(self) -> Array:
        q, reason = self._settled(self._model, self.tension)
        if inside := why_inside(self._model, q):
            raise _problem(("scene",), f"has obstacles in the arm's way: {inside}; move it to where the arm is not")
        if reason:
            text = f"leave {shown_numbers(self.tension)} N nearest to zero, which cannot hold the arm: {reason}"
            raise _problem(("tension_limits",), text)
        return q

    def _settled(self, model: Model, tension: Array) -> tuple[Array, str]:
        """Coordinates (n,) at which an arm slowly loaded with tensions (n_a,) [N] comes to rest, and why it does not; "": it does."""
        if model.arm.effects.load:
            q, found = Equilibria(self._arms, model).on_path(tension[None])
            if found[0]:
                return q[0], ""
        rest = static_equilibrium(model, tension, settle=True)
        return rest.q, "" if rest.converged else rest.reason

    def _rest_of(self, model: Model) -> Array:
        """Coordinates (n,) at which an arm rests under the tensions nearest to zero. Raises ConfigurationError where it does not."""
        if model is self._model or not (model.arm.effects.load or self.tension.any()):
            return self.q
        q, reason, inside = self.q, "", why_base_inside(model, self.q)
        if not inside:
            q, reason = self._settled(model, self.tension)
            inside = why_inside(model, q)
        if inside or reason:
            held = f"{shown_numbers(self.tension)} N, nearest to zero, cannot hold: {reason}"
            raise _problem((), f"begin inside of an obstacle: {inside}" if inside else held)
        return q

    def _among(self, setting: Setting, rest: Array) -> Setting:
        """The setting with the space that its model's obstacles leave free; as it is where the arm at rest (n,) is not in that."""
        if not self._meets:
            return setting
        free = ObstacleFreeSpace(self._arms, setting.model)
        return setting._replace(free=free if free.holds(rest[None]).all() else None)

    def _target_inside(self, course: Course, model: Model) -> str:
        """Obstacle standing still that a target's tip is inside of, as the end of a sentence; "": none."""
        if not self._meets:
            return ""
        times = self._options.control_period * np.linspace(0.0, MAX_EPISODE_STEPS, TARGET_CHECKS)
        return why_target_inside(model, self._courses.tip_positions(course, times))


def _problem(key: Key, text: str) -> ConfigurationError:
    return ConfigurationError([Problem(key, text)], "environment")
