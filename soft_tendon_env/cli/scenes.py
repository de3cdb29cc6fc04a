"""`soft-tendon scenes`, `effects` and `doctor`: the scenes that ship, what a scene can have besides its tendons, and whether the
installation works."""

import importlib
import importlib.metadata
import inspect
import platform
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
from pydantic import Field

from soft_tendon_env.cli.errors import EXTRAS, Mistake, is_installed, mistakes
from soft_tendon_env.compiler.compilation import cache_folder
from soft_tendon_env.effects import EFFECTS, Effect
from soft_tendon_env.evaluation.tables import markdown_table
from soft_tendon_env.model.coordinates import make_strain
from soft_tendon_env.model.grid import at_points, make_grid
from soft_tendon_env.registration import IDS
from soft_tendon_env.scene.file import SHIPPED, load_scene, scene_names
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, not_registered
from soft_tendon_env.tools.files import read_text
from soft_tendon_env.tools.messages import first_line

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
    grid = make_grid(scene, 6)  # it does not depend on the intervals
    return make_strain(scene, grid, at_points(scene, grid)).size


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


class Doctor(Configuration):
    """Check versions, extras, kernel cache and a step of every task, which compiles its kernels. Exit status 1 if something is broken."""

    scene: str = Field(default="paper", description="a shipped scene's name, or the path of a TOML file")


def run_doctor(settings: Doctor) -> None:
    """Run all checks, and go on after one that fails."""
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "scipy", "numba", "gymnasium", "pydantic")]
    print(f"{'soft_tendon_env':<16} in {Path(__file__).parents[1]}; Python {platform.python_version()}, {', '.join(versions)}")
    print(f"{'kernel cache':<16} {cache_folder() or 'none can be written, every process compiles again: set NUMBA_CACHE_DIR'}")
    broken = []
    for name in (*EXTRAS, *IDS.values()):
        try:
            print(f"{name:<16} {import_extra(name) if name in EXTRAS else step(name, settings.scene)}", flush=True)
        except Exception as error:  # any error is named, and the other checks go on
            print(f"{name:<16} BROKEN: {first_line(error)}", flush=True)
            broken.append(name)
    print(f"broken: {', '.join(broken)}" if broken else "all is well")
    sys.exit(1 if broken else 0)


def import_extra(name: str) -> str:
    """Whether all modules of an extra can be imported, or the command that installs it. Raises what an import raises."""
    if not is_installed(name):
        return f'extra is not installed: pip install "soft_tendon_env[{name}]"'
    return f"{', '.join(importlib.import_module(module).__name__ for module in EXTRAS[name])} can be imported"


def step(id: str, scene: str) -> str:
    """One step of an environment. Raises ValueError for an observation outside of its space."""
    env = gym.make(id, scene=scene)
    env.reset(seed=0)
    observation, reward, *_ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    if not env.observation_space.contains(observation) or not np.isfinite(float(reward)):
        raise ValueError("the step gave an observation outside of its space, or a reward that is not finite")
    return "steps"
