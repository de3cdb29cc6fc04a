"""Command-line options out of configuration classes, by tyro: an option for every field, its help
the field's description.

Options that are not given are left to a file, or to the class's defaults. What the class refuses is
named as the command line has it.
"""

import types
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from difflib import get_close_matches
from typing import Annotated, Any, Literal, Required, TypedDict, TypeVar, get_args, get_origin

import docstring_parser
import tyro
from pydantic import Field
from pydantic.fields import FieldInfo

from soft_tendon_env.cli.errors import Mistake, mistakes
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
Given = Mapping[str, Any]

SIMILAR = 0.75
"""Least similarity, of difflib, with which an unknown option counts as a misspelt one."""

SHORTCUTS = {
    "scene": "environment's scene: a shipped scene's name, or the path of a TOML file",
    "fidelity": "environment's fidelity: fast, standard, fine, scene or a length such as 1mm",
    "target": (
        "environment's target: random, hold, circle, ramp, steps or out_of_reach; by default the"
        " task's"
    ),
    "set": (
        "environment's options by dotted keys, values as in TOML: randomize.stiffness=1.1"
        " control_period=0.01"
    ),
}
"""Options in place of a field `options`, the table of an environment's options."""

POLICY = (
    "a controller's name; an agent's folder; ppo, sac, dagger or apg, which ship for the task;"
    " agent, the best of these"
)
TASK = "name of the task: TipPose, Shape, Reach, or one that was registered"


class ArmSettings(Configuration):
    """The arm that a command is about."""

    scene: str = Field(description="a shipped scene's name, or the path of a TOML file")
    set: tuple[str, ...] = Field(
        default=(),
        description="changes of the scene, such as effects.gravity.acceleration=[0,0,-9.81]",
    )

    def changed_scene(self) -> Scene:
        """The scene with the changes of --set. Raises ConfigurationError, ValueError."""
        scene = load_scene(self.scene)
        with from_set():
            return scene.replace(parsed_changes(self.set)) if self.set else scene


@contextmanager
def from_set() -> Iterator[None]:
    """Context in which mistakes are those of --set. Raises ConfigurationError."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(error.problems, "--set") from error


def read(command: str, kind: type[Kind], arguments: Sequence[str]) -> Kind:
    """The configuration that a command line says; `kind.read_file`, if there is one, reads values
    that the options given override. Ends the process with help, or with status 2 where tyro refuses
    the arguments. Raises Mistake."""
    _check_once(arguments)
    _check_names(command, kind, arguments)
    about = " ".join((kind.__doc__ or "").partition("Attributes:")[0].split())
    given: Given = tyro.cli(
        _arguments(kind), prog=f"soft-tendon {command}", description=about, args=list(arguments)
    )
    with mistakes():
        read_file: Any = getattr(kind, "read_file", None)
        values = dict(read_file(given)) if read_file else {}
        for name, field in kind.model_fields.items():
            if name in given:
                value_kind, _ = _values_of(field)
                values[name] = _value(value_kind, given[name])
        if "options" in kind.model_fields:
            options = _environment_options(values.get("options", {}), given)
            if options:
                values["options"] = options
        try:
            return kind(**values)
        except ConfigurationError as error:
            lines = [
                f"{_as_given(kind, key, given)} {text}".strip() for key, text in error.problems
            ]
            raise ValueError("\n".join(lines)) from error


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


def _check_names(command: str, kind: type[Configuration], arguments: Sequence[str]) -> None:
    """Raises Mistake for an option that is none, nor nearly one, of a command whose --set may have
    it as a key."""
    known = {"--help", "-h"}
    known |= {flag(kind, name) for name in kind.model_fields}
    if "options" in kind.model_fields:
        known |= {f"--{name}" for name in SHORTCUTS}
    if "--set" not in known:
        return
    for i, word in enumerate(arguments):
        if not word.startswith("--"):
            continue
        name, _, value = word.removeprefix("--").partition("=")
        # tyro itself tells of what is nearly an option.
        if get_close_matches(f"--{name.replace('_', '-')}", known, cutoff=SIMILAR):
            continue
        if not value:
            value = arguments[i + 1] if i + 1 < len(arguments) else "VALUE"
        key = name.replace("-", "_")
        raise Mistake(
            f"--{name} is no option of {command}: for a key of that name write --set {key}={value}"
        )


def _environment_options(of_file: Given, given: Given) -> dict[str, Any]:
    """The table `options` of an environment: a file's, with the options that are given and the
    changes of --set. Raises ValueError, ConfigurationError."""
    table = deepcopy(dict(of_file))
    changes = parsed_changes(given.get("set", ()))
    for name in SHORTCUTS:
        if name == "set" or name not in given:
            continue
        if name in changes:
            raise ValueError(f"--set has {name}, and so has --{name}: give it once")
        table[name] = given[name]
    with from_set():
        override(table, changes)
    return table


def _arguments(kind: type[Configuration]) -> Any:
    """Type of the table of the options that are given, for tyro."""
    table = dict[str, Any]()
    texts = descriptions(kind)
    for name, field in kind.model_fields.items():
        if name == "options":
            for key, text in SHORTCUTS.items():
                table[key] = _option(str, key == "set", f"--{key}", text, "")
        elif not is_table(field):
            value_kind, several = _values_of(field)
            text = texts.get(name, "")
            option = _option(value_kind, several, flag(kind, name), text, _default(field))
            table[name] = Required[option] if field.is_required() else option
    return TypedDict(kind.__name__, table, total=False)  # type: ignore[operator]


def _option(kind: Any, several: bool, flag: str, text: str, default: str) -> Any:
    """An option, or an argument without dashes. All but switches come as texts, of which `_value`
    makes numbers."""
    annotation: Any = str
    if kind is bool:
        annotation = bool
    elif several:
        annotation = tuple[str, ...]
    if not flag.startswith("--"):
        about = tyro.conf.arg(metavar=flag.upper(), help=text, help_behavior_hint=default)
        return tyro.conf.Positional[Annotated[annotation, about]]  # type: ignore[misc]
    name = flag.removeprefix("--")
    metavar = _metavar(kind, several)
    about = tyro.conf.arg(name=name, metavar=metavar, help=text, help_behavior_hint=default)
    return Annotated[annotation, about]


def _metavar(kind: Any, several: bool) -> str | None:
    """Placeholder of the value in the help of an option; None for a switch, which has none."""
    if kind is bool:
        return None
    if get_origin(kind) is Literal:
        value = "{" + ",".join(map(str, get_args(kind))) + "}"
    else:
        value = kind.__name__.upper()
    return f"[{value} [{value} ...]]" if several else value


def _value(kind: Any, given: Any) -> Any:
    """The value of an option, with texts that are numbers as such, unless it is of texts; the class
    itself refuses others."""
    if isinstance(given, tuple):
        return tuple(_value(kind, text) for text in given)
    if not isinstance(given, str) or kind is str:
        return given
    for number in (int, float):
        with suppress(ValueError):
            return number(given)
    return given


def _values_of(field: FieldInfo) -> tuple[Any, bool]:
    """Type of the values of an option, without None and bounds, and whether it takes several."""
    first, *others = get_args(field.annotation) or (None,)
    several = others == [...]  # tuple[kind, ...]
    is_optional = others == [types.NoneType]  # kind | None
    kind = first if several or is_optional else field.annotation
    if get_origin(kind) is Annotated:  # with bounds
        kind = get_args(kind)[0]
    return kind, several


def _as_given(kind: type[Configuration], key: Key, given: Given) -> str:
    """A key as the command line has it."""
    name, rest = str(key[0]), key[1:]
    option = flag(kind, name)
    if name == "options" and rest:
        if rest[0] in given:
            option = f"--{rest[0]}"
            rest = rest[1:]
        else:
            option = "--set"
    # A position follows its option as it is: --policies[1].
    separator = ": " if rest and isinstance(rest[0], str) else ""
    return f"{option}{separator}{dotted(rest)}"


def flag(kind: type[Configuration], name: str) -> str:
    """Option of a field; a field that is required is an argument without dashes. json_schema_extra
    = {"flag": ...} says another."""
    field = kind.model_fields[name]
    if isinstance(field.json_schema_extra, dict):
        return str(field.json_schema_extra["flag"])
    return name if field.is_required() and not is_table(field) else f"--{name.replace('_', '-')}"


def descriptions(kind: type[Configuration]) -> dict[str, str]:
    """Description of every field, or its text in the sections "Attributes:" of a class and its
    bases."""
    texts = dict[str, str]()
    for base in reversed(kind.__mro__):
        for attribute in docstring_parser.parse(base.__doc__ or "").params:
            words = (attribute.description or "").split()
            texts[attribute.arg_name] = " ".join(words).rstrip(".")
    for name, field in kind.model_fields.items():
        if field.description:
            texts[name] = field.description
    return texts


def is_table(field: FieldInfo) -> bool:
    """Whether a field is a table or an array of tables, which has no option."""
    members = get_args(field.annotation)[:1]
    return get_origin(field.annotation) is dict or any(
        isinstance(kind, type) and issubclass(kind, Configuration) for kind in members
    )


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "(required)"
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is None or value == ():
        return ""
    text = " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return f"(default: {text})"
