"""Configuration classes: strict validation, one readable error for all mistakes, overrides by
dotted keys.

A configuration is a frozen pydantic model. Unknown keys, wrong types and wrong ranges are found by
pydantic; this module only translates its report into a `ConfigurationError` that names the file,
the dotted key, the value and what is allowed.
"""

import difflib
import os
import re
import threading
import tomllib
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, ClassVar, NamedTuple, Self, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from soft_tendon_env.tools.files import read_bytes
from soft_tendon_env.tools.forks import hold_over_forks

Key = tuple[str | int, ...]
_validating = threading.RLock()
# pydantic has locks of its own, which a child must not find locked
hold_over_forks(_validating)


class Problem(NamedTuple):
    """One mistake: the key it is at, from the table at hand, and the rest of the sentence that
    begins with the key."""

    key: Key
    text: str


class ConfigurationError(ValueError):
    """Invalid configuration: one line per mistake, `source: key is value: what is allowed`.

    Attributes: `problems`, every `Problem`; `source`, the file, or what was being built.
    """

    def __init__(self, problems: Iterable[Problem], source: str = "scene"):
        self.problems, self.source = tuple(problems), source
        super().__init__(self.problems, source)  # both in args: the exception pickles

    def __str__(self) -> str:
        return "\n".join(
            ": ".join((self.source, f"{dotted(key)} {text}".strip())) for key, text in self.problems
        )


class Configuration(BaseModel):
    """Base of every configuration class: frozen, strict, finite numbers only. Raises
    `ConfigurationError`.

    Integers pass as floats, booleans do not pass as numbers. Lists and numpy arrays are stored as
    tuples, paths as strings.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
    elsewhere: ClassVar[
        Mapping[str, str]
    ] = {}  # keys that it has not, but people look for, and how to write what they mean

    def __init__(self, /, **values: Any):
        try:
            with _validating:
                super().__init__(**{name: _freeze(value) for name, value in values.items()})
        except ValidationError as error:
            problems = [
                problem for found in error.errors() for problem in _problems(type(self), found)
            ]
            raise ConfigurationError(problems, type(self).__name__) from None

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Keys that have other values than by default."""
        fields = type(self).model_fields
        defaults = {
            name: field.get_default(call_default_factory=True, validated_data={})
            for name, field in fields.items()
        }
        return [
            (name, value) for name, value in super().__repr_args__() if value != defaults[str(name)]
        ]

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """The configuration of a plain table; `source` is the file to name in errors. Raises
        `ConfigurationError`."""
        try:
            return cls(**values)
        except ConfigurationError as error:
            raise ConfigurationError(error.problems, source) from None


def _freeze(value: Any) -> Any:
    value = plain(value) if isinstance(value, np.ndarray | np.generic | os.PathLike) else value
    return tuple(value) if isinstance(value, list) else value


def plain(value: Any) -> Any:
    """The value as plain JSON types: NumPy's, paths and configurations become plain, alone or
    nested in tables and lists."""
    if isinstance(value, Configuration):
        return value.model_dump(mode="json", exclude_none=True)
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {plain(key): plain(entry) for key, entry in value.items()}
    return [plain(entry) for entry in value] if isinstance(value, list | tuple) else value


def dotted(key: Key) -> str:
    """`("tendons", 3, "end")` -> `"tendons[3].end"`."""
    return "".join(
        f"[{part}]" if isinstance(part, int) else f".{part}" for part in key
    ).removeprefix(".")


def shown(value: Any) -> str:
    """A value as text for an error message: arrays in brackets, long ones cut."""
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 80 else text[:76] + " ..."


def not_among(name: str, valid: Iterable[str]) -> str:
    """The end of a message about an unknown name: what was probably meant, and every valid name."""
    valid = sorted(valid)
    close = difflib.get_close_matches(name, valid, n=1)
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {', '.join(valid)}"


def not_registered(name: str, valid: Iterable[str]) -> str:
    """The end of a message about an unknown name of what users can register: as `not_among`, and
    what to do about one of their own."""
    return (
        f"{not_among(name, valid)}; to use one of your own, import its module first (on the command"
        " line: --import MODULE)"
    )


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file. Raises ConfigurationError where it cannot be read or is not
    TOML."""
    try:
        return tomllib.loads(read_bytes(path).decode("utf-8-sig"))
    except OSError as error:
        raise ConfigurationError(
            [Problem((), f"cannot be read: {error.strerror}")], os.fspath(path)
        ) from error
    except ValueError as error:  # TOMLDecodeError says the line; UnicodeDecodeError the byte
        raise ConfigurationError(
            [Problem((), f"is not valid TOML: {error}")], os.fspath(path)
        ) from error


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
        parts = re.split(
            r'\.(?=(?:[^"]*"[^"]*")*[^"]*$)', re.sub(r"\[(\d+|\*)\]", r".\1", path)
        )  # at dots that are not in quotes
        _set(table, [part.strip('"') for part in parts], value, "")


def _set(node: Any, parts: list[str], value: Any, where: str) -> None:
    """Set the key of these parts in the table or array that stands at `where`."""
    part, *below = parts
    keys = (
        [*node]
        if isinstance(node, dict)
        else [str(i) for i in range(len(node))]
        if isinstance(node, list)
        else None
    )
    problem = None
    if keys is None:
        problem = f"{where[1:]} is {shown(node)}, not a table"
    elif part == "*" and not keys:
        problem = f"{where[1:]} is empty"
    elif isinstance(node, list) and part not in ("*", *keys):
        problem = f"{part!r} is no position in {where[1:]}; valid: 0 to {len(node) - 1}"
    if problem:
        raise ConfigurationError(
            [Problem((f"{where}.{'.'.join(parts)}"[1:],), f"cannot be set: {problem}")]
        )
    for key in keys or () if part == "*" else [part]:
        place: Any = int(key) if isinstance(node, list) else key
        if below:
            _set(
                node.setdefault(place, {}) if isinstance(node, dict) else node[place],
                below,
                value,
                f"{where}.{key}",
            )
        else:
            node[place] = deepcopy(value)


def parsed_changes(changes: Iterable[str]) -> dict[str, Any]:
    """Values by key of texts "dotted.key=value", as in TOML or else the text itself. Raises
    ValueError, also for a key given twice."""
    found: dict[str, Any] = {}
    for change in changes:
        key, _, text = map(str.strip, change.partition("="))
        if not key or "=" not in change:
            raise ValueError(
                f"--set {change!r} should be KEY=VALUE, such as quadrature.intervals=12"
            )
        if key in found:
            raise ValueError(f"--set has {key}, which is given twice")
        try:
            found[key] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            found[key] = text
    return found


def _problems(table: type[Configuration], error: ErrorDetails) -> list[Problem]:
    """The problems behind one of pydantic's errors, with keys relative to `table`.

    A nested table reports its own as a ConfigurationError, so a location holds no keys beyond the
    first and, in a table of tables, their name: any other string in it is the tag of a union's
    member, which the user never wrote.
    """
    location = error["loc"]
    field = table.model_fields.get(str(*location[:1]))
    named = 2 if field is not None and get_origin(field.annotation) is dict else 1
    key = location[:named] + tuple(part for part in location[named:] if isinstance(part, int))
    value, kind, context = error["input"], error["type"], error.get("ctx", {})
    cause = context.get("error")
    if isinstance(cause, ConfigurationError):
        return [Problem(key + inner, text) for inner, text in cause.problems]
    if kind == "default_factory_not_called":
        return []  # a default that depends on other keys, of which some are wrong
    if kind == "extra_forbidden":
        valid = table.elsewhere.get(str(key[-1])) or not_among(str(key[-1]), table.model_fields)
        return [Problem(key, f"is an unknown key (given {shown(value)}): {valid}")]
    if kind == "missing":
        return [Problem(key, "is missing: it is required")]
    if kind == "union_tag_not_found":
        return [Problem((*key, "type"), "is missing: it is required")]
    if kind == "union_tag_invalid":
        types = re.findall(r"'(\w+)'", context["expected_tags"])
        return [
            Problem((*key, "type"), f"is {context['tag']!r}: {not_among(context['tag'], types)}")
        ]
    if kind == "too_short" and len(value) > context["actual_length"]:
        return []  # pydantic counts the valid items only; the others are reported by themselves
    if kind in ("model_type", "model_attributes_type"):
        return [Problem(key, f"is {shown(value)}: it should be a table")]
    return [Problem(key, f"is {shown(value)}: it {_allowed(error)}")]


def _allowed(error: ErrorDetails) -> str:
    if "error" in error.get("ctx", {}):
        return str(error["ctx"]["error"])  # a validator's own words
    message = re.sub(r"^\w+ should", "should", error["msg"])
    if error["type"].startswith("float") and re.fullmatch(
        r"[-+.\d]+ ?[^\W\d]+", str(error["input"])
    ):
        message += ", in SI units and without their symbol"
    return (
        message.replace("tuple", "array")
        .replace("a valid boolean", "true or false")
        .replace(" after validation", "")
    )
