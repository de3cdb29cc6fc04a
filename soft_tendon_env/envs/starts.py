"""How the arms of rows begin: at rest, with numbers of their own where those are drawn, clear of obstacles.

Making an arm takes longer than a reset. So an environment has BANK arms, which follow from its scene and its ranges alone. An episode takes
the one whose number its generator draws.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.effects import Effects
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, why_inside
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.targets import Setting, make_setting
from soft_tendon_env.envs.targets.statics import nearest_to_zero
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array

BANK = 64
"""Arms of an environment that draws numbers of its scene."""
MOST_DRAWS = 20
"""How often an arm of the bank is drawn that begins inside of drawn obstacles, before that is an error."""
DRAWS = 4
"""Numbers that an episode takes from its generator before anything else, of which the first chooses the arm."""


class Drawn(NamedTuple):
    """Arm of an episode."""

    numbers: Mapping[str, float]  # of the scene, by dotted keys
    model: Model
    rest: Array  # (n,) coordinates at which it rests
    setting: Setting  # among which targets are drawn for it


class DrawnArms:
    """The bank of an environment; `of_row` are the arms of the present episodes.

    Arms that need no search for where they rest are made at once, others when they are first drawn.
    """

    def __init__(
        self, randomize: Randomization, model: Model, rows: int, settle: Callable[[Model], tuple[Array, Setting]], usual: Drawn
    ) -> None:
        """settle: where an arm rests, and among what, or ConfigurationError; usual: the scene's own arm.

        Raises ConfigurationError where an end of a range cannot be, or the softest and heaviest arm does not rest.
        """
        self._model, self._settle, self._ranges = model, settle, randomize.ranges(model.scene)
        for own in self._ranges:
            for end in {own.least, own.greatest}:
                self._model_with(own.changes(end), own.name)
        self._redraws = any(key.startswith("effects.contact.") for own in self._ranges for key in own.keys)
        self._size = BANK if any(own.least < own.greatest for own in self._ranges) else 1
        self._bank: dict[int, Drawn] = {} if self._ranges else {0: usual}
        if self._ranges and not self._redraws:
            soft = np.array([own.name.endswith(".young_modulus") for own in self._ranges])
            for shares in (np.zeros(soft.size), np.ones(soft.size), 1.0 - soft):
                self._made(shares)
        for number in range(0 if model.arm.effects.load or usual.rest.any() else self._size):
            self._arm(number)
        self.of_row = [usual] * rows

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bank": {} if self._ranges else self._bank}  # whose arms can be made again

    def draw(self, row: int, generator: np.random.Generator) -> Drawn:
        """The arm of an episode of a row."""
        drawn = self.of_row[row] = self._arm(int(generator.random(DRAWS)[0] * self._size))
        return drawn

    def _arm(self, number: int) -> Drawn:
        """The arm of that number. Raises ConfigurationError."""
        if number not in self._bank:
            stream = np.random.default_rng([BANK, number])
            for last in range(MOST_DRAWS if self._redraws else 1, 0, -1):
                try:
                    self._bank[number] = self._made(stream.random(len(self._ranges)))
                    break
                except ConfigurationError:
                    if last == 1:
                        raise
        return self._bank[number]

    def _made(self, shares: Array) -> Drawn:
        """The arm with numbers so far, 0 to 1, between the ends of every range. Raises ConfigurationError."""
        changes: dict[str, float] = {}
        for own, share in zip(self._ranges, shares.tolist(), strict=True):
            changes |= own.changes(own.least + (own.greatest - own.least) * share)
        model = self._model_with(changes)
        try:
            return Drawn(changes, model, *self._settle(model))
        except ConfigurationError as error:
            raise _problem(("randomize",), f"can make arms that {error.problems[0].text}: {_listed(changes)}") from None

    def _model_with(self, changes: Mapping[str, float], *key: str) -> Model:
        """The model with these numbers of the scene, which the range of that key draws. Raises ConfigurationError."""
        try:
            model = self._model.with_scene(scene_with_numbers(self._model.scene, changes))
            model.metric  # noqa: B018 # there is one where the arm holds the loads inside of its strain
        except (ConfigurationError, StrainLimitError) as error:
            why = f"which the scene refuses: {'; '.join(str(error).splitlines())}"
            raise _problem(("randomize", *key), f"can draw {_listed(changes)}, {why}") from None
        if misfit := self._model.misfit(model):
            why = f"which changes {misfit}: rows can differ in numbers alone"
            raise _problem(("randomize", *key), f"can draw {_listed(changes)}, {why}")
        return model


def _listed(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{key} {value:.4g}" for key, value in numbers.items())


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
