"""`soft-tendon effects`: what a scene can have besides its tendons, with parameters and units."""

import inspect
import sys

from pydantic import Field
from pydantic.fields import FieldInfo
from tyro.conf import Positional

from soft_tendon_env.cli.errors import Mistake
from soft_tendon_env.effects import EFFECTS, Effect
from soft_tendon_env.tools.configuration import Configuration, not_registered


class Effects(Configuration):
    """List the registered effects: the table of a scene that switches each on, what it does, its
    parameters with units and defaults."""

    name: Positional[str | None] = Field(default=None, description="by default all of them")


def run(settings: Effects) -> None:
    """Print them."""
    names = sorted(EFFECTS)
    if settings.name is not None:
        if settings.name not in EFFECTS:
            hint = not_registered(settings.name, EFFECTS)
            raise Mistake(f"name is {settings.name!r}: {hint}")
        names = [settings.name]
    descriptions = (describe_effect(name, EFFECTS[name]) for name in names)
    print("\n\n".join(descriptions))


def describe_effect(name: str, effect: type[Effect]) -> str:
    """Text about an effect: docstrings of its module and its class, and a line per parameter with
    its default and description."""
    documentation = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "")
    module = documentation.partition("\n\n")[0]
    description = inspect.cleandoc(effect.__doc__ or "")
    lines = [f"[effects.{name}]", module, "", description, ""]
    for key, field in effect.model_fields.items():
        line = f"  {key}: {_default_of(field)}"
        if field.description:
            line += f"; {field.description}"
        lines.append(line)
    return "\n".join(lines)


def _default_of(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is None:
        return "none by default"
    if isinstance(value, tuple):  # as TOML has it
        value = list(value)
    return f"{value} by default"
