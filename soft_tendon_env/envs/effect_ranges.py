"""Domain randomisation of effects: ranges of their parameters by dotted keys, drawn per episode as the effects of a row.

Effects are drawn from a stream of their own, which the episode's generator seeds but does not feel: whatever else is drawn is the same with
and without them.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.effects import EFFECTS, Effects
from soft_tendon_env.envs.arms import RowEffects, row_effects
from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.model.coordinates import effects_inside
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, override, shown
from soft_tendon_env.tools.types import Array

PLACE = ("randomize", "effects")
FACTOR = "factor"
MOST_CORNERS = 6
"""Entries of a vector up to which all corners of its ranges are tried, else the least and the greatest."""
NUMBER = "a number, or (least, greatest)"
Path = tuple[str, ...]


class Range(NamedTuple):
    """Range of one key: a number, or a vector entry by entry, between `least` and `greatest` (m,); or one factor of the scene's value."""

    key: str
    path: Path
    least: tuple[float, ...]
    greatest: tuple[float, ...]
    of: tuple[float, ...] | None  # the scene's value that a factor multiplies
    is_vector: bool

    def value(self, drawn: Iterable[float]) -> Any:
        """The parameter's value for numbers drawn, one for each entry of `least`."""
        (*numbers,) = drawn
        numbers = numbers if self.of is None else [numbers[0] * own for own in self.of]
        return numbers if self.is_vector else numbers[0]


def checked_ranges(ranges: Mapping[str, Any]) -> dict[str, Any]:
    """The option `randomize.effects` with tables in tables as dotted keys, as far as it can be judged without a scene.

    Raises ConfigurationError.
    """
    found: dict[str, Any] = {}
    for key, value in ranges.items():
        if not isinstance(value, Mapping):
            if not isinstance(value, int | float | list | tuple):
                _fail(key, f"is {shown(value)}: it should be {NUMBER}; of a vector a list with one of these for each entry")
            found[key] = value
        elif [*value] == [FACTOR] and not isinstance(value[FACTOR], Mapping):
            _interval(key, value[FACTOR])
            found[key] = value
        else:
            found |= {f"{key}.{inner}": own for inner, own in checked_ranges(value).items()}
    return found


class EffectRanges:
    """The ranges of `randomize.effects` for a scene, checked against it: every one of their corners is a table that the effects take, and
    changes numbers alone, as rows of one batch have to."""

    def __init__(self, ranges: Mapping[str, Any], model: Model) -> None:
        """Raises ConfigurationError."""
        self._model, self._scene_effects = model, model.scene.effects
        self._tables = {name: effect.model_dump(mode="json") for name, effect in self._scene_effects.chosen().items()}
        with _placed():
            self._ranges = sorted((self._resolved(key, value) for key, value in ranges.items()), key=lambda own: own.path)
            for one, next_one in itertools.pairwise(self._ranges):
                if next_one.path[: len(one.path)] == one.path:
                    _fail(next_one.key, f"draws what {one.key!r} draws already")
            for own, others in itertools.product(self._ranges, ("least", "greatest") if len(self._ranges) > 1 else ("least",)):
                values = {other.path: other.value(getattr(other, others)) for other in self._ranges if other is not own}
                corners = itertools.product(*zip(own.least, own.greatest, strict=True))
                for corner in corners if len(own.least) <= MOST_CORNERS else (own.least, own.greatest):
                    self._checked({**values, own.path: own.value(corner)}, own)

    def __bool__(self) -> bool:
        return bool(self._ranges)

    @property
    def names(self) -> set[str]:
        """The effects of which anything is drawn."""
        return {own.path[0] for own in self._ranges}

    def extremes(self, stiffness: float) -> tuple[RowEffects, RowEffects]:
        """The effects with all numbers at their least, and at their greatest, on a rod so many times as stiff."""
        least, greatest = ({own.path: own.value(getattr(own, end)) for own in self._ranges} for end in ("least", "greatest"))
        return self._checked(least, None, stiffness), self._checked(greatest, None, stiffness)

    def drawn(self, generator: np.random.Generator, stiffness: float) -> RowEffects:
        """The effects of an episode, on a rod so many times as stiff. Raises ConfigurationError where they are none, though all corners of
        the ranges are."""
        values = {own.path: own.value(generator.uniform(own.least, own.greatest).tolist()) for own in self._ranges}
        with _placed():
            return self._checked(values, None, stiffness)

    def values(self, effects: Effects) -> dict[str, Array]:
        """The numbers of all keys in some effects, as drawn: by key, () or (m,), NaN where these effects do not say them."""
        tables = {name: effect.model_dump(mode="json") for name, effect in effects.chosen().items()}
        return {own.key: np.full(np.shape(own.value(own.least)), _at(tables, own.path), dtype=np.float64) for own in self._ranges}

    def _parameter(self, key: str, path: Path) -> Any:
        """The scene's value at a key: a number, a list of numbers or None. Raises ConfigurationError."""
        if path[0] not in self._tables:
            known = "the scene has no effects" if not self._tables else not_among(path[0], self._tables)
            _fail(key, f"is of no effect that the scene has: {known}" if path[0] in EFFECTS else f"is of no effect: {known}")
        node: Any = self._tables
        for depth, part in enumerate(path):
            where = ".".join(path[:depth])
            if isinstance(node, dict) and part not in node:
                _fail(key, f"is no parameter of {where}: {not_among(part, node)}")
            if isinstance(node, list) and not (part.isdecimal() and int(part) < len(node)):
                _fail(key, f"names no entry of {where}: {part!r} should be 0 to {len(node) - 1}")
            if not isinstance(node, dict | list):
                _fail(key, f"is no parameter: {where} is {shown(node)}")
            node = node[part] if isinstance(node, dict) else node[int(part)]
        if node is not None and not all(_is_number(number) for number in (node if isinstance(node, list) else [node])):
            what = f"is a table with {', '.join(node)}" if isinstance(node, dict) else f"is {shown(node)}"
            _fail(key, f"{what}: parameters that are numbers, or vectors of numbers, can be drawn")
        return node

    def _resolved(self, key: str, value: Any) -> Range:
        path: Path = tuple(re.sub(r"\[(\d+)\]", r".\1", key).split("."))
        present = self._parameter(key, path)
        if isinstance(value, Mapping):
            if present is None:
                _fail(key, f"is {shown(value)}: the scene gives no value of which to take a factor")
            least, greatest = _interval(key, value[FACTOR])
            own = present if isinstance(present, list) else [present]
            return Range(key, path, (least,), (greatest,), tuple(map(float, own)), isinstance(present, list))
        is_vector = isinstance(present, list)
        if present is None:  # a number or a vector: what the ranges look like
            is_vector = isinstance(value, list | tuple) and (len(value) != 2 or any(isinstance(part, list | tuple) for part in value))
        if not is_vector:
            least, greatest = _interval(key, value)
            return Range(key, path, (least,), (greatest,), None, False)
        if not isinstance(value, list | tuple) or present is not None and len(value) != len(present):
            _fail(key, f"is {shown(value)}: it should be a list of {len(present)}, each {NUMBER}; or {{'{FACTOR}': {NUMBER}}}")
        ends = [_interval(key, entry) for entry in value]
        return Range(key, path, tuple(least for least, _ in ends), tuple(greatest for _, greatest in ends), None, True)

    def _effects(self, values: Mapping[Path, Any]) -> Effects:
        tables: dict[str, Any] = {**self._scene_effects.chosen(), **{name: deepcopy(self._tables[name]) for name in self.names}}
        override(tables, {".".join(path): value for path, value in values.items()})
        return Effects(**tables)

    def _checked(self, values: Mapping[Path, Any], at: Range | None, stiffness: float = 1.0) -> RowEffects:
        """The effects with these values. Raises ConfigurationError where they refuse them, or differ from the scene's by more than that."""
        own = self._ranges[0] if at is None else at
        try:
            found = row_effects(self._model, self._effects(values), stiffness)
            misfit = misfit_of(found, self._model)
        except ConfigurationError as error:
            inner = "; ".join(str(ConfigurationError([problem], "effects")) for problem in error.problems)
            _fail(own.key, f"can draw {shown(values[own.path])}, which the effect refuses: {inner}")
        if misfit:
            _fail(own.key, f"can draw {shown(values[own.path])}: {misfit}")
        return found


def misfit_of(drawn: RowEffects, model: Model) -> str:
    """Reason why a row of the model's arms cannot have these effects, whose numbers alone may be others; "": it can."""
    scene, effects, table, own = model.scene, drawn.effects, drawn.table, model.arm.effects
    if effects_inside(scene):
        if [*effects.outside().chosen()] != [*scene.effects.outside().chosen()]:
            return "strain.include_loads takes dead loads inside, and then other effects are such than in the scene that it is drawn from"
        if effects.dead_loads().exist and not isinstance(model.arm.strain, Loaded):
            return "strain.include_loads found no loads in the scene to take inside: give it some that are not 0"
    if table.values.size != own.values.size or (table.first_value != own.first_value).any():
        return "the effect then has other places along the arm than in the scene, and rows cannot differ in that: leave it as it is there"
    sizes, present = np.diff(table.first_state), np.diff(own.first_state)
    if ((sizes != present) & (sizes > 0)).any():  # an effect without states leaves those of the scene alone
        return f"the effects then have {sizes.sum()} internal states, and {present.sum()} in the scene: give the scene a value above 0"
    return ""


def _at(tables: Any, path: Path) -> Any:
    """The value at a path; None where there is none."""
    for part in path:
        table = dict(enumerate(tables)) if isinstance(tables, list) else tables or {}
        tables = table.get(int(part) if isinstance(tables, list) else part)
    return tables


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _interval(key: str, value: Any) -> tuple[float, float]:
    """Least and greatest of a number or a pair. Raises ConfigurationError."""
    pair = (value, value) if _is_number(value) else value
    if not (isinstance(pair, list | tuple) and len(pair) == 2 and all(_is_number(end) and np.isfinite(end) for end in pair)):
        _fail(key, f"has {shown(value)}: it should be {NUMBER}")
    if pair[0] > pair[1]:
        _fail(key, f"has {shown(value)}: the least should come first")
    return float(pair[0]), float(pair[1])


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)])


@contextmanager
def _placed() -> Iterator[None]:
    """Context that prefixes configuration errors with `randomize.effects`."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError([Problem((*PLACE, *key), text) for key, text in error.problems], "environment") from None
