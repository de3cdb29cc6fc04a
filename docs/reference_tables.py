"""Tables of the reference, from the package itself: options, spaces, targets, observation groups,
rewards, presets, effects, keys of a scene.

    python docs/reference_tables.py [--out out/reference]

Each table is a Markdown file, which docs/generated.py brings into its page. A test compares the
pages with the tables of the present code.
"""

import argparse
import inspect
import re
import sys
import types
import typing
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import gymnasium as gym
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from source_comments import comments_of_fields

from soft_tendon_env.accuracy.fidelity import PRESETS
from soft_tendon_env.effects import EFFECTS
from soft_tendon_env.effects.contact.obstacles import (
    Box,
    Capsule,
    Cylinder,
    Obstacle,
    Plane,
    Sphere,
)
from soft_tendon_env.effects.loads import Load, Pulse, Sine
from soft_tendon_env.effects.material import Branch
from soft_tendon_env.envs import IDS, TASKS, Options, ResetOptions
from soft_tendon_env.envs.observation import GROUPS
from soft_tendon_env.envs.targets import TARGETS, Target
from soft_tendon_env.envs.targets.shipped import Hold
from soft_tendon_env.envs.tracking import ERRORS
from soft_tendon_env.model.state import State
from soft_tendon_env.scene.routing import ROUTINGS, TAPERS, Taper
from soft_tendon_env.scene.scene import Base, Integrator, Quadrature, Segment, Tendon
from soft_tendon_env.scene.sections import SECTIONS, Discs
from soft_tendon_env.scene.strain import PARAMETRISATIONS, Modes, Snapshots
from soft_tendon_env.tools.configuration import plain

FIDELITIES = ("scene", *PRESETS)
UNIT = re.compile(r"\[(-|1/m|[A-Za-z][\w/^ ().]*)\]")
"""A unit in a description, such as [N/s]; [-1, 1] is none."""
ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)
"""An entry of the section "Attributes" of a docstring, with its lines."""
TYPES: Mapping[Any, str] = {
    bool: "bool",
    int: "integer",
    float: "number",
    str: "text",
    dict: "table",
    State: "`State`",
    Taper: "taper",
    Target: "name, table or `Target`",
    Hold: "3 numbers or 4 x 4",
}
"""Words for types of keys; other classes are tables."""
SHAPES = (Plane, Sphere, Box, Capsule, Cylinder)


def environment(task: str) -> str:
    """Sizes of the spaces of a task by fidelity, and its description, below a page's sections."""
    rows = [["fidelity", "n", "`full`", "`measurable`, s sensors", "action"]]
    for fidelity in FIDELITIES:
        full = made(task, fidelity=fidelity)
        measurable = size_of(made(task, fidelity=fidelity, observation="measurable"))
        sensing = size_of(made(task, fidelity=fidelity, observation="measurable", sensors=1))
        count = full.unwrapped.model.coordinate_count
        sensed = f"{measurable} + {sensing - measurable} s"
        rows.append([f'`"{fidelity}"`', count, size_of(full), sensed, full.action_space.shape[0]])
    sizes = (
        "Number of coordinates n, entries of the observation, and entries of the action, on the"
        " default arm:"
    )
    description = TASKS[task].description.strip().replace("docs/reference/environments.md", "below")
    lowered = re.sub("^## (.*)\n", r"### \1\n\n", description, flags=re.MULTILINE)
    return f"{sizes}\n\n{table(rows)}\n\n{lowered}"


def made(task: str, **options: Any) -> gym.Env[Any, Any]:
    """The environment of a task."""
    with warnings.catch_warnings(action="ignore"):  # of fidelities that are coarse
        return gym.make(IDS[task], **options)


def size_of(env: gym.Env[Any, Any]) -> int:
    """Number of entries of the flat observation."""
    space = env.observation_space
    return (space["observation"] if isinstance(space, gym.spaces.Dict) else space).shape[0]


def arguments() -> str:
    """The options, from the docstring of `Options`."""
    return keys(Options, "option")


def reset_options() -> str:
    """The options of `reset`, from the docstring of `ResetOptions`."""
    return keys(ResetOptions, "key")


def keys(configuration: type[BaseModel], heading: str) -> str:
    """Keys of a configuration: type, unit, default and meaning of each."""
    meanings = {
        name: " ".join(lines.split())
        for name, lines in ATTRIBUTE.findall(inspect.cleandoc(configuration.__doc__ or ""))
    }
    rows: list[Sequence[Any]] = [[heading, "type", "unit", "default", "meaning"]]
    for name, field in configuration.model_fields.items():
        meaning = meanings[name]
        rows.append([f"`{name}`", type_of(field), unit_of(meaning), default_of(field), meaning])
    return table(rows)


def type_of(field: FieldInfo) -> str:
    """Type of a key in words."""
    return type_words(field.annotation)


def type_words(annotation: Any) -> str:
    """An annotation in words: `tuple[float, float]` is "2 numbers"."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is typing.Annotated:
        return type_words(parts[0])
    if origin is Literal:
        return ", ".join(f'`"{part}"`' for part in parts)
    if origin in (typing.Union, types.UnionType):
        words = [type_words(part) for part in parts if part is not types.NoneType]
        return " or ".join(dict.fromkeys(words))
    if origin is tuple:
        is_choice = get_origin(parts[0]) is Literal
        element = "names" if is_choice else f"{type_words(parts[0])}s".replace("texts", "names")
        is_open = parts[-1] is Ellipsis
        return f"list of {element}" if is_open else f"{len(parts)} {element}"
    return TYPES.get(origin or annotation, "table")


def unit_of(meaning: str) -> str:
    """Units that a description names; empty without any."""
    return ", ".join(dict.fromkeys(UNIT.findall(meaning)))


def default_of(field: FieldInfo) -> str:
    """Default of a key; "-" for None."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={"control_period": 0.02})
    if value is None:
        return "-"
    if isinstance(value, BaseModel):
        return "nothing"
    return f"`{plain(value)}`"


def presets() -> str:
    """What the presets of `fidelity` ask for."""
    heading = ["fidelity", "tip", "passive fields that ship", "one time step", "quadrature"]
    rows: list[Sequence[Any]] = [[*heading, "intervals at least"]]
    for name, preset in PRESETS.items():
        shares = (preset.share, preset.fields, preset.tolerance, preset.quadrature)
        rows.append([f'`"{name}"`', *(f"{100 * share:.3g} %" for share in shares), preset.least])
    own = Quadrature()
    of_scene = '`"scene"`, unless the scene says'
    rows.append([of_scene, "-", "-", "-", f"{100 * own.tolerance:.3g} %", own.least])
    return table(rows)


def targets() -> str:
    """The targets that ship: their settings with defaults, and what their docstrings say."""
    rows: list[Sequence[Any]] = [["type", "settings (default)", "motion"]]
    for name, target in sorted(TARGETS.items()):
        settings = []
        for key, field in target.model_fields.items():
            if key == "type":
                continue
            is_open = field.default in (None, PydanticUndefined)
            settings.append(f"`{key}`" if is_open else f"`{key}` ({plain(field.default)})")
        rows.append([f"`{name}`", ", ".join(settings), " ".join((target.__doc__ or "").split())])
    return table(rows)


def groups() -> str:
    """The observation groups: what each is, its size on the default arm, and the ready-made
    observations of the tasks that have it."""
    every = made("Shape", fidelity="fast", sensors=1, observation=tuple(GROUPS))
    slices = every.unwrapped.episodes.layout.slices
    rows: list[Sequence[Any]] = [["group", "what", 'size at `"fast"`, one sensor', *TASKS]]
    for name, group in GROUPS.items():
        choices = []
        for task in TASKS.values():
            choices.append(
                ", ".join(k for k, chosen in task.observations.items() if name in chosen)
            )
        size = slices[name].stop - slices[name].start
        rows.append([f"`{name}`", group.description, size, *choices])
    return table(rows)


def rewards() -> str:
    """The reward terms of errors: scales, and default weights by task."""
    tasks = {name: task for name, task in TASKS.items() if task.goal is None}
    rows: list[Sequence[Any]] = [["term", "falls with", "scales", *tasks]]
    for error in ERRORS:
        for name, term in error.terms.items():
            unit = " lengths of the rod" if term.of_length else ""
            scales = ", ".join(f"{scale:g}" for scale in term.scale)
            weights = []
            for task in tasks.values():
                weights.append(f"{task.reward.get(name, 0.0):g}" if name in task.terms else "-")
            rows.append([f"`{name}`", error.description, f"{scales}{unit}", *weights])
    return table(rows)


def effects() -> str:
    """The keys of the effects, and of the tables in them, from the descriptions of their fields."""
    tables: dict[str, type[BaseModel]] = {}
    for name, effect in sorted(EFFECTS.items()):
        tables[f"effects.{name}"] = effect
    tables["effects.disturbance.loads"] = Load
    tables["signal = pulse"] = Pulse
    tables["signal = sine"] = Sine
    tables["effects.viscoelastic_memory.branches"] = Branch
    tables["effects.contact.obstacles"] = Obstacle
    for shape in SHAPES:
        tables[f"type = {shape.model_fields['type'].default}"] = shape
    rows: list[Sequence[Any]] = [["table", "key", "type", "unit", "default", "meaning"]]
    for name, own in tables.items():
        inherited = Obstacle.model_fields if own in SHAPES else {}
        for key, field in own.model_fields.items():
            if key == "type" or key in inherited:
                continue
            meaning = field.description or ""
            cells = [type_of(field), unit_of(meaning), default_of(field), meaning]
            rows.append([f"`{name}`", f"`{key}`", *cells])
    return table(rows)


def scene_keys() -> str:
    """The keys of a scene but those of its effects, from the comments beside their fields."""
    tables: dict[str, type[BaseModel]] = {
        "[[segments]]": Segment,
        "discs": Discs,
        **_of_registry("section", SECTIONS),
        "[[tendons]]": Tendon,
        **_of_registry("routing", ROUTINGS),
        **_of_registry("taper of a size", TAPERS),
        "[base]": Base,
        **_of_registry("[strain]", PARAMETRISATIONS),
        "passive, modes": Modes,
        "passive, type = snapshots": Snapshots,
        "[quadrature]": Quadrature,
        "[integrator]": Integrator,
    }
    rows: list[Sequence[Any]] = [["table", "key", "type", "unit", "default", "meaning"]]
    for name, own in tables.items():
        comments = comments_of_fields(own)
        for key, field in own.model_fields.items():
            if key == "type":
                continue
            meaning = comments[key]
            cells = [type_of(field), unit_of(meaning), default_of(field), meaning]
            rows.append([f"`{name}`", f"`{key}`", *cells])
    return table(rows)


def _of_registry(name: str, kinds: Mapping[str, type[BaseModel]]) -> dict[str, type[BaseModel]]:
    """Classes that ship, by the name of their table and their type."""
    return {
        f"{name}, type = {kind}": kinds[kind]
        for kind in sorted(kinds)
        if kinds[kind].__module__.startswith("soft_tendon_env.")
    }


def table(rows: Sequence[Sequence[Any]]) -> str:
    """Rows of a Markdown table, the heading first."""
    lines = [f"| {' | '.join(map(str, row))} |" for row in rows]
    lines.insert(1, f"|{'|'.join(['---'] * len(rows[0]))}|")
    return "\n".join(lines)


TABLES: Mapping[str, Callable[[], str]] = {
    "environment TipPose": lambda: environment("TipPose"),
    "environment Shape": lambda: environment("Shape"),
    "environment Reach": lambda: environment("Reach"),
    "arguments": arguments,
    "presets": presets,
    "reset options": reset_options,
    "targets": targets,
    "observation groups": groups,
    "reward terms": rewards,
    "effects": effects,
    "scene keys": scene_keys,
}
"""Tables by the name of their block in a page."""


def main() -> None:
    """Write all tables into a folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/reference"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for name, make in TABLES.items():
        path = out / f"{name.replace(' ', '_')}.md"
        path.write_text(f"{make()}\n", encoding="utf-8")
        print(f"written: {path}")


if __name__ == "__main__":
    try:
        main()
    except OSError as error:
        sys.exit(str(error))
