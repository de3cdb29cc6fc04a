"""How the arms of rows begin: at rest, with a material and effects of their own where those are drawn, clear of obstacles."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, why_inside
from soft_tendon_env.envs.drawn_arms import DrawnArms
from soft_tendon_env.envs.options import Options, Start, check_start
from soft_tendon_env.envs.randomization import own_stream
from soft_tendon_env.envs.targets import Course, Setting, Target, make_setting
from soft_tendon_env.envs.targets.statics import HALVINGS, nearest_to_zero
from soft_tendon_env.mechanics.motion.scratch import Motion
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State, checked_motion
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array

START = 1
"""Purpose of the random stream from which tensions to begin under are drawn."""


class Shape(NamedTuple):
    """An arm at rest."""

    tension: Array  # (n_a,) [N]
    command: Array  # (n_a,) that holds it
    q: Array  # (n,)


class Beginning(NamedTuple):
    """How an episode of a row is to begin, as far as it is known before its arm is drawn."""

    start: Start
    target: Target | Course  # one that is drawn, or the course of one that is not
    state: State | None = None  # in which the row begins, whatever `start` says
    shape: Shape | None = None  # under `start`


class Begun(NamedTuple):
    """The arm of a row in which an episode begins."""

    shape: Shape
    motion: tuple[Motion, float] | None  # in place of the shape, and the step to try next
    setting: Setting  # among which targets are drawn for it


class Starts:
    """Beginnings of rows of arms.

    `rest` holds the scene's arm under the tensions nearest to zero; `drawn` are the arms that are drawn; `setting` is that of the scene's
    arm.
    """

    def __init__(self, options: Options, arms: Arms) -> None:
        """Raises ConfigurationError where the arm, or one that can be drawn, does not rest, or begins inside of an obstacle."""
        self._arms, self._model, self._is_drawn = arms, arms.model, options.randomize.of_arm
        self.limits = arms.model.discretisation.tension_limits.copy()
        self._tension = tension = nearest_to_zero(self.limits)
        q, inside, reason = self._settled(arms.model, tension)
        if inside:
            raise _problem(("scene",), f"has obstacles in the arm's way: {inside}; move it to where the arm is not")
        if reason:
            raise _problem(("tension_limits",), f"leave {shown_numbers(tension)} N nearest to zero, which cannot hold the arm: {reason}")
        self.rest = Shape(tension, arms.model.command(tension, q), q)
        self.drawn = DrawnArms(options.randomize, arms.model, arms.size, self._rest_of)
        self.setting = self._among(make_setting(arms, self.limits, tension, q))

    def beginning(self, start: Start, target: Target | Course, state: State | None = None) -> Beginning:
        """How a row begins. Raises ConfigurationError, TypeError or ValueError where it cannot; what depends on an arm that is drawn is
        found out when it begins."""
        check_start(start, self._model.scene)
        if self._is_drawn:
            return Beginning(start, target, state)
        if state is not None:
            checked_motion(self._model, state)
        shape = self._begin_shape(self._model, start, None, self.rest.q) if start != "random" else None
        return Beginning(start, target, state, shape)

    def begin(self, row: int, how: Beginning, generator: np.random.Generator, inside: Callable[[Course, Model], str]) -> Begun:
        """Give a row its arm, drawn from a generator. Raises ConfigurationError.

        inside: the obstacle of a model that a target is inside of, as the end of a sentence; obstacles keep clear of those not drawn.
        """

        def check(model: Model) -> None:
            if self.drawn.redraws and not isinstance(how.target, Target) and (found := inside(how.target, model)):
                raise _problem(("randomize",), f"can put the target inside of an obstacle: {found}")

        start = own_stream(generator, START) if how.start == "random" else None
        drawn, setting = self.drawn.draw(row, generator, check), self.setting
        self._arms.set_model(row, drawn.model)
        shape = how.shape or self._begin_shape(drawn.model, how.start, start, drawn.rest)
        if self.drawn.redraws:  # targets keep clear of the obstacles that were drawn
            contact = drawn.model.scene.effects.contact
            among = self._model.scene.model_copy(update={"effects": Effects(**{**self._model.scene.effects.chosen(), "contact": contact})})
            setting = self._among(setting._replace(model=self._model.with_scene(among), rest=drawn.rest / self._arms.ratio[row]))
        return Begun(shape, None if how.state is None else checked_motion(drawn.model, how.state), setting)

    def _begin_shape(self, model: Model, start: Start, stream: np.random.Generator | None, rest: Array) -> Shape:
        """Shape in which a row begins that rests at `rest` (n,).

        Tensions that are drawn from `stream` are halved until the arm holds them, clear of obstacles. Raises ConfigurationError where it
        does not hold given ones.
        """
        if start == "rest":
            return self.rest._replace(q=rest)
        tension: Array = np.array(start) if stream is None else np.asarray(stream.uniform(*self.limits.T))
        least, greatest = model.scene.effects.command_limits(self.limits).T
        for _ in range(HALVINGS):
            q, inside, reason = self._settled(model, tension)
            command = model.command(tension, q)
            if not (inside or reason) and not ((least <= command) & (command <= greatest)).all():
                reason = f"its actuators would have to be at {shown_numbers(command)} {model.command_unit}, beyond their limits"
            if not (inside or reason):
                return Shape(tension, command, q)
            if stream is None:
                raise _problem(("start",), f"is {shown_numbers(tension)} N, which cannot hold the arm: {inside or reason}")
            tension = 0.5 * (self._tension + tension)
        return self.rest._replace(q=rest)

    def _settled(self, model: Model, tension: Array) -> tuple[Array, str, str]:
        """Coordinates (n,) at which an arm slowly loaded with tensions (n_a,) [N] comes to rest; the obstacle that it is inside of there,
        and why it does not rest, as ends of sentences: "" where it is so."""
        rest = static_equilibrium(model, tension, settle=True)
        return rest.q, why_inside(model, rest.q), rest.reason

    def _rest_of(self, model: Model) -> Array:
        """Coordinates (n,) at which an arm rests under the tensions nearest to zero. Raises ConfigurationError where it does not."""
        if model is self._model or not (model.arm.effects.load or self._tension.any()):
            return self.rest.q
        q, inside, reason = self._settled(model, self._tension)
        if not (inside or reason):
            return q
        held = f"{shown_numbers(self._tension)} N, nearest to zero, cannot hold: {reason}"
        raise _problem((), f"begin inside of an obstacle: {inside}" if inside else held)

    def _among(self, setting: Setting) -> Setting:
        """The setting with the space that its model's obstacles leave free; as it is where the arm at rest is not in that."""
        if setting.model.scene.effects.contact is None:
            return setting
        free = ObstacleFreeSpace(self._arms, setting.model)
        return setting._replace(free=free if free.holds(setting.rest[None]).all() else None)


def _problem(key: Key, text: str) -> ConfigurationError:
    return ConfigurationError([Problem(key, text)], "environment")
