"""How arms of rows begin: at rest, clear of obstacles, with numbers of their own if drawn.

Making an arm takes longer than a reset. So an environment has BANK arms, which follow from its
scene and its ranges alone. An episode takes the one whose number its generator draws.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.contacts import ObstacleFreeSpace, why_inside
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.targets import make_setting
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.parameters import scene_with_numbers
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Key, Problem
from soft_tendon_env.tools.types import Array

BANK = 64
"""Number of arms of an environment that draws numbers of its scene."""

BANK_WITH_OMISSIONS = 4 * BANK
"""Number of arms where arms may lack some of the drawn numbers: there are more combinations."""

REDRAWS = 200
"""How often an arm of the bank is drawn again that obstacles keep from beginning at rest: where one
draw in 20 can begin, one arm in 30,000 is left without."""

FIRST_REDRAWS = 20
"""How often the first one is: few, since a draw that cannot begin may take seconds, and ranges of
which almost none can are to be told of soon."""

DRAWS = 4
"""Numbers that an episode takes from its generator before anything else; the first chooses the
arm."""

SOFTNESS = re.compile(r"\.(young_modulus|bending)\b")
"""Names of drawn numbers by which an arm is soft where they are small."""


class Drawn(NamedTuple):
    """Arm of an episode."""

    model: Model
    rest: Array  # (n,) coordinates at which it rests
    numbers: Mapping[str, float] = {}  # drawn ones of its scene, by dotted keys


class Starts:
    """Beginnings of rows of arms.

    Arms that need no search for where they rest are made at once, others when they are first drawn.

    Attributes:
        q: coordinates (n,) at which the scene's arm rests.
        tension: (n_a,) [N] nearest to zero within `limits`, under which it rests.
        limits: of tensions (n_a, 2) [N].
        command: (n_a,) that holds the tension.
        setting: of the arm's targets.
        numbers: drawn ones of the scene, by row.
    """

    def __init__(self, options: Options, arms: Arms) -> None:
        """Find where arms rest.

        Args:
            options: of the environment.
            arms: rows of the scene's arm.

        Raises:
            ConfigurationError: where the arm, or one at an end of the ranges, cannot be, does not
                rest, or begins in an obstacle.
        """
        self._arms = arms
        self._model = arms.model
        model = arms.model
        effects = model.scene.effects
        self.limits = model.discretisation.tension_limits.copy()
        lower = self.limits[:, 0]
        upper = self.limits[:, 1]
        self.tension = np.clip(0.0, lower, upper)
        self.q, reason = self._settle(model)
        if reason:
            tension = shown_numbers(self.tension)
            text = f"has an arm that cannot begin at rest, under {tension} N: {reason}"
            raise _problem(("scene",), text)
        self.command = model.command(self.tension, self.q)
        self.setting = make_setting(arms, self.limits, self.tension, self.q)
        if effects.contact is not None:
            free = ObstacleFreeSpace(arms)
            is_clear = free.holds(self.q[None])
            rests_clear = is_clear.all()
            if rests_clear:  # else the arm rests against an obstacle
                self.setting = self.setting._replace(model=free.model, free=free)
        self._usual = Drawn(model, self.q)
        self._ranges = options.randomize.ranges(model.scene)
        self._omits = options.randomize.omits
        omissions = [options.randomize.omission(drawn.name) for drawn in self._ranges]
        self._omissions = np.array(omissions)
        self._size = self._bank_size()
        self._is_among_obstacles = effects.contact is not None
        self._bank = dict[int, Drawn]()
        self.numbers = dict[int, Mapping[str, float]]()
        self._make_bank()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_bank": {}}  # whose arms can be made again

    def _make_bank(self) -> None:
        """Look at extreme arms, and make the arms that need no search.

        Extreme are those at an end of every range, and the softest and heaviest one. Among
        obstacles they say nothing of the rest: there one arm shows that draws can begin.

        Raises ConfigurationError.
        """
        if not self._ranges:
            return
        for drawn in self._ranges:
            ends = [drawn.least]
            if drawn.greatest > drawn.least:
                ends.append(drawn.greatest)
            for end in ends:
                self._model_with(drawn.changes(end), drawn.name)
        count = len(self._ranges)
        least = np.zeros(count)
        greatest = np.ones(count)
        for shares in (least, greatest, self._softest_and_heaviest()):
            changes = self._numbers(shares)
            model = self._model_with(changes)
            if not self._is_among_obstacles:
                _, reason = self._at_rest(model, changes)
                if reason:
                    raise _no_rest(1, self.tension, reason, changes)
        if self._is_among_obstacles:
            self._arm(0, FIRST_REDRAWS)
        needs_search = self._model.arm.effects.load or self.q.any()
        if not needs_search:
            for number in range(self._size):
                self._arm(number)

    def _softest_and_heaviest(self) -> Array:
        """Shares (ranges,) of every range, 0 to 1, with which an arm yields most to its weight."""
        shares = np.ones(len(self._ranges))
        for i, drawn in enumerate(self._ranges):
            if SOFTNESS.search(drawn.name) is not None:
                shares[i] = 0.0
        return shares

    def _bank_size(self) -> int:
        """Number of different arms that episodes may have."""
        if self._omits:
            return BANK_WITH_OMISSIONS
        varies = any(drawn.least < drawn.greatest for drawn in self._ranges)
        if varies:
            return BANK
        return 1

    def begin(self, row: int, generator: np.random.Generator) -> Drawn:
        """Give a row its arm.

        Args:
            row: that begins.
            generator: of the episode, from which the arm is drawn.

        Returns:
            The arm.

        Raises:
            ConfigurationError: where it cannot be.
        """
        first, *_ = generator.random(DRAWS)
        place = int(first * self._size)
        drawn = self._arm(place)
        self._arms.set_model(row, drawn.model)
        self.numbers[row] = drawn.numbers
        return drawn

    def shares(self) -> Array:
        """Drawn numbers of the arms (rows, ranges) as shares of their ranges, 0 to 1."""
        varying = [drawn for drawn in self._ranges if drawn.least < drawn.greatest]
        shares_of_rows = []
        for row in range(self._arms.size):
            numbers = self.numbers.get(row, {})
            shares = [drawn.share(numbers) for drawn in varying]
            shares_of_rows.append(shares)
        return np.array(shares_of_rows)

    def _arm(self, number: int, redraws: int = REDRAWS) -> Drawn:
        """The arm of that number, drawn again at most so often.

        Raises ConfigurationError.
        """
        if not self._ranges:
            return self._usual
        if number not in self._bank:
            generator = np.random.default_rng([BANK, number])
            self._bank[number] = self._draw_arm(generator, redraws)
        return self._bank[number]

    def _draw_arm(self, random: np.random.Generator, redraws: int) -> Drawn:
        """An arm with random numbers, drawn again while obstacles keep it from beginning at rest.

        Raises ConfigurationError where the last draw cannot begin either.
        """
        draws = 1
        if self._is_among_obstacles:
            draws += redraws
        for _ in range(draws):
            shares = random.random(len(self._ranges))
            omitted = None
            if self._omits:
                omitted = random.random(shares.size) < self._omissions
            changes = self._numbers(shares, omitted)
            model = self._model_with(changes)
            arm, reason = self._at_rest(model, changes)
            if not reason:
                return arm
        raise _no_rest(draws, self.tension, reason, changes)

    def _numbers(self, shares: Array, omitted: NDArray[np.bool_] | None = None) -> dict[str, float]:
        """Numbers of the scene so far, 0 to 1, between the ends of every range but omitted ones."""
        numbers: dict[str, float] = {}
        for i, drawn in enumerate(self._ranges):
            if omitted is None or not omitted[i]:
                width = drawn.greatest - drawn.least
                number = drawn.least + width * float(shares[i])
                numbers |= drawn.changes(number)
        return numbers

    def _at_rest(self, model: Model, numbers: Mapping[str, float]) -> tuple[Drawn, str]:
        """The arm of a model with these numbers, at rest; also why it cannot begin, "": it can."""
        is_loaded = model.arm.effects.load or self.tension.any()
        # obstacles, or a base that is drawn, may be where the arm rests
        rests_as_usual = not is_loaded and not self._is_among_obstacles
        if rests_as_usual:
            return Drawn(model, self.q, numbers), ""
        q, reason = self._settle(model)
        return Drawn(model, q, numbers), reason

    def _model_with(self, changes: Mapping[str, float], *key: str) -> Model:
        """The model with these numbers of the scene, which the range of that key draws.

        Raises ConfigurationError.
        """
        try:
            scene = scene_with_numbers(self._model.scene, changes)
            model = self._model.with_scene(scene)
            # there is one where the arm holds the loads inside of its strain
            model.metric  # noqa: B018
            misfit = self._model.misfit(model)
        except (ConfigurationError, StrainLimitError) as error:
            refusal = "; ".join(str(error).splitlines())
            text = f"can draw {_listed(changes)}, which the scene refuses: {refusal}"
            raise _problem(("randomize", *key), text) from None
        if misfit:
            why = f"which changes {misfit}: rows can differ in numbers alone"
            message = f"can draw {_listed(changes)}, {why}"
            raise _problem(("randomize", *key), message)
        return model

    def _settle(self, model: Model) -> tuple[Array, str]:
        """Coordinates (n,) at which an arm under the tensions nearest to zero comes to rest.

        Also why it does not; "": it does.
        """
        rest = static_equilibrium(model, self.tension, settle=True)
        why = why_inside(model, rest.q)
        return rest.q, why or rest.reason


def _listed(numbers: Mapping[str, float]) -> str:
    """Numbers by their keys, as messages list them."""
    parts = [f"{key} {value:.4g}" for key, value in numbers.items()]
    return ", ".join(parts)


def _no_rest(
    draws: int, tension: Array, reason: str, numbers: Mapping[str, float]
) -> ConfigurationError:
    """Error of draws none of which can begin, with the numbers of the last and why it cannot."""
    kind = "can make arms that"
    if draws > 1:
        kind = f"makes arms of which {draws} in a row"
    cannot = f"cannot begin at rest, under {shown_numbers(tension)} N: {reason}"
    return _problem(("randomize",), f"{kind} {cannot}: {_listed(numbers)}")


def _problem(key: Key, text: str) -> ConfigurationError:
    return ConfigurationError([Problem(key, text)], "environment")
