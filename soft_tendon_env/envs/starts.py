"""How the arms of rows begin: at rest, with a material and effects of their own where those are drawn, clear of obstacles."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, why_inside
from soft_tendon_env.envs.drawn_arms import Drawn, DrawnArms
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.targets import Setting, make_setting
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array


class Rest(NamedTuple):
    """The scene's arm at rest under the tensions nearest to zero."""

    tension: Array  # (n_a,) [N]
    command: Array  # (n_a,) that holds it
    q: Array  # (n,)


class Starts:
    """Beginnings of rows of arms.

    `rest` is that of the scene's arm; `drawn` are the arms that are drawn; `setting` is that of the scene's arm.
    """

    def __init__(self, options: Options, arms: Arms) -> None:
        """Raises ConfigurationError where the arm, or one that can be drawn, does not rest, or begins inside of an obstacle."""
        self._arms, self._model = arms, arms.model
        self.limits = arms.model.discretisation.tension_limits.copy()
        self._tension = tension = nearest_to_zero(self.limits)
        q, reason = self._settled(arms.model)
        if reason:
            raise _problem(("scene",), f"has an arm that cannot begin at rest, under {shown_numbers(tension)} N: {reason}")
        self.rest = Rest(tension, arms.model.command(tension, q), q)
        self.setting = self._among(make_setting(arms, self.limits, tension, q))
        usual = Drawn({}, arms.model, q, self.setting)
        self.drawn = DrawnArms(options.randomize, arms.model, arms.size, self._resting, usual)

    def begin(self, row: int, generator: np.random.Generator) -> Drawn:
        """Give a row its arm, drawn from a generator. Raises ConfigurationError."""
        drawn = self.drawn.draw(row, generator)
        self._arms.set_model(row, drawn.model)
        return drawn

    def _settled(self, model: Model) -> tuple[Array, str]:
        """Coordinates (n,) at which an arm under the tensions nearest to zero comes to rest, and why it does not; "": it does."""
        rest = static_equilibrium(model, self._tension, settle=True)
        return rest.q, why_inside(model, rest.q) or rest.reason

    def _resting(self, model: Model) -> tuple[Array, Setting]:
        """Coordinates (n,) at which a drawn arm rests under the tensions nearest to zero, and its setting. Raises ConfigurationError."""
        q, reason = self._settled(model) if model.arm.effects.load or self._tension.any() else (self.rest.q, "")
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
