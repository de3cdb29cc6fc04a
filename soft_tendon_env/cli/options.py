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
SHORTCUTS = {  # options in place of a field `options`, the table of an environment's options
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
    names = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    if twice := next(
        (name for name in names if names.count(name) > 1), None
    ):  # of which tyro would take the last alone
        raise Mistake(f"{twice} is given twice: give it once, with all its values behind it")
    _check_names(command, kind, arguments)
    about = " ".join((kind.__doc__ or "").partition("Attributes:")[0].split())
    given: Given = tyro.cli(
        _arguments(kind), prog=f"soft-tendon {command}", description=about, args=list(arguments)
    )
    with mistakes():
        read_file: Any = getattr(kind, "read_file", None)
        file = read_file(given) if read_file else {}
        fields = {name: field for name, field in kind.model_fields.items() if name in given}
        values = {
            **file,
            **{name: _value(_values_of(field)[0], given[name]) for name, field in fields.items()},
        }
        if "options" in kind.model_fields:
            chosen = {name: given[name] for name in given if name in SHORTCUTS and name != "set"}
            changes, table = (
                parsed_changes(given.get("set", ())),
                deepcopy(values.get("options", {})) | chosen,
            )
            if twice := next((name for name in chosen if name in changes), None):
                raise ValueError(f"--set has {twice}, and so has --{twice}: give it once")
            with from_set():
                override(table, changes)
            values |= {"options": table} if table else {}
        try:
            return kind(**values)
        except ConfigurationError as error:
            raise ValueError(
                "\n".join(
                    f"{_as_given(kind, key, given)} {text}".strip() for key, text in error.problems
                )
            ) from error


def _check_names(command: str, kind: type[Configuration], arguments: Sequence[str]) -> None:
    """Raises Mistake for an option that is none, nor nearly one, of a command whose --set may have
    it as a key."""
    known = {"--help", "-h", *(flag(kind, name) for name in kind.model_fields)}
    known |= {f"--{name}" for name in SHORTCUTS if "options" in kind.model_fields}
    for word, value in (
        zip(arguments, [*arguments[1:], "VALUE"], strict=False) if "--set" in known else ()
    ):
        name, _, own = word.removeprefix("--").partition("=")
        if word.startswith("--") and not get_close_matches(
            f"--{name.replace('_', '-')}", known, cutoff=0.75
        ):
            key = f"{name.replace('-', '_')}={own or value}"
            raise Mistake(
                f"--{name} is no option of {command}: for a key of that name write --set {key}"
            )


def _arguments(kind: type[Configuration]) -> Any:
    """Type of the table of the options that are given, for tyro."""
    table, helps = dict[str, Any](), descriptions(kind)
    for name, field in kind.model_fields.items():
        if name == "options":
            table |= {
                key: _option(str, key == "set", f"--{key}", text, "")
                for key, text in SHORTCUTS.items()
            }
        elif not is_table(field):
            option = _option(
                *_values_of(field), flag(kind, name), helps.get(name, ""), _default(field)
            )
            table[name] = Required[option] if field.is_required() else option
    return TypedDict(kind.__name__, table, total=False)  # type: ignore[operator]


def _option(kind: Any, several: bool, flag: str, text: str, default: str) -> Any:
    """An option, or an argument without dashes. All but switches come as texts, of which `_value`
    makes numbers."""
    annotation: Any = bool if kind is bool else tuple[str, ...] if several else str
    if not flag.startswith("--"):
        about = tyro.conf.arg(metavar=flag.upper(), help=text, help_behavior_hint=default)
        return tyro.conf.Positional[Annotated[annotation, about]]  # type: ignore[misc]
    shown = (
        "{" + ",".join(map(str, get_args(kind))) + "}"
        if get_origin(kind) is Literal
        else kind.__name__.upper()
    )
    metavar = None if kind is bool else f"[{shown} [{shown} ...]]" if several else shown
    return Annotated[
        annotation,
        tyro.conf.arg(
            name=flag.removeprefix("--"), metavar=metavar, help=text, help_behavior_hint=default
        ),
    ]


def _value(kind: Any, given: Any) -> Any:
    """The value of an option, with texts that are numbers as such, unless it is of texts; the class
    itself refuses others."""
    if isinstance(given, tuple):
        return tuple(_value(kind, text) for text in given)
    for number in (int, float) if isinstance(given, str) and kind is not str else ():
        with suppress(ValueError):
            return number(given)
    return given


def _values_of(field: FieldInfo) -> tuple[Any, bool]:
    """Type of the values of an option, without None and bounds, and whether it takes several."""
    choices = get_args(field.annotation)
    kind = choices[0] if choices[1:] in ((types.NoneType,), (...,)) else field.annotation
    return (get_args(kind)[0] if get_origin(kind) is Annotated else kind), choices[1:] == (...,)


def _as_given(kind: type[Configuration], key: Key, given: Given) -> str:
    """A key as the command line has it."""
    option, rest = flag(kind, str(key[0])), key[1:]
    if key[0] == "options" and rest:
        option, rest = (f"--{rest[0]}", rest[1:]) if rest[0] in given else ("--set", rest)
    return (
        f"{option}: {dotted(rest)}"
        if rest and isinstance(rest[0], str)
        else f"{option}{dotted(rest)}"
    )


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
    texts = [
        text
        for base in reversed(kind.__mro__)
        for text in docstring_parser.parse(base.__doc__ or "").params
    ]
    listed = {
        text.arg_name: " ".join((text.description or "").split()).rstrip(".") for text in texts
    }
    return listed | {
        name: field.description for name, field in kind.model_fields.items() if field.description
    }


def is_table(field: FieldInfo) -> bool:
    """Whether a field is a table or an array of tables, which has no option."""
    members = get_args(field.annotation)[:1]
    return get_origin(field.annotation) is dict or any(
        isinstance(kind, type) and issubclass(kind, Configuration) for kind in members
    )


def _default(field: FieldInfo) -> str:
    value = field.get_default(call_default_factory=True, validated_data={})
    if field.is_required() or value is None or value == ():
        return "(required)" if field.is_required() else ""
    return f"(default: {' '.join(map(str, value)) if isinstance(value, tuple) else value})"
