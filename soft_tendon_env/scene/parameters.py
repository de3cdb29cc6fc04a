"""Parameters of a scene: its numbers by dotted keys with wildcards, and ranges of them as domain
randomisation draws them."""

import contextlib
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, shown

TABLES = (
    "segments",
    "tendons",
    "base",
    "effects",
)  # with the numbers of the arm; the others say how it is computed
FIXED = {  # patterns of keys whose numbers are no parameters, and why
    r"segments\.\d+\.length|tendons\.\d+\.(start|end)": (
        "it decides where the quadrature points lie; build a model for each value"
    ),
    r"base\.quaternion\.\d": (
        "its four numbers are one rotation: base.rotation, of three numbers [deg], turns the base"
        " on top of it"
    ),
    r"tendons\.\d+\.tension_limits\.\d": (
        "it bounds the commands, and nothing changes with it in between"
    ),
}
KINDS = ("factor", "offset")  # of ranges, relative to the scene's number
NUMBER = "a number, or (least, greatest): the least should come first"


class Parameter(NamedTuple):
    """Named number of a scene, or several that change together: one value where all are alike,
    otherwise a common factor."""

    name: str  # the key as it was given, "segments.*.young_modulus"
    keys: tuple[str, ...]  # those that it stands for
    values: tuple[float, ...]  # in the scene, one per key
    # largest magnitude of these and of the numbers beside them in their arrays, as of the other
    # components of a vector
    size: float

    @property
    def is_factor(self) -> bool:
        """Whether the parameter is a factor of values that differ."""
        return len(set(self.values)) > 1

    @property
    def value(self) -> float:
        """The value in the scene, in the unit of the keys; 1 for a factor."""
        return 1.0 if self.is_factor else self.values[0]

    def changes(self, value: float) -> dict[str, float]:
        """Dotted keys and values that give the parameter a value, for `Scene.replace`."""
        return {
            key: value * number if self.is_factor else value
            for key, number in zip(self.keys, self.values, strict=True)
        }


class Range(NamedTuple):
    """Range of numbers that change together: of their value, or of a factor or an offset of what
    the scene says."""

    name: str
    keys: tuple[str, ...]
    values: tuple[float, ...]  # in the scene, one per key
    kind: str  # "value", or one of KINDS
    least: float
    greatest: float

    def changes(self, number: float) -> dict[str, float]:
        """Dotted keys and values for a number of the range, for `Scene.replace`."""
        factor, offset = {"value": (0.0, number), "factor": (number, 0.0), "offset": (1.0, number)}[
            self.kind
        ]
        return {
            key: factor * value + offset for key, value in zip(self.keys, self.values, strict=True)
        }

    def share(self, numbers: Mapping[str, float]) -> float:
        """How far from the least to the greatest number of the range a scene is, 0 to 1, with these
        numbers by dotted keys."""
        key = self.keys[0]
        least, greatest = self.changes(self.least)[key], self.changes(self.greatest)[key]
        return (numbers.get(key, self.values[0]) - least) / (greatest - least)


def scene_parameters(scene: Scene, names: Iterable[str]) -> tuple[Parameter, ...]:
    """Parameters of a scene by dotted keys, in which `*` stands for every entry, as
    `"segments.*.young_modulus"`, and `0,2` for those that it lists.

    Any number of `[[segments]]`, `[[tendons]]`, `[base]` and `[effects]` can be one, but for
    lengths of segments, ends and limits of tendons, and the quaternion. An effect that does nothing
    unless it is told to, as a tip load, need not be in the scene. Raises ConfigurationError for
    keys of anything else, with those that there are.
    """
    entries = _entries(scene)
    return tuple(_parameter(name, entries) for name in names)


def scene_with_numbers(scene: Scene, changes: Mapping[str, float]) -> Scene:
    """The scene with other numbers by dotted keys, also of effects that it lacks, see
    `scene_parameters`. Raises ConfigurationError."""
    named = {
        key.split(".")[1] for key in changes if key.startswith("effects.")
    } - scene.effects.chosen().keys()
    return scene.replace(
        {**{f"effects.{name}": table for name, table in _idle_effects(named).items()}, **changes}
    )


def dotted_ranges(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A table of ranges with tables in tables as dotted keys."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        nested = isinstance(value, Mapping) and not _is_relative(value)
        found |= dotted_ranges(value, f"{prefix}{name}.") if nested else {prefix + name: value}
    return found


def ranges_of(scene: Scene, wanted: Mapping[str, Any]) -> tuple[Range, ...]:
    """Ranges by dotted keys of a scene, of a vector a list with one for each entry.

    Raises ConfigurationError for keys that are no numbers of the scene, for what is no range, and
    for a number that two of them draw.
    """
    entries, found, drawn = _entries(scene), list[Range](), dict[str, str]()
    for name, value in wanted.items():
        places = sorted({key.rpartition(".")[2] for key in _matching(f"{name}.*", entries)})
        parts, is_vector = [(name, value)], bool(places) and places[-1].isdecimal()
        if is_vector and _is_relative(value):
            parts = [(f"{name}.*", value)]
        elif is_vector:
            if not isinstance(value, list) or len(value) != len(places):
                _fail(
                    name,
                    f"is {shown(value)}: it should be a list of {len(places)}, each {NUMBER}; or"
                    f" {{'{KINDS[0]}': {NUMBER}}}",
                )
            parts = [(f"{name}.{i}", entry) for i, entry in enumerate(value)]
        for key, given in parts:
            _, keys, values, _ = _parameter(key, entries)
            ((kind, interval),) = given.items() if _is_relative(given) else (("value", given),)
            found.append(Range(key, keys, values, kind, *_interval(key, interval)))
            if twice := next((drawn[number] for number in keys if number in drawn), None):
                _fail(key, f"draws what {twice!r} draws already")
            drawn |= dict.fromkeys(keys, key)
    return tuple(found)


def _entries(scene: Scene) -> dict[str, Any]:
    table = scene_to_dict(scene, {*TABLES})
    return dict(_leaves({**table, "effects": {**_idle_effects(EFFECTS), **table["effects"]}}))


def _idle_effects(names: Iterable[str]) -> dict[str, Any]:
    """Tables of those of the effects that do nothing by default, by name."""
    found = {}
    for name in names:
        with contextlib.suppress(ConfigurationError, KeyError):
            if not (effect := EFFECTS[name]()).acts:
                found[name] = effect.model_dump(mode="json", exclude_none=True)
    return found


def _leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if not isinstance(node, dict | list) or not node:
        yield key.removeprefix("."), node
        return
    for name, value in node.items() if isinstance(node, dict) else enumerate(node):
        yield from _leaves(value, f"{key}.{name}")


def _matching(name: str, entries: Mapping[str, Any]) -> list[str]:
    """Keys of the parameters that a name stands for, or several with `|` between them."""
    pattern = (
        re.escape(re.sub(r"\[(\d+|\*)\]", r".\1", name))
        .replace(r"\*", r"[^.]+")
        .replace(r"\|", "|")
    )
    return [
        key
        for key, value in entries.items()
        if re.fullmatch(pattern, key) and not _misfit(key, value)
    ]


def _misfit(key: str, value: Any) -> str:
    """Reason why an entry is no parameter."""
    fixed = next((reason for pattern, reason in FIXED.items() if re.fullmatch(pattern, key)), "")
    return fixed or (
        "" if isinstance(value, float) else f"{shown(value)} is no number, or a whole one"
    )


def _parameter(name: str, entries: Mapping[str, Any]) -> Parameter:
    keys = list[str]()
    for one in map(".".join, itertools.product(*(part.split(",") for part in name.split(".")))):
        if not (matches := _matching(one, entries)):
            _fail(one, _refusal(one, entries))
        keys += [key for key in matches if key not in keys]
    arrays = {re.sub(r"\.\d+$", "", key) for key in keys}  # of a number of its own the key itself
    size = max(
        abs(value)
        for key, value in entries.items()
        if isinstance(value, float) and re.sub(r"\.\d+$", "", key) in arrays
    )
    return Parameter(name, tuple(keys), tuple(entries[key] for key in keys), size)


def _refusal(name: str, entries: Mapping[str, Any]) -> str:
    """Reason why a name stands for no parameter, for a message."""
    for key in (name, f"{name}.0".replace(".*", "")):
        if key in entries and (misfit := _misfit(key, entries[key])):
            return f"is no parameter: {misfit}"
    effect = name.removeprefix("effects.").partition(".")[0] if name.startswith("effects.") else ""
    if effect in EFFECTS and not any(f"{key}.".startswith(f"effects.{effect}.") for key in entries):
        return f"is no number yet: the scene has no [effects.{effect}]: add it"
    if parts := {
        part
        for key in _matching(f"{name}.*", entries)
        if (part := key.rpartition(".")[2]).isdecimal()
    }:
        return (
            f"is a vector of {len(parts)} numbers: name one, {name}.0, or all by a common factor,"
            f" {name}.*"
        )
    valid = {
        re.sub(r"\.\d+(?=\.|$)", ".*", key)
        for key, value in entries.items()
        if not _misfit(key, value)
    }
    return f"is no number of the scene: {not_among(name, valid)}"


def _is_relative(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and len(value) == 1
        and [*value][0] in KINDS
        and not isinstance([*value.values()][0], Mapping)
    )


def _interval(key: str, value: Any) -> tuple[float, float]:
    """Least and greatest of a number or a pair. Raises ConfigurationError."""
    pair = value if isinstance(value, list | tuple) else (value, value)
    is_real = [
        isinstance(end, int | float) and not isinstance(end, bool) and np.isfinite(end)
        for end in pair
    ]
    if is_real != [True, True] or pair[0] > pair[1]:
        _fail(key, f"has {shown(value)}: it should be {NUMBER}")
    return float(pair[0]), float(pair[1])


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)])
