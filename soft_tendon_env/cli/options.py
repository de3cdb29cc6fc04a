"""Command-line options of configuration classes, read by tyro: an option for every field, its help
the field's description.

tyro makes texts, numbers and switches of the words; what they may be is for the class to say, whose
errors get the names that the command line has.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from typing import Annotated, Any, Literal, TypeVar, cast, get_args, get_origin

import tyro
from pydantic import Field
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from soft_tendon_env.cli.errors import Mistake, mistakes
from soft_tendon_env.policies.agent import EnvironmentOptions
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Key,
    dotted,
    override,
    parsed_changes,
)

Kind = TypeVar("Kind", bound=Configuration)

SIMILAR = 0.75
"""Least similarity, of difflib, with which an unknown option counts as a misspelt one."""

STYLE = (
    tyro.conf.PositionalMetavarFromFieldName,
    tyro.conf.OmitArgPrefixes,
    tyro.conf.DisallowNone,
)
"""How tyro names and reads arguments: without the names of nested tables, and None is no value."""

PUBLISHED = "published"
"""Name of the file, by default, of a command that reads its values from one."""

POLICY = (
    "a controller's name; an agent's folder; ppo, sac, dagger or apg, which ship for the task;"
    " agent, the best of these; filtered: before any of them, a Kalman filter"
)
TASK = "name of the task: TipPose, Shape, Reach, or one that was registered"


class ArmSettings(Configuration):
    """The arm that a command is about."""

    scene: tyro.conf.Positional[str] = Field(
        description="a shipped scene's name, or the path of a TOML file"
    )
    set: tuple[str, ...] = Field(
        default=(),
        description="changes of the scene, such as effects.gravity.acceleration=[0,0,-9.81]",
    )

    def changed_scene(self) -> Scene:
        """The scene with the changes of --set. Raises ConfigurationError, ValueError."""
        scene = load_scene(self.scene)
        with from_set():
            if self.set:
                return scene.replace(parsed_changes(self.set))
            return scene


@contextmanager
def from_set() -> Iterator[None]:
    """Context in which mistakes are those of --set. Raises ConfigurationError."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(error.problems, "--set") from error


def environment_options(
    scene: str | None = None,
    fidelity: str | None = None,
    target: str | None = None,
    set: tuple[str, ...] = (),  # noqa: A002, the option's name
) -> dict[str, Any]:
    """Table of an environment's options. Raises Mistake.

    Args:
        scene: environment's scene: a shipped scene's name, or the path of a TOML file.
        fidelity: environment's fidelity: fast, standard, fine, scene or a length such as 1mm.
        target: environment's target: random, hold, circle, ramp, steps or out_of_reach; by default
            the task's.
        set: environment's options by dotted keys, values as in TOML: randomize.stiffness=1.1
            control_period=0.01.
    """
    table = dict[str, Any]()
    with mistakes():
        changes = parsed_changes(set)
        options = {"scene": scene, "fidelity": fidelity, "target": target}
        for name, value in options.items():
            if value is None:
                continue
            if name in changes:
                raise ValueError(f"--set has {name}, and so has --{name}: give it once")
            table[name] = value
        with from_set():
            override(table, changes)
    return table


class EnvironmentArguments(Configuration):
    """Arguments of an environment: --scene, --fidelity and --target, and others by --set."""

    options: Annotated[
        EnvironmentOptions, tyro.conf.arg(name="", constructor=environment_options)
    ] = Field(default={})


class ConfigFile(Configuration):
    """The file of a command that reads its values from one."""

    config: str = PUBLISHED


REGISTRY = ConstructorRegistry()
"""Rules of this package, before those of tyro."""


@REGISTRY.primitive_rule
def _leave_to_the_class(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Rule of tyro for numbers and choices: it refuses no word, so that the class does, in the
    words that it has for files too."""
    kind: Any = info.type
    if get_origin(kind) is Literal:
        choices = ",".join(map(str, get_args(kind)))
        metavar = "{" + choices + "}"
    elif kind in (int, float):
        metavar = kind.__name__.upper()
    else:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: _number_or_text(words[0]),
        is_instance=lambda value: value is not None,
        str_from_instance=lambda value: [str(value)],
    )


def _number_or_text(word: str) -> int | float | str:
    for number in (int, float):
        with suppress(ValueError):
            return number(word)
    return word


def read(command: str, kind: type[Kind], arguments: Sequence[str]) -> Kind:
    """The configuration that a command line says, over the values of a file where the class has
    `read_file`.

    Ends the process with help, or with status 2 where tyro refuses the arguments. Raises Mistake.
    """
    _check_once(arguments)
    before_attributes = (kind.__doc__ or "").partition("Attributes:")[0]
    about = " ".join(before_attributes.split())
    shared: dict[str, Any] = {
        "prog": f"soft-tendon {command}",
        "args": list(arguments),
        "registry": REGISTRY,
    }
    command_line = {**shared, "description": about, "config": STYLE}
    read_file: Any = getattr(kind, "read_file", None)
    if read_file is not None:
        file, _ = tyro.cli(ConfigFile, add_help=False, return_unknown_args=True, **shared)
        with mistakes():
            command_line["default"] = read_file(file.config)
    checked = _with_options_in_errors(kind, arguments)
    settings, unknown = tyro.cli(checked, return_unknown_args=True, **command_line)
    if unknown:
        _check_keys(command, kind, unknown)
        tyro.cli(checked, **command_line)  # refuses them, and says what they are like
    return cast(Kind, kind.model_construct(**dict(settings)))


def _with_options_in_errors(kind: type[Kind], arguments: Sequence[str]) -> type[Kind]:
    """The class, but it raises Mistake, with keys as the command line has them: tyro would print a
    ValueError in its own words."""

    class Checked(kind):  # type: ignore[valid-type, misc]
        def __init__(self, /, **values: Any):
            try:
                super().__init__(**values)
            except ConfigurationError as error:
                lines = []
                for key, text in error.problems:
                    line = f"{_as_given(kind, key, arguments)} {text}"
                    lines.append(line.strip())
                raise Mistake("\n".join(lines)) from error

    return Checked


def _check_once(arguments: Sequence[str]) -> None:
    """Raises Mistake for an option that is given twice, of which tyro would take the last alone."""
    seen = set[str]()
    for word in arguments:
        if not word.startswith("--"):
            continue
        name = word.partition("=")[0]
        if name in seen:
            raise Mistake(f"{name} is given twice: give it once, with all its values behind it")
        seen.add(name)


def _check_keys(command: str, kind: type[Configuration], unknown: Sequence[str]) -> None:
    """Raises Mistake for an option that is none, nor nearly one, of a command whose --set may have
    it as a key."""
    flags = {_flag(kind, name) for name in kind.model_fields}
    if "options" in kind.model_fields:
        flags |= {"--scene", "--fidelity", "--target", "--set"}
    if "--set" not in flags:
        return
    for i, word in enumerate(unknown):
        if not word.startswith("--"):
            continue
        name, _, value = word.removeprefix("--").partition("=")
        # tyro itself tells of what is nearly an option.
        flag = name.replace("_", "-")
        if get_close_matches(f"--{flag}", flags, cutoff=SIMILAR):
            continue
        if not value:
            if i + 1 < len(unknown):
                value = unknown[i + 1]
            else:
                value = "VALUE"
        key = name.replace("-", "_")
        raise Mistake(
            f"--{name} is no option of {command}: for a key of that name write --set {key}={value}"
        )


def _as_given(kind: type[Configuration], key: Key, arguments: Sequence[str]) -> str:
    """A key as the command line has it."""
    name = str(key[0])
    rest = key[1:]
    option = _flag(kind, name)
    if name == "options" and rest:
        shortcut = f"--{rest[0]}"
        words = [word.partition("=")[0] for word in arguments]
        if shortcut in words:
            option = shortcut
            rest = rest[1:]
        else:
            option = "--set"
    # A position follows its option as it is: --policies[1].
    if rest and isinstance(rest[0], str):
        separator = ": "
    else:
        separator = ""
    return f"{option}{separator}{dotted(rest)}"


def _flag(kind: type[Configuration], name: str) -> str:
    """Argument of a field, with dashes but where it is positional."""
    field = kind.model_fields[name]
    if tyro.conf.Positional in field.metadata:
        return name
    return f"--{name.replace('_', '-')}"
