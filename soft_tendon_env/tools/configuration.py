"""Configuration classes: strict validation, overrides by dotted keys.

All mistakes are in one readable error.

A configuration is a frozen pydantic model. Unknown keys, wrong types and wrong ranges are found by
pydantic; this module only translates its report into a `ConfigurationError` that names the file,
the dotted key, the value and what is allowed.
"""

import difflib
import os
import re
import threading
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any, ClassVar, NamedTuple, Self, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from soft_tendon_env.tools.files import read_bytes
from soft_tendon_env.tools.forks import hold_over_forks

Key = tuple[str | int, ...]
_pydantic = threading.RLock()
# pydantic has locks of its own while it validates and serialises; a child must not find them locked
hold_over_forks(_pydantic)

POSITION = re.compile(r"\[(\d+|\*)\]")
"""A position in an array in brackets, `[3]`, or `[*]` for every one."""
DOT = re.compile(r'\.(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""A dot that is not in double quotes: an even number of quotes follows it."""

DEEPEST = 64
"""Levels of tables and arrays that a file may nest, ten times what any configuration has."""

TOO_DEEP = "nests arrays or tables too deep to be read"
"""End of the message on values whose parser would exceed Python's depth of calls."""


class Problem(NamedTuple):
    """One mistake in a configuration: its key and the rest of the sentence.

    The key counts from the table at hand, and begins the sentence.
    """

    key: Key
    text: str


class ConfigurationError(ValueError):
    """Invalid configuration: one line per mistake, `source: key is value: what is allowed`.

    Attributes: `problems`, every `Problem`; `source`, the file, or what was being built.

    Args:
        problems: every mistake, its key and what is allowed.
        source: name of the file, or of what was being built.
    """

    def __init__(self, problems: Iterable[Problem], source: str = "scene"):
        self.problems = tuple(problems)
        self.source = source
        super().__init__(self.problems, source)  # both in args: the exception pickles

    def __str__(self) -> str:
        lines = []
        for key, text in self.problems:
            sentence = f"{dotted(key)} {text}".strip()
            lines.append(f"{self.source}: {sentence}")
        return "\n".join(lines)


class Configuration(BaseModel):
    """Base of every configuration class: frozen, strict, finite numbers only.

    Raises `ConfigurationError`.

    Integers pass as floats, booleans do not pass as numbers. Lists and numpy arrays are stored as
    tuples, paths as strings.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    elsewhere: ClassVar[Mapping[str, str]] = {}
    """Keys that it has not, but people look for, and how to write what they mean."""

    def __init__(self, /, **values: Any):
        frozen = {name: _freeze(value) for name, value in values.items()}
        try:
            with _pydantic:
                super().__init__(**frozen)
        except ValidationError as error:
            problems = list[Problem]()
            for details in error.errors():
                problems += _problems(type(self), details)
            raise ConfigurationError(problems, type(self).__name__) from None

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Plain values by name, see pydantic."""
        with _pydantic:
            return super().model_dump(**options)

    def model_dump_json(self, **options: Any) -> str:
        """JSON of plain values by name, see pydantic."""
        with _pydantic:
            return super().model_dump_json(**options)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Keys that have other values than by default."""
        fields = type(self).model_fields
        changed = []
        for name, value in super().__repr_args__():
            field = fields[str(name)]
            if value != field.get_default(call_default_factory=True, validated_data={}):
                changed.append((name, value))
        return changed

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """The configuration of a plain table; `source` is the file to name in errors.

        Raises `ConfigurationError`.
        """
        try:
            return cls(**values)
        except ConfigurationError as error:
            raise ConfigurationError(error.problems, source) from None


def _freeze(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic | os.PathLike):
        value = plain(value)
    if isinstance(value, list):
        return tuple(value)
    return value


def plain(value: Any) -> Any:
    """Value as plain JSON types.

    NumPy's, paths and configurations become plain, alone or nested in tables and lists.
    """
    if isinstance(value, Configuration):
        return value.model_dump(mode="json", exclude_none=True)
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {plain(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def dotted(key: Key) -> str:
    """`("tendons", 3, "end")` -> `"tendons[3].end"`."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}"
    return text.removeprefix(".")


def shown(value: Any) -> str:
    """A value as text for an error message: arrays in brackets, long ones cut."""
    if isinstance(value, tuple):
        plain_value = list(value)
    else:
        plain_value = value
    text = repr(plain_value)
    if len(text) <= 80:
        return text
    return text[:76] + " ..."


def not_among(name: str, valid: Iterable[str]) -> str:
    """The end of a message about an unknown name: what was probably meant, and every valid name."""
    valid = sorted(valid)
    every_name = f"valid: {', '.join(valid)}"
    close = difflib.get_close_matches(name, valid, n=1)
    if close:
        return f"did you mean {close[0]!r}? {every_name}"
    return every_name


def not_registered(name: str, valid: Iterable[str]) -> str:
    """End of a message about an unknown name of what users can register.

    It is that of `not_among`, and what to do about one of their own.
    """
    return (
        f"{not_among(name, valid)}; to use one of your own, import its module first (on the command"
        " line: --import MODULE)"
    )


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises ConfigurationError where it cannot be read or is not TOML.
    """
    try:
        tables = tomllib.loads(read_bytes(path).decode("utf-8-sig"))
        _check_depth(tables)
    except OSError as error:
        problem = Problem((), f"cannot be read: {error.strerror}")
        raise ConfigurationError([problem], os.fspath(path)) from error
    except ValueError as error:  # TOMLDecodeError says the line; UnicodeDecodeError the byte
        problem = Problem((), f"is not valid TOML: {error}")
        raise ConfigurationError([problem], os.fspath(path)) from error
    except RecursionError:
        # its traceback would be as deep as the tables
        raise ConfigurationError([Problem((), TOO_DEEP)], os.fspath(path)) from None
    return tables


def _check_depth(value: Any) -> None:
    """Raises RecursionError for tables in tables, or arrays in arrays, beyond DEEPEST.

    Keys with dots nest them without a call of the parser.
    """
    level = [value]
    for _ in range(DEEPEST):
        below = list[Any]()
        for part in level:
            if isinstance(part, dict):
                below += part.values()
            elif isinstance(part, list):
                below += part
        if not below:
            return
        level = below
    raise RecursionError


def override(table: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Set dotted keys (`"tendons.3.end"` or `"tendons[3].end"`) in nested plain tables, in place.

    A `*` stands for every entry of a table or an array, `"segments.*.density"`. A key that has dots
    stands in double quotes. Absent tables are created, positions in arrays must exist; whether keys
    are valid shows later. Raises `TypeError`, `ConfigurationError`.
    """
    for path, value in changes.items():
        if not isinstance(path, str):
            raise TypeError(
                f"changes has the key {shown(path)}: keys should be strings such as"
                " 'quadrature.intervals'"
            )
        with_dots = POSITION.sub(r".\1", path)
        keys = DOT.split(with_dots)
        parts = [part.strip('"') for part in keys]
        _set(table, parts, value, "")


def _set(node: Any, parts: list[str], value: Any, where: str) -> None:
    """Set the key of these parts in the table or array that stands at `where`."""
    part, *below = parts
    path = ".".join([where, *parts])
    for place in _places(node, part, where, path):
        if not below:
            node[place] = deepcopy(value)
            continue
        if isinstance(node, dict):
            node.setdefault(place, {})
        place_of_part = f"{where}.{place}"
        _set(node[place], below, value, place_of_part)


def _places(node: Any, part: str, where: str, path: str) -> Sequence[Any]:
    """Keys or positions of a table or an array that a part of a path means.

    Raises ConfigurationError, which names the path.
    """
    problem = None
    places: Sequence[Any] = ()
    if isinstance(node, dict):
        if part == "*":
            places = [*node]
        else:
            places = [part]
    elif isinstance(node, list):
        every_place = range(len(node))
        if part == "*":
            places = every_place
        elif part in map(str, every_place):
            places = [int(part)]
        else:
            last = len(node) - 1
            problem = f"{part!r} is no position in {where[1:]}; valid: 0 to {last}"
    else:
        problem = f"{where[1:]} is {shown(node)}, not a table"

    if problem is None and not places:
        problem = f"{where[1:]} is empty"
    if problem is not None:
        cause = Problem((path[1:],), f"cannot be set: {problem}")
        raise ConfigurationError([cause])
    return places


def parsed_changes(changes: Iterable[str]) -> dict[str, Any]:
    """Values by key of texts "dotted.key=value", as in TOML or else the text itself.

    Raises ValueError, also for a key given twice.
    """
    values: dict[str, Any] = {}
    for change in changes:
        key, equals, text = map(str.strip, change.partition("="))
        if not key or not equals:
            raise ValueError(
                f"--set {change!r} should be KEY=VALUE, such as quadrature.intervals=12"
            )
        if key in values:
            raise ValueError(f"--set has {key}, which is given twice")
        try:
            parsed = tomllib.loads(f"value = {text}")
            values[key] = parsed["value"]
            _check_depth(values[key])
        except tomllib.TOMLDecodeError:  # a text without quotes
            values[key] = text
        except RecursionError:
            raise ValueError(f"--set {key} {TOO_DEEP}") from None
    return values


def _problems(table: type[Configuration], error: ErrorDetails) -> list[Problem]:
    """The problems behind one of pydantic's errors, with keys relative to `table`.

    A nested table reports its own as a ConfigurationError, so a location holds no keys beyond the
    first and, in a table of tables, their name: any other string in it is the tag of a union's
    member, which the user never wrote.
    """
    key = _key_of(table, error["loc"])
    value = error["input"]
    context = error.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, ConfigurationError):
        return [Problem(key + inner, text) for inner, text in cause.problems]
    # The names are pydantic's, of its kinds of error.
    match error["type"]:
        case "default_factory_not_called":
            return []  # a default that depends on other keys, of which some are wrong
        case "extra_forbidden":
            name = str(key[-1])
            advice = table.elsewhere.get(name)
            valid = advice or not_among(name, table.model_fields)
            message = f"is an unknown key (given {shown(value)}): {valid}"
            return [Problem(key, message)]
        case "missing":
            return [Problem(key, "is missing: it is required")]
        case "union_tag_not_found":
            return [Problem((*key, "type"), "is missing: it is required")]
        case "union_tag_invalid":
            tag = context["tag"]
            types = re.findall(r"'(\w+)'", context["expected_tags"])
            message = f"is {tag!r}: {not_among(tag, types)}"
            return [Problem((*key, "type"), message)]
        case "too_short" if len(value) > context["actual_length"]:
            return []  # pydantic counts the valid items only; the others are reported by themselves
        case "model_type" | "model_attributes_type":
            return [Problem(key, f"is {shown(value)}: it should be a table")]
    message = f"is {shown(value)}: it {_allowed(error)}"
    return [Problem(key, message)]


def _key_of(table: type[Configuration], location: Key) -> Key:
    """The key that a user wrote, out of the location of one of pydantic's errors."""
    # A name, and in a table of tables a second one.
    name_count = 1
    if location:
        field = table.model_fields.get(str(location[0]))
        if field is not None and get_origin(field.annotation) is dict:
            name_count = 2
    rest = location[name_count:]
    positions = tuple(part for part in rest if isinstance(part, int))
    return location[:name_count] + positions


def _allowed(error: ErrorDetails) -> str:
    """Allowed values, as the end of a sentence that begins with "it"."""
    if "error" in error.get("ctx", {}):
        return str(error["ctx"]["error"])  # a validator's own words
    message = re.sub(r"^\w+ should", "should", error["msg"])
    text = str(error["input"])
    is_number_with_unit = re.fullmatch(r"[-+.\d]+ ?[^\W\d]+", text) is not None
    if error["type"].startswith("float") and is_number_with_unit:
        message += ", in SI units and without their symbol"
    # The words of TOML in place of Python's.
    message = message.replace("tuple", "array")
    message = message.replace("a valid boolean", "true or false")
    return message.replace(" after validation", "")
