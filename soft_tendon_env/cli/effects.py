"""`soft-tendon effects`: what a scene can have besides its tendons, with parameters and units."""

import inspect
import sys
from collections.abc import Sequence
from typing import Any, get_args, get_origin

from pydantic import Field

from soft_tendon_env.cli.options import Parser
from soft_tendon_env.effects import EFFECTS, Effect
from soft_tendon_env.tools.configuration import Configuration, not_among


class Effects(Configuration):
    """List the registered effects: the table of a scene that switches each on, what it does, its parameters with units, types and defaults.

    Attributes:
        name: an effect, by its table in a scene; by default all of them.
    """

    name: str | None = Field(default=None, json_schema_extra={"flag": "name"})


def run(arguments: Sequence[str]) -> None:
    """Print them."""
    parser = Parser("effects", Effects)
    name = parser.read(arguments).name
    if name is not None and name not in EFFECTS:
        parser.error(f"name is {name!r}: {not_among(name, EFFECTS)}")
    print("\n\n".join(describe_effect(key, EFFECTS[key]) for key in sorted(EFFECTS) if name in (None, key)))


def describe_effect(name: str, effect: type[Effect]) -> str:
    """Text about an effect: docstrings of its module and its class, and a line per parameter."""
    module = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "").partition("\n\n")[0]
    parameters = [
        f"  {key}: {type_name(field.annotation)}{_default(field)}: {field.description or ''}".rstrip(": ")
        for key, field in effect.model_fields.items()
    ]
    return "\n".join([f"[effects.{name}]", module, "", inspect.cleandoc(effect.__doc__ or ""), "", *parameters])


def _default(field: Any) -> str:
    if field.is_required():
        return ", required"
    return f", {'none' if field.default is None else list(field.default) if isinstance(field.default, tuple) else field.default} by default"


def type_name(annotation: Any) -> str:
    """Name of a type, as a user of TOML says it."""
    arguments = get_args(annotation)
    if get_origin(annotation) is tuple:
        length = "any number of" if arguments[-1] is Ellipsis else str(len(arguments))
        kind = type_name(arguments[0])
        return f"array of {length} numbers" if kind == "number" else "array of tables" if kind == "table" else f"array of {length}"
    if annotation in (int, float):
        return "number"
    if annotation is bool:
        return "true or false"
    if annotation is str:
        return "text"
    if arguments and all(isinstance(choice, str) for choice in arguments):
        return " or ".join(f'"{choice}"' for choice in arguments)
    named = [type_name(choice) for choice in arguments if choice is not type(None) and (isinstance(choice, type) or get_args(choice))]
    return " or ".join(dict.fromkeys(named)) or "table"
