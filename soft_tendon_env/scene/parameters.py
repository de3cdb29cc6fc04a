"""Parameters of a scene: its numbers by dotted keys with wildcards, as identification fits them and derivatives vary them; and ranges of
them, of values, factors or offsets, as domain randomisation draws them."""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.configuration import ANY, ConfigurationError, Problem, matching, not_among, shown

TABLES = ("segments", "tendons", "effects")
"""Tables of a scene with the numbers of the arm; the others say how it is computed."""
FIXED = {
    r"segments\.\d+\.length|tendons\.\d+\.(start|end)": "it decides where the quadrature points lie; build a model for each value",
    r"tendons\.\d+\.tension_limits\.\d": "it bounds the commands, and nothing changes with it in between",
}
"""Patterns of keys whose numbers are no parameters, and why."""
KINDS = ("factor", "offset")
"""Kinds of ranges that are relative to the scene's number."""
NUMBER = "a number, or (least, greatest)"


class Parameter(NamedTuple):
    """Named number of a scene, or several that change together: one value where all are alike, otherwise a common factor."""

    name: str  # the key as it was given, "segments.*.young_modulus"
    keys: tuple[str, ...]  # those that it stands for
    values: tuple[float, ...]  # in the scene, one per key
    size: float  # largest magnitude of these and of the numbers beside them in their arrays, as of the other components of a vector

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
        return {key: value * own if self.is_factor else value for key, own in zip(self.keys, self.values, strict=True)}


def scene_parameters(scene: Scene, names: Iterable[str]) -> tuple[Parameter, ...]:
    """Parameters of a scene by dotted keys, in which `*` stands for every entry: `"segments.*.young_modulus"`,
    `"tendons.3.routing.offset.0"`, `"effects.gravity.acceleration.2"`.

    Any number of `[[segments]]`, `[[tendons]]` and `[effects]` can be one, but for lengths of segments and ends and limits of
    tendons. An effect that does nothing unless it is told to, as a tip load, need not be in the scene. Raises TypeError for what is no
    text, ConfigurationError for keys of anything else, with those that there are.
    """
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise TypeError(f"keys should be several dotted keys, such as ['segments.*.young_modulus'], not {shown(names)}")
    table = number_tables(scene)
    entries = dict(_leaves(table))
    return tuple(_parameter(name, _keys(table, entries, name), entries) for name in names)


def scene_with_numbers(scene: Scene, changes: Mapping[str, float]) -> Scene:
    """The scene with other numbers by dotted keys, among them those of effects that it lacks, see `scene_parameters`.

    Raises ConfigurationError.
    """
    named = {key.split(".")[1] for key in changes if key.startswith("effects.")} - scene.effects.chosen().keys()
    return scene.replace({**{f"effects.{name}": own for name, own in _idle_effects(named).items()}, **changes})


def number_tables(scene: Scene) -> dict[str, Any]:
    """The tables of a scene with the numbers of its arm, plain, with those of effects that do nothing by default."""
    table = scene_to_dict(scene, {*TABLES})
    return {**table, "effects": {**_idle_effects(EFFECTS), **table["effects"]}}


def _idle_effects(names: Iterable[str]) -> dict[str, Any]:
    """Tables of those of the effects that do nothing by default, by name."""
    found = {}
    for name in names:
        with contextlib.suppress(ConfigurationError, KeyError):
            if not (effect := EFFECTS[name]()).acts:
                found[name] = effect.model_dump(mode="json", exclude_none=True)
    return found


def _keys(table: Mapping[str, Any], entries: Mapping[str, Any], name: str) -> list[str]:
    """Keys of the numbers that a name stands for."""
    if not isinstance(name, str):
        raise TypeError(f"a parameter should be a dotted key such as 'segments.*.young_modulus', not {shown(name)}")
    with contextlib.suppress(ConfigurationError):
        keys = matching(table, name)
        if ANY not in name and keys[0] in entries:
            return keys
        if found := [key for key in keys if key in entries and not _misfit(key, entries[key])]:
            return found
    valid = {re.sub(r"\.\d+(?=\.|$)", ".*", key) for key, value in entries.items() if not _misfit(key, value)}
    raise ConfigurationError([Problem((name,), f"is no number of the scene: {not_among(name, valid)}")])


def _parameter(name: str, keys: list[str], entries: Mapping[str, Any]) -> Parameter:
    for key in keys:
        if misfit := _misfit(key, entries[key]):
            raise ConfigurationError([Problem((key,), misfit)])
    beside = {other for key in keys for other in entries if _array_of(other) == _array_of(key)}
    size = max(abs(value) for other, value in entries.items() if other in beside and isinstance(value, float))
    return Parameter(name, tuple(keys), tuple(entries[key] for key in keys), size)


def _misfit(key: str, value: Any) -> str:
    """Reason why an entry of a scene is no parameter; empty where it is one."""
    for pattern, reason in FIXED.items():
        if re.fullmatch(pattern, key):
            return f"is no parameter: {reason}"
    if isinstance(value, float):
        return ""
    kind = "a switch" if isinstance(value, bool) else "a whole number" if isinstance(value, int) else "no number"
    return f"is no parameter: {shown(value)} is {kind}"


def _array_of(key: str) -> str:
    """Key of the array that a number stands in, of a number of its own the key itself."""
    head, _, last = key.rpartition(".")
    return head if last.isdecimal() else key


def _leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of nested plain tables and arrays."""
    if not isinstance(node, dict | list):
        yield key.removeprefix("."), node
        return
    for name, value in node.items() if isinstance(node, dict) else enumerate(node):
        yield from _leaves(value, f"{key}.{name}")


class Range(NamedTuple):
    """Range of a number of the scene, or of several that change together."""

    name: str  # as messages have it
    keys: tuple[str, ...]
    values: tuple[float, ...]  # in the scene, one per key
    kind: str  # "value", or one of KINDS
    least: float
    greatest: float

    def changes(self, drawn: float) -> dict[str, float]:
        """Dotted keys and values for a number that is drawn, for `Scene.replace`."""
        made = {"value": lambda own: drawn, "factor": lambda own: drawn * own, "offset": lambda own: drawn + own}[self.kind]
        return {key: made(own) for key, own in zip(self.keys, self.values, strict=True)}


def dotted_ranges(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A table of ranges with tables in tables as dotted keys."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        nested = isinstance(value, Mapping) and not _is_relative(value)
        found |= dotted_ranges(value, f"{prefix}{name}.") if nested else {prefix + name: value}
    return found


def ranges_of(scene: Scene, wanted: Mapping[str, Any]) -> tuple[Range, ...]:
    """Ranges by dotted keys of a scene, checked against it.

    Raises ConfigurationError for keys that are no numbers of the scene, with those that there are, for what is no range, and for a number
    that two of them draw.
    """
    table, found = number_tables(scene), list[Range]()
    for key, value in wanted.items():
        found += _ranges(scene, table, key, value)
    for i, own in enumerate(found):
        if other := next((before for before in found[:i] if {*before.keys} & {*own.keys}), None):
            _fail(own.name, f"draws what {other.name!r} draws already")
    return tuple(found)


def _ranges(scene: Scene, table: Mapping[str, Any], key: str, value: Any) -> list[Range]:
    """The range of a number, or of each entry of a vector."""
    try:
        entries = sorted({own.rpartition(".")[2] for own in matching(table, f"{key}.*")})
    except ConfigurationError:
        entries = []
    if not entries or not entries[-1].isdecimal():
        return [_range(scene, key, value)]
    if _is_relative(value):
        return [_range(scene, f"{key}.*", value)]
    if not isinstance(value, list) or len(value) != len(entries):
        _fail(key, f"is {shown(value)}: it should be a list of {len(entries)}, each {NUMBER}; or {{'{KINDS[0]}': {NUMBER}}}")
    return [_range(scene, f"{key}.{i}", own) for i, own in enumerate(value)]


def _range(scene: Scene, key: str, value: Any) -> Range:
    (own,) = scene_parameters(scene, [key])
    ((kind, interval),) = value.items() if isinstance(value, Mapping) else (("value", value),)
    return Range(key, own.keys, own.values, kind, *_interval(key, interval))


def _is_relative(value: Any) -> bool:
    return isinstance(value, Mapping) and len(value) == 1 and [*value][0] in KINDS and not isinstance([*value.values()][0], Mapping)


def _interval(key: str, value: Any) -> tuple[float, float]:
    """Least and greatest of a number or a pair. Raises ConfigurationError."""
    pair = value if isinstance(value, list | tuple) else (value, value)
    if len(pair) != 2 or not all(isinstance(end, int | float) and not isinstance(end, bool) and np.isfinite(end) for end in pair):
        _fail(key, f"has {shown(value)}: it should be {NUMBER}")
    if pair[0] > pair[1]:
        _fail(key, f"has {shown(value)}: the least should come first")
    return float(pair[0]), float(pair[1])


def _fail(key: str, text: str) -> NoReturn:
    raise ConfigurationError([Problem((key,), text)])
