"""Ranges of a scene's numbers by dotted keys, as domain randomisation draws them: of values, of factors or of offsets of the scene's."""

from collections.abc import Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.scene.parameters import number_tables, scene_parameters
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, matching, shown

KINDS = ("factor", "offset")
"""Kinds of ranges that are relative to the scene's number."""
NUMBER = "a number, or (least, greatest)"


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


def checked_ranges(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """A table of ranges with tables in tables as dotted keys, as far as it can be judged without a scene. Raises ConfigurationError."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        key = prefix + name
        if isinstance(value, Mapping) and not _is_relative(value):
            found |= checked_ranges(value, f"{key}.")
        elif isinstance(value, str | bool | None):
            _fail(key, f"is {shown(value)}: it should be {NUMBER}, or a table with {' or '.join(KINDS)}")
        else:
            for own in value.values() if isinstance(value, Mapping) else ():
                _interval(key, own)
            found[key] = value
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
