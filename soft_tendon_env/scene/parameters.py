"""Parameters of a scene: its numbers by dotted keys with wildcards, and ranges of them.

Domain randomisation draws from the ranges.
"""

import contextlib
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple, NoReturn

import numpy as np

from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.scene.scene import Scene, scene_to_dict
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, shown

# tables with the numbers of the arm; the others say how it is computed
TABLES = ("segments", "tendons", "base", "effects")
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
    """Named number of a scene, or several that change together.

    It is one value where all are alike, otherwise a common factor.
    """

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
        if self.is_factor:
            return 1.0
        return self.values[0]

    def changes(self, value: float) -> dict[str, float]:
        """Returns the changes of the scene that give the parameter a value.

        Args:
            value: in the unit of the keys, or a factor of the scene's values.

        Returns:
            Values by dotted keys, for `Scene.replace`.
        """
        if not self.is_factor:
            return dict.fromkeys(self.keys, value)
        numbers = {}
        for key, number in zip(self.keys, self.values, strict=True):
            numbers[key] = value * number
        return numbers


class Range(NamedTuple):
    """Range of numbers that change together.

    It is one of their value, or of a factor or an offset of what the scene says.
    """

    name: str
    keys: tuple[str, ...]
    values: tuple[float, ...]  # in the scene, one per key
    kind: str  # "value", or one of KINDS
    least: float
    greatest: float

    def changes(self, number: float) -> dict[str, float]:
        """Dotted keys and values for a number of the range, for `Scene.replace`."""
        if self.kind == "value":
            return dict.fromkeys(self.keys, number)
        values = zip(self.keys, self.values, strict=True)
        if self.kind == "factor":
            return {key: number * value for key, value in values}
        return {key: value + number for key, value in values}

    def share(self, numbers: Mapping[str, float]) -> float:
        """Place of a scene with these numbers by dotted keys within the range, 0 to 1.

        0 is the least number of the range, 1 the greatest.
        """
        key = self.keys[0]
        least = self.changes(self.least)[key]
        greatest = self.changes(self.greatest)[key]
        usual = self.values[0]
        number = numbers.get(key, usual)
        width = greatest - least
        return (number - least) / width


def scene_parameters(scene: Scene, names: Iterable[str]) -> tuple[Parameter, ...]:
    """Returns the parameters of a scene by dotted keys.

    In a key `*` stands for every entry, as `"segments.*.young_modulus"`, and `0,2` for those that
    it lists.

    Any number of `[[segments]]`, `[[tendons]]`, `[base]` and `[effects]` can be one, but for
    lengths of segments, ends and limits of tendons, and the quaternion. An effect that does nothing
    unless it is told to, as a tip load, need not be in the scene.

    Args:
        scene: the arm.
        names: dotted keys.

    Returns:
        One parameter for each name.

    Raises:
        ConfigurationError: for keys of anything else, with those that there are.
    """
    entries = scene_entries(scene)
    parameters = (_parameter(name, entries) for name in names)
    return tuple(parameters)


def scene_with_numbers(scene: Scene, changes: Mapping[str, float]) -> Scene:
    """The scene with other numbers, also of effects that it lacks, see `scene_parameters`.

    Args:
        scene: to change.
        changes: numbers by dotted keys.

    Returns:
        The scene.

    Raises:
        ConfigurationError: for keys and values that are not allowed.
    """
    keys_of_effects = [key for key in changes if key.startswith("effects.")]
    effects = {key.split(".")[1] for key in keys_of_effects}
    known = scene.effects.chosen().keys()
    lacking_effects = effects - known
    tables = dict[str, Any]()
    for name, table in _idle_effects(lacking_effects).items():
        tables[f"effects.{name}"] = table
    return scene.replace({**tables, **changes})


def dotted_ranges(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Ranges by dotted keys of a table with tables in tables.

    Args:
        table: as it is written.
        prefix: of its keys.

    Returns:
        The ranges, not checked.
    """
    ranges = dict[str, Any]()
    for name, value in table.items():
        key = prefix + name
        if isinstance(value, Mapping) and not _is_relative(value):
            ranges |= dotted_ranges(value, f"{key}.")
        else:
            ranges[key] = value
    return ranges


def ranges_of(scene: Scene, table: Mapping[str, Any]) -> tuple[Range, ...]:
    """Ranges of a scene's numbers, as domain randomisation draws them.

    Args:
        scene: the arm.
        table: ranges by dotted keys, of a vector a list with one for each entry.

    Returns:
        The ranges, of a list one by one.

    Raises:
        ConfigurationError: for keys that are no numbers of the scene, for what is no range, and for
            a number that two of them draw.
    """
    entries = scene_entries(scene)
    ranges = list[Range]()
    drawn = dict[str, str]()  # the range that draws a number, by the number's key
    for name, value in table.items():
        for key, written in _by_entry(name, value, entries):
            _, keys, values, _ = _parameter(key, entries)
            if _is_relative(written):
                relative = written
            else:
                relative = {"value": written}
            ((kind, interval),) = relative.items()
            least, greatest = _interval(key, interval)
            numbers_range = Range(
                key,
                keys=keys,
                values=values,
                kind=kind,
                least=least,
                greatest=greatest,
            )
            ranges.append(numbers_range)
            for number in keys:
                if number in drawn:
                    _fail(key, f"draws what {drawn[number]!r} draws already")
            drawn |= dict.fromkeys(keys, key)
    return tuple(ranges)


def _by_entry(name: str, value: Any, entries: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Keys and ranges, as they are written, of a number, or of the entries of a vector.

    Raises ConfigurationError for a list of another length.
    """
    children = _matching(f"{name}.*", entries)
    # the last parts of the keys of a vector's entries are 0, 1, ...
    last_parts = {key.rpartition(".")[2] for key in children}
    places = sorted(last_parts)
    is_vector = bool(places) and places[-1].isdecimal()
    if not is_vector:
        return [(name, value)]
    if _is_relative(value):
        return [(f"{name}.*", value)]
    is_list = isinstance(value, list)
    if not is_list or len(value) != len(places):
        _fail(
            name,
            f"is {shown(value)}: it should be a list of {len(places)}, each {NUMBER}; or"
            f" {{'{KINDS[0]}': {NUMBER}}}",
        )
    return [(f"{name}.{i}", entry) for i, entry in enumerate(value)]


def scene_entries(scene: Scene) -> dict[str, Any]:
    """Entries of a scene by dotted keys, also of effects that do nothing by default."""
    tables = scene_to_dict(scene, {*TABLES})
    idle = _idle_effects(EFFECTS)
    tables["effects"] = {**idle, **tables["effects"]}
    return dict(_leaves(tables))


def _idle_effects(names: Iterable[str]) -> dict[str, Any]:
    """Tables of those of the effects that do nothing by default, by name."""
    tables = {}
    for name in names:
        # others have numbers that must be given, or are no effects: the scene's own checks say so
        with contextlib.suppress(ConfigurationError, KeyError):
            effect = EFFECTS[name]()
            if not effect.acts:
                tables[name] = effect.model_dump(mode="json", exclude_none=True)
    return tables


def _leaves(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and entries of tables and lists in each other."""
    is_branch = isinstance(node, dict | list) and bool(node)
    if not is_branch:
        yield key.removeprefix("."), node
        return
    children: Iterable[tuple[Any, Any]] = enumerate(node)
    if isinstance(node, dict):
        children = node.items()
    for name, value in children:
        yield from _leaves(value, f"{key}.{name}")


def _matching(name: str, entries: Mapping[str, Any]) -> list[str]:
    """Keys of the parameters that a name stands for, or several with `|` between them."""
    # entries may be in brackets, [0] or [*]
    dotted = re.sub(r"\[(\d+|\*)\]", r".\1", name)
    escaped = re.escape(dotted)
    with_any_part = escaped.replace(r"\*", r"[^.]+")
    with_alternatives = with_any_part.replace(r"\|", "|")
    pattern = re.compile(with_alternatives)
    keys = list[str]()
    for key, value in entries.items():
        if pattern.fullmatch(key) and not _misfit(key, value):
            keys.append(key)
    return keys


def _misfit(key: str, value: Any) -> str:
    """Reason why an entry is no parameter."""
    for pattern, reason in FIXED.items():
        if re.fullmatch(pattern, key):
            return reason
    if not isinstance(value, float):
        return f"{shown(value)} is no number, or a whole one"
    return ""


def _parameter(name: str, entries: Mapping[str, Any]) -> Parameter:
    """Parameter that a name stands for.

    Raises ConfigurationError.
    """
    keys = list[str]()
    # a part of a name may list several entries
    choices = [part.split(",") for part in name.split(".")]
    for parts in itertools.product(*choices):
        single_name = ".".join(parts)
        matches = _matching(single_name, entries)
        if not matches:
            _fail(single_name, _refusal(single_name, entries))
        keys += [key for key in matches if key not in keys]
    # the size is that of the largest entry of the same arrays
    arrays = {_array_of(key) for key in keys}
    sizes = list[float]()
    for key, value in entries.items():
        if isinstance(value, float) and _array_of(key) in arrays:
            sizes.append(abs(value))
    numbers = (entries[key] for key in keys)
    values = tuple(numbers)
    return Parameter(
        name,
        keys=tuple(keys),
        values=values,
        size=max(sizes),
    )


def _array_of(key: str) -> str:
    """Key of the array that an entry is of, of a number of its own the key itself."""
    return re.sub(r"\.\d+$", "", key)


def _refusal(name: str, entries: Mapping[str, Any]) -> str:
    """Reason why a name stands for no parameter, for a message."""
    first_entry = f"{name}.0".replace(".*", "")
    for key in (name, first_entry):
        if key in entries:
            misfit = _misfit(key, entries[key])
            if misfit:
                return f"is no parameter: {misfit}"
    if name.startswith("effects."):
        effect = name.removeprefix("effects.").partition(".")[0]
        table = f"effects.{effect}."
        is_of_table = (f"{key}.".startswith(table) for key in entries)
        has_effect = any(is_of_table)
        if effect in EFFECTS and not has_effect:
            return f"is no number yet: the scene has no [effects.{effect}]: add it"
    children = _matching(f"{name}.*", entries)
    last_parts = {key.rpartition(".")[2] for key in children}
    places = [part for part in last_parts if part.isdecimal()]
    if places:
        return (
            f"is a vector of {len(places)} numbers: name one, {name}.0, or all by a common factor,"
            f" {name}.*"
        )
    valid = set[str]()
    for key, value in entries.items():
        if not _misfit(key, value):
            # numbers of entries are left out
            valid.add(re.sub(r"\.\d+(?=\.|$)", ".*", key))
    return f"is no number of the scene: {not_among(name, valid)}"


def _is_relative(value: Any) -> bool:
    """Whether a value is a range of a factor or an offset, and no table of the scene."""
    if not isinstance(value, Mapping) or len(value) != 1:
        return False
    kind, *_ = value
    is_interval = not isinstance(value[kind], Mapping)
    return kind in KINDS and is_interval


def _interval(key: str, value: Any) -> tuple[float, float]:
    """Least and greatest of a number or a pair.

    Raises ConfigurationError.
    """
    if isinstance(value, list | tuple):
        pair = value
    else:
        pair = (value, value)
    are_numbers = all(map(_is_number, pair))
    if len(pair) == 2 and are_numbers:
        least, greatest = pair
        if least <= greatest:
            return float(least), float(greatest)
    message = f"has {shown(value)}: it should be {NUMBER}"
    _fail(key, message)


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number, which True and False are not."""
    is_bool = isinstance(value, bool)
    is_number = isinstance(value, int | float)
    return is_number and not is_bool and bool(np.isfinite(value))


def _fail(key: str, text: str) -> NoReturn:
    """Raises ConfigurationError about a key."""
    raise ConfigurationError([Problem((key,), text)])
