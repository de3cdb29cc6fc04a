"""`soft-tendon scenes` and `soft-tendon effects`: the scenes that ship, and what a scene can have besides its tendons."""

import inspect
import sys
from pathlib import Path

from pydantic import Field

from soft_tendon_env.cli.errors import Mistake, mistakes
from soft_tendon_env.effects import EFFECTS, Effect
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.model.coordinates import make_strain
from soft_tendon_env.model.grid import make_grid
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, not_registered
from soft_tendon_env.tools.files import read_text

INTERVALS = 6  # of a piece of the rod: how many coordinates there are does not depend on them
NAME = "a scene that ships, or the path of a TOML file; by default a table of those that ship"


class Scenes(Configuration):
    """List the scenes that ship, with tendons and coordinates; of one, print the TOML, which is a commented example of the format."""

    name: str | None = Field(default=None, description=NAME, json_schema_extra={"flag": "name"})


class Effects(Configuration):
    """List the registered effects: the table of a scene that switches each on, what it does, its parameters with units and defaults."""

    name: str | None = Field(default=None, description="by default all of them", json_schema_extra={"flag": "name"})


def run_scenes(settings: Scenes) -> None:
    """Print the table, or the file."""
    if settings.name is None:
        shipped = map(load_scene, scene_names())
        rows = [(scene.name, str(len(scene.tendons)), str(coordinate_count(scene)), scene.description) for scene in shipped]
        print(markdown_table(("scene", "tendons", "coordinates", "what it is"), rows))
        return
    with mistakes():
        load_scene(settings.name)
        print(read_text(Path(settings.name) if settings.name.endswith(".toml") else SHIPPED / f"{settings.name}.toml"), end="")


def coordinate_count(scene: Scene) -> int:
    """How many coordinates the strain of a scene has."""
    return make_strain(scene, make_grid(scene, INTERVALS)).size


def run_effects(settings: Effects) -> None:
    """Print them."""
    name = settings.name
    if name is not None and name not in EFFECTS:
        raise Mistake(f"name is {name!r}: {not_registered(name, EFFECTS)}")
    print("\n\n".join(describe_effect(key, EFFECTS[key]) for key in sorted(EFFECTS) if name in (None, key)))


def describe_effect(name: str, effect: type[Effect]) -> str:
    """Text about an effect: docstrings of its module and its class, and a line per parameter with its default and description."""
    module = inspect.cleandoc(sys.modules[effect.__module__].__doc__ or "").partition("\n\n")[0]
    lines = [f"[effects.{name}]", module, "", inspect.cleandoc(effect.__doc__ or ""), ""]
    for key, field in effect.model_fields.items():
        value = list(field.default) if isinstance(field.default, tuple) else field.default
        default = "required" if field.is_required() else f"{'none' if value is None else value} by default"
        lines.append(f"  {key}: {default}" + (f"; {field.description}" if field.description else ""))
    return "\n".join(lines)
