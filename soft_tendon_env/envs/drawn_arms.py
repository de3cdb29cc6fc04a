"""Arms that are drawn for episodes: the scene's with other numbers, each made by the ordinary maker on the scene's grid.

An episode that begins with a seed draws the numbers of its arm from it. Those that follow without a seed share a bank, since making an arm
takes longer than a reset: one in FRESH draws numbers of its own, the others take one of BANK arms, which are the same wherever the ranges
are. What an episode draws depends on the seed and on how many episodes came after it alone.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.envs.randomization import SHORT, Randomization, own_stream
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

BANK, FRESH = 64, 32
RECENT = 128
"""Arms besides that are kept, the latest: the same seeds come again, as those of a validation."""
MOST_DRAWS = 200
"""How often an arm is drawn that begins inside of drawn obstacles, or whose target lies inside, before that is an error."""
FIRST = [key for key, _ in SHORT.values()]
"""Keys whose numbers an episode's generator itself draws; others come from a stream of their own."""


class Drawn(NamedTuple):
    """Arm of an episode."""

    numbers: Mapping[str, float]  # of the scene, by dotted keys
    model: Model
    rest: Array  # (n,) coordinates at which it rests


class DrawnArms:
    """Drawn arms of rows of episodes.

    `of_row` are those of the present episodes; `redraws`: whether obstacles are drawn, and drawn again where the arm would begin inside of
    one.
    """

    def __init__(self, randomize: Randomization, model: Model, rows: int, rest: Callable[[Model], Array]) -> None:
        """rest: coordinates (n,) at which an arm rests, or ConfigurationError.

        Raises ConfigurationError where an end of a range cannot be, or the softest and heaviest arm does not rest.
        """
        self._model, self._rest, self._ranges = model, rest, randomize.ranges(model.scene)
        self._has_others = any(own.name not in FIRST for own in self._ranges)
        self.redraws = any(key.startswith("effects.contact.") for own in self._ranges for key in own.keys)
        self._generators: list[Any] = [None] * rows
        self._made: dict[int | bytes, Drawn] = {}
        self.of_row = [Drawn({}, model, rest(model))] * rows
        self._check_ends()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_made": {}}

    def _check_ends(self) -> None:
        for own in self._ranges:
            for end in {own.least, own.greatest}:
                self._model_with(own.changes(end), own.name)
        soft = np.array([own.name.endswith(".young_modulus") for own in self._ranges])
        for shares in (np.zeros(soft.size), np.ones(soft.size), 1.0 - soft) if self._ranges and not self.redraws else ():
            self._make(shares)

    def draw(self, row: int, generator: np.random.Generator, check: Callable[[Model], None]) -> Drawn:
        """The arm of an episode of a row.

        check: raises ConfigurationError where an arm will not do; another one is then drawn, if obstacles are. Raises ConfigurationError.
        """
        stream = own_stream(generator) if self._has_others else generator
        first = generator.random(len(FIRST)).tolist()  # always, so that what is drawn besides stays the same
        if not self._ranges:
            return self.of_row[row]

        def shares() -> bytes:
            of_key = dict(zip(FIRST, first, strict=True))
            return np.array([of_key[own.name] if own.name in of_key else stream.random() for own in self._ranges]).tobytes()

        follows, self._generators[row] = self._generators[row] is generator, generator
        turn, number = divmod(int(first[0] * 2.0**53) % (FRESH * BANK), BANK)  # of its last bits, which change no number
        key = number if follows and turn else shares()
        for last in range(MOST_DRAWS if self.redraws else 1, 0, -1):
            try:
                drawn = self._arm(key)
                check(drawn.model)
                break
            except ConfigurationError:
                if last == 1:
                    raise
                key = shares()
        self.of_row[row] = drawn
        return drawn

    def _arm(self, key: int | bytes) -> Drawn:
        """The arm of that number in the bank, or the one with numbers so far between the ends of the ranges, see `_make`."""
        if key not in self._made:
            recent = [own for own in self._made if isinstance(own, bytes)]
            if len(recent) == RECENT:
                del self._made[recent[0]]
            shares = np.random.default_rng([BANK, key]).random(len(self._ranges)) if isinstance(key, int) else np.frombuffer(key)
            self._made[key] = self._make(shares)
        return self._made[key]

    def _make(self, shares: Array) -> Drawn:
        """The arm with numbers so far, 0 to 1, between the ends of every range. Raises ConfigurationError."""
        changes: dict[str, float] = {}
        for own, share in zip(self._ranges, shares.tolist(), strict=True):
            changes |= own.changes(own.least + (own.greatest - own.least) * share)
        model = self._model_with(changes)
        try:
            return Drawn(changes, model, self._rest(model))
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
