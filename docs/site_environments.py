"""MkDocs hook: puts what the package says of its environments in the place of lines that end with
`<!-- environment: TipPose -->`, `<!-- arguments -->`, `<!-- reset options -->`, `<!-- presets -->`,
`<!-- targets -->`, `<!-- groups -->` or `<!-- effects -->`. What stands before says in the
repository where to read it."""

import re
import warnings
from typing import Any

import griffe
import gymnasium as gym
from mkdocs.structure.pages import Page
from pydantic_core import PydanticUndefined

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
from soft_tendon_env.envs.targets import TARGETS
from soft_tendon_env.scene.scene import Quadrature
from soft_tendon_env.tools.configuration import plain

COMMENT = re.compile(
    r"^.*<!-- (?:environment: (\w+)|(arguments|reset options|presets|targets|groups|effects)) -->$",
    re.MULTILINE,
)
FIDELITIES = ("scene", *PRESETS)


def on_page_markdown(markdown: str, page: Page, **kwargs: Any) -> str:
    """Puts descriptions and tables in the place of comments. Raises KeyError for a task that does
    not exist."""
    tables = {"arguments": arguments, "reset options": reset_options, "presets": presets}
    tables |= {"targets": targets, "groups": groups, "effects": effects}
    return COMMENT.sub(
        lambda match: environment(match[1]) if match[1] else tables[match[2]](), markdown
    )


def environment(task: str) -> str:
    """Sizes of the spaces by fidelity, and the description of the task, its headings below those of
    the page's sections."""
    rows = [["fidelity", "n", "`full`", "`measurable`, s sensors", "action"], ["---"] * 5]
    for fidelity in FIDELITIES:
        full, measurable = (
            made(task, fidelity=fidelity),
            made(task, fidelity=fidelity, observation="measurable"),
        )
        sensing = made(task, fidelity=fidelity, observation="measurable", sensors=1)
        size, each = size_of(measurable), size_of(sensing) - size_of(measurable)
        count = full.unwrapped.model.coordinate_count
        rows.append(
            [
                f'`"{fidelity}"`',
                count,
                size_of(full),
                f"{size} + {each} s",
                full.action_space.shape[0],
            ]
        )
    sizes = (
        "Number of coordinates n, entries of the observation, and entries of the action, on the"
        " default arm:"
    )
    description = TASKS[task].description.strip().replace("docs/reference/environments.md", "below")
    return f"{sizes}\n\n{table(rows)}\n\n{re.sub('^## ', '### ', description, flags=re.MULTILINE)}"


def made(task: str, **options: Any) -> gym.Env[Any, Any]:
    """The environment of a task."""
    with warnings.catch_warnings(action="ignore"):  # of fidelities that are coarse
        return gym.make(IDS[task], **options)


def size_of(env: gym.Env[Any, Any]) -> int:
    """Number of entries of the flat observation."""
    space = env.observation_space
    return (space["observation"] if isinstance(space, gym.spaces.Dict) else space).shape[0]


def arguments() -> str:
    """The options with their defaults, from the docstring of `Options`."""
    rows = [["option", "default", "meaning"], ["---"] * 3]
    for name, description in attributes(Options).items():
        field = Options.model_fields[name]
        default = (
            "see right"
            if field.default_factory is not None
            else f"`{field.default!r}`"
            if name != "randomize"
            else "nothing"
        )
        rows.append([f"`{name}`", default, description])
    return table(rows)


def reset_options() -> str:
    """The options of `reset`, from the docstring of `ResetOptions`."""
    return table(
        [
            ["key", "meaning"],
            ["---"] * 2,
            *([f"`{name}`", description] for name, description in attributes(ResetOptions).items()),
        ]
    )


def attributes(configuration: type) -> dict[str, str]:
    """Descriptions of attributes by name, from the docstring of a class."""
    sections = griffe.Docstring(configuration.__doc__ or "", lineno=1).parse(
        "google", warnings=False, warn_unknown_params=False
    )
    entries = next(
        section.value
        for section in sections
        if section.kind is griffe.DocstringSectionKind.attributes
    )
    return {entry.name: entry.description.replace("\n", " ") for entry in entries}


def presets() -> str:
    """What the presets of `fidelity` ask for."""
    rows = [
        [
            "fidelity",
            "tip",
            "passive fields that ship",
            "one time step",
            "quadrature",
            "intervals at least",
        ],
        ["---"] * 6,
    ]
    for name, preset in PRESETS.items():
        shares = (preset.share, preset.fields, preset.tolerance, preset.quadrature)
        rows.append([f'`"{name}"`', *(f"{100 * share:.3g} %" for share in shares), preset.least])
    own = Quadrature()
    rows.append(
        [
            '`"scene"`, unless the scene says',
            "-",
            "-",
            "-",
            f"{100 * own.tolerance:.3g} %",
            own.least,
        ]
    )
    return table(rows)


def targets() -> str:
    """The targets that ship: their settings with defaults, and what their docstrings say."""
    rows = [["type", "settings", "motion"], ["---"] * 3]
    for name, target in sorted(TARGETS.items()):
        defaults = {
            key: field.default for key, field in target.model_fields.items() if key != "type"
        }
        settings = ", ".join(
            f"`{key}`" if value in (None, PydanticUndefined) else f"`{key}` ({value})"
            for key, value in defaults.items()
        )
        rows.append([f"`{name}`", settings, " ".join((target.__doc__ or "").split())])
    return table(rows)


def groups() -> str:
    """The observation groups: what each is, its size on the default arm, and the ready-made
    observations of the tasks that have it."""
    slices = made(
        "Shape", fidelity="fast", sensors=1, observation=tuple(GROUPS)
    ).unwrapped.episodes.layout.slices
    rows = [["group", "what", 'size at `"fast"`, one sensor', *TASKS], ["---"] * (3 + len(TASKS))]
    for name, group in GROUPS.items():
        have = [
            ", ".join(kind for kind, chosen in task.observations.items() if name in chosen)
            for task in TASKS.values()
        ]
        rows.append([f"`{name}`", group.description, slices[name].stop - slices[name].start, *have])
    return table(rows)


def effects() -> str:
    """The keys of the effects, and of the tables in them, from the descriptions of their fields."""
    tables = {f"effects.{name}": effect for name, effect in sorted(EFFECTS.items())}
    loads = {"effects.disturbance.loads": Load, "signal = pulse": Pulse, "signal = sine": Sine}
    tables |= {
        **loads,
        "effects.viscoelastic_memory.branches": Branch,
        "effects.contact.obstacles": Obstacle,
    }
    shapes = Plane, Sphere, Box, Capsule, Cylinder
    tables |= {f"type = {shape.model_fields['type'].default}": shape for shape in shapes}
    rows = [["table", "key", "default", "meaning"], ["---"] * 4]
    for name, own in tables.items():
        known = {
            "type",
            *(Obstacle.model_fields if own is not Obstacle and issubclass(own, Obstacle) else ()),
        }
        for key, field in own.model_fields.items():
            if key not in known:
                default = (
                    "required"
                    if field.is_required()
                    else "-"
                    if field.default is None
                    else f"`{plain(field.default)}`"
                )
                rows.append([f"`{name}`", f"`{key}`", default, field.description])
    return table(rows)


def table(rows: list[list[Any]]) -> str:
    """Rows of a Markdown table."""
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in rows)
