"""`soft-tendon effects`: what a scene can have besides its tendons, with parameters and units."""

import inspect
import sys

from pydantic import Field

from soft_tendon_env.cli.errors import Mistake
from soft_tendon_env.effects import EFFECTS, Effect
from soft_tendon_env.tools.configuration import Configuration, not_registered


class Effects(Configuration):
    """List the registered effects: the table of a scene that switches each on, what it does, its
    parameters with units and defaults."""

    name: str | None = Field(
        default=None, description="by default all of them", json_schema_extra={"flag": "name"}
    )


def run(settings: Effects) -> None:
    """Print them."""
    name = settings.name
    if name is not None and name not in EFFECTS:
        raise Mistake(f"name is {name!r}: {not_registered(name, EFFECTS)}")
    print(
        "\n\n".join(
            describe_effect(key, EFFECTS[key]) for key in sorted(EFFECTS) if name in (None, key)
        )
    )


def describe_effect(name: str, effect: type[Effect]) -> str:
    """Text about an effect: docstrings of its module and its class, and a line per parameter with
    its default and description."""
    module = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "").partition("\n\n")[0]
    lines = [f"[effects.{name}]", module, "", inspect.cleandoc(effect.__doc__ or ""), ""]
    for key, field in effect.model_fields.items():
        value = list(field.default) if isinstance(field.default, tuple) else field.default
        default = (
            "required"
            if field.is_required()
            else f"{'none' if value is None else value} by default"
        )
        lines.append(
            f"  {key}: {default}" + (f"; {field.description}" if field.description else "")
        )
    return "\n".join(lines)
