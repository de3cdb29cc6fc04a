"""Arms that are drawn for episodes: a bank of the scene's with other numbers, each made by the ordinary maker on the scene's grid.

Making an arm takes longer than a reset. So an environment has BANK arms, which follow from its scene and its ranges alone. An episode takes
the one whose number its generator draws.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.envs.targets import Setting
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
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
            _fail(f"can make arms that {error.problems[0].text}: {_listed(changes)}")

    def _model_with(self, changes: Mapping[str, float], *key: str) -> Model:
        """The model with these numbers of the scene, which the range of that key draws. Raises ConfigurationError."""
        try:
            model = self._model.with_scene(scene_with_numbers(self._model.scene, changes))
            model.metric  # noqa: B018 # there is one where the arm holds the loads inside of its strain
        except (ConfigurationError, StrainLimitError) as error:
            _fail(f"can draw {_listed(changes)}, which the scene refuses: {'; '.join(str(error).splitlines())}", *key)
        if misfit := self._model.misfit(model):
            _fail(f"can draw {_listed(changes)}, which changes {misfit}: rows can differ in numbers alone", *key)
        return model


def _listed(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{key} {value:.4g}" for key, value in numbers.items())


def _fail(text: str, *key: str) -> NoReturn:
    raise ConfigurationError([Problem(("randomize", *key), text)], "environment")
