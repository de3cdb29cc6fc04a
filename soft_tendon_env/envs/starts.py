"""How the arms of rows begin: at rest, with a material and effects of their own where those are drawn, clear of obstacles."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, why_inside
from soft_tendon_env.envs.drawn_arms import Drawn, DrawnArms
from soft_tendon_env.envs.options import Options, check_start
from soft_tendon_env.envs.targets import Course, Setting, Target, make_setting
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.mechanics.motion.scratch import Motion
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State, checked_motion
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array


class Shape(NamedTuple):
    """An arm at rest."""

    tension: Array  # (n_a,) [N]
    command: Array  # (n_a,) that holds it
    q: Array  # (n,)


class Beginning(NamedTuple):
    """How an episode of a row is to begin, as far as it is known before its arm is drawn."""

    target: Target | Course  # one that is drawn, or the course of one that is not
    tension: tuple[float, ...] | None = None  # (n_a,) [N] that holds the arm; None: that nearest to zero
    state: State | None = None  # in which the row begins, whatever the tension says


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
        q, reason = self._settled(arms.model, tension)
        if reason:
            raise _problem(("scene",), f"has an arm that cannot begin at rest, under {shown_numbers(tension)} N: {reason}")
        self.rest = Shape(tension, arms.model.command(tension, q), q)
        self.setting = self._among(make_setting(arms, self.limits, tension, q))
        usual = Drawn({}, arms.model, q, self.setting)
        self.drawn = DrawnArms(options.randomize, arms.model, arms.size, self._resting, usual)

    def beginning(self, target: Target | Course, tension: tuple[float, ...] | None, state: State | None) -> Beginning:
        """How a row begins. Raises ConfigurationError, TypeError or ValueError where it cannot; what depends on an arm that is drawn is
        found out when it begins."""
        if tension is not None:
            check_start(tension, self._model.scene)
        if not self._is_drawn:
            self._begin_shape(self.drawn.of_row[0], tension)
            if state is not None:
                checked_motion(self._model, state)
        return Beginning(target, tension, state)

    def begin(self, row: int, how: Beginning, generator: np.random.Generator) -> Begun:
        """Give a row its arm, drawn from a generator. Raises ConfigurationError."""
        drawn = self.drawn.draw(row, generator)
        self._arms.set_model(row, drawn.model)
        motion = None if how.state is None else checked_motion(drawn.model, how.state)
        return Begun(self._begin_shape(drawn, how.tension), motion, drawn.setting)

    def _begin_shape(self, drawn: Drawn, start: tuple[float, ...] | None) -> Shape:
        """Shape in which an arm begins. Raises ConfigurationError where it does not hold given tensions (n_a,) [N]."""
        if start is None:
            return self.rest._replace(q=drawn.rest)
        tension, model = np.array(start), drawn.model
        q, reason = self._settled(model, tension)
        command = model.command(tension, q)
        least, greatest = model.scene.effects.command_limits(self.limits).T
        if not reason and not ((least <= command) & (command <= greatest)).all():
            reason = f"its actuators would have to be at {shown_numbers(command)} {model.command_unit}, beyond their limits"
        if reason:
            raise _problem(("start",), f"is {shown_numbers(tension)} N, which cannot hold the arm: {reason}")
        return Shape(tension, command, q)

    def _settled(self, model: Model, tension: Array) -> tuple[Array, str]:
        """Coordinates (n,) at which an arm slowly loaded with tensions (n_a,) [N] comes to rest, and why it does not; "": it does."""
        rest = static_equilibrium(model, tension, settle=True)
        return rest.q, why_inside(model, rest.q) or rest.reason

    def _resting(self, model: Model) -> tuple[Array, Setting]:
        """Coordinates (n,) at which a drawn arm rests under the tensions nearest to zero, and its setting. Raises ConfigurationError."""
        q, reason = self._settled(model, self._tension) if model.arm.effects.load or self._tension.any() else (self.rest.q, "")
        if reason:
            raise _problem((), f"cannot begin at rest, under {shown_numbers(self._tension)} N: {reason}")
        contact = model.scene.effects.contact
        if contact == self._model.scene.effects.contact:
            return q, self.setting
        among = self._model.scene.model_copy(update={"effects": Effects(**{**self._model.scene.effects.chosen(), "contact": contact})})
        ratio = self._arms.ratio_of(model)  # targets are shapes of the scene's arm
        return q, self._among(self.setting._replace(model=self._model.with_scene(among), rest=q / ratio))

    def _among(self, setting: Setting) -> Setting:
        """The setting with the space that its model's obstacles leave free; as it is where the arm at rest is not in that."""
        if setting.model.scene.effects.contact is None:
            return setting
        free = ObstacleFreeSpace(self._arms, setting.model)
        return setting._replace(free=free if free.holds(setting.rest[None]).all() else None)


def _problem(key: Key, text: str) -> ConfigurationError:
    return ConfigurationError([Problem(key, text)], "environment")
