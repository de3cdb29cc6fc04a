"""Command-line options out of configuration classes: one option per field, its help from the class's docstring, its checks the class's.

Options that are not given are left to a file, or to the class's defaults. A mistake is a line that names the option and what is allowed.
"""

import argparse
import inspect
import re
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from typing import Annotated, Any, Generic, Literal, NoReturn, TypeVar, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from soft_tendon_env.cli.errors import MISTAKES
from soft_tendon_env.tools import configuration as config
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, dotted
from soft_tendon_env.tools.files import parse_json
from soft_tendon_env.tools.messages import describe

Kind = TypeVar("Kind", bound=Configuration)
Given = Mapping[str, Any]
SHORTCUTS = {
    "scene": "environment's scene: a shipped scene's name, or the path of a TOML file",
    "fidelity": "environment's fidelity: fast, standard, fine, scene or a length such as 1mm; standard where the scene names none",
    "target": "environment's target: random, hold, circle or ramp; by default the task's (one with settings: --options, --set)",
}
"""Options of environments that have an option of their own beside --options."""
SET = "environment's options by dotted keys, values as in TOML: randomize.stiffness=1.1 control_period=0.01; overrides --options"
METAVARS = {"config": "FILE", "write_docs": "FILE", "input": "FILE", "out": "PATH", "set": "KEY=VALUE", "within": "LENGTH"}
METAVARS |= {"cluster": "ADDRESS", "storage": "URL", "markers": "FILE", "noise": "LENGTH", "parameters": "KEY", "held_out": "WHICH"}
"""Names of values in help, where they are not the option's own."""
NUMBERS = {int: "N", float: "NUMBER"}


class Once(argparse.Action):
    """Store one value; an option that is given again is a mistake, where argparse would take the last without a word."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, value: Any, option: str | None = None) -> None:
        if option is not None and hasattr(namespace, self.dest):
            parser.error(f"{option} is given twice, with {getattr(namespace, self.dest)} and {value}")
        setattr(namespace, self.dest, value)


class Parser(argparse.ArgumentParser, Generic[Kind]):
    """Parser of one command, described by its configuration class's docstring; errors are one line, without the usage."""

    def __init__(self, command: str, kind: type[Kind]) -> None:
        description = " ".join((kind.__doc__ or "").partition("Attributes:")[0].split())
        super().__init__(f"soft-tendon {command}", description=description, allow_abbrev=False, argument_default=argparse.SUPPRESS)
        self.kind = kind

    def error(self, message: str) -> NoReturn:
        for line in message.splitlines():
            print(f"{self.prog}: error: {line}", file=sys.stderr)
        sys.exit(2)

    @contextmanager
    def mistakes(self) -> Iterator[None]:
        """Ends the process with status 2, and a line for each mistake, where options, files or folders cannot be used."""
        try:
            yield
        except MISTAKES as error:
            self.error(describe(error))

    def read(self, arguments: Sequence[str], file: Callable[[Given], Given] = lambda given: {}) -> Kind:
        """The configuration that a command line says; `file` reads the values that a file has, which the options given override."""
        self._add_options()
        namespace, odd = self.parse_known_args(arguments)
        if odd:
            unknown = f"{odd[0]} is no option: {config.not_among(odd[0], self._option_string_actions)}"
            self.error(unknown if odd[0].startswith("-") else f"unrecognized arguments: {' '.join(odd)}")
        given = vars(namespace)
        with self.mistakes():
            return configure(self.kind, given, file(given))

    def _add_options(self) -> None:
        """Add an option for every field but arrays of tables, with the fields' own defaults in the help."""
        helps = attribute_texts(self.kind)
        for name, field in self.kind.model_fields.items():
            text = helps.get(name, "").replace("%", "%%")  # argparse fills in what stands behind one alone
            option, element = flag(self.kind, name), _element(field.annotation)
            if name == "options":
                for shortcut, words in SHORTCUTS.items():
                    self.add_argument(flag(self.kind, shortcut), action=Once, metavar=shortcut.upper(), help=words)
                self.add_argument("--set", action="extend", nargs="+", metavar=METAVARS["set"], help=SET)
            if not option.startswith("-"):
                self.add_argument(name, nargs="+" if element else None if field.is_required() else "?", help=text)
            elif field.annotation is bool:
                how, text = ("store_false", f"do not {text}") if field.default else ("store_true", text)
                self.add_argument(option, dest=name, action=how, help=text)
            elif not is_table(field):
                several: dict[str, Any] = {"action": "extend", "nargs": "+"} if element else {"action": Once}
                metavar, default = _metavar(name, element or field.annotation), _default(field).replace("%", "%%")
                self.add_argument(option, dest=name, metavar=metavar, help=text + default, **several)


def configure(kind: type[Kind], given: Given, file: Given) -> Kind:
    """The configuration of what was given, which overrides what stands in a file. Raises ConfigurationError, ValueError."""
    fields, origin = kind.model_fields, dict[str, str]()
    values = {name: _read(value, fields[name].annotation) for name, value in given.items() if name in fields}
    if "options" in fields:
        options, origin = _environment_options(given, values.get("options", {}), file.get("options", {}))
        values |= {"options": options} if options else {}
    try:
        return kind(**{**file, **values})
    except ConfigurationError as error:
        raise ValueError("\n".join(f"{_as_given(kind, key, origin)} {text}".strip() for key, text in error.problems)) from error


def _environment_options(given: Given, options: Given, file: Given) -> tuple[dict[str, Any], dict[str, str]]:
    """Options of the environment out of a file, --options, the shortcuts and --set; and by dotted key which of these it was."""
    own, changes = {name: given[name] for name in SHORTCUTS if name in given}, config.parsed_changes(given.get("set", ()))
    for source, keys in (("--options", options.keys()), ("--set", changes.keys())):
        if twice := sorted(own.keys() & keys):
            raise ValueError(f"{source} has {', '.join(twice)}, and so has --{twice[0]}: give it once")
    table = deepcopy({**file, **options, **own})
    try:
        config.override(table, changes)
    except ConfigurationError as error:
        raise ValueError("\n".join(f"--set: {dotted(key)} {text}" for key, text in error.problems)) from error
    return table, {**{name: f"--{name}" for name in own}, **dict.fromkeys(changes, "--set")}


def _as_given(kind: type[Configuration], key: config.Key, origin: Mapping[str, str]) -> str:
    """A key as the command line has it."""
    option, rest = flag(kind, str(key[0])), key[1:]
    if key[0] == "options":
        option = next((said for change, said in origin.items() if f"{dotted(rest)}.".startswith(f"{change}.")), option)
        rest = rest if option in ("--set", "--options") else rest[1:]
    return f"{option}: {dotted(rest)}" if rest and isinstance(rest[0], str) else f"{option}{dotted(rest)}"


def flag(kind: type[Configuration], name: str) -> str:
    """Option of a field, which is an argument without dashes where it has no default.

    json_schema_extra = {"flag": ...} says another. A field that is True by default has "--no-" before its name, and a text that begins
    with a verb.
    """
    field = kind.model_fields.get(name)
    if field is not None and isinstance(field.json_schema_extra, dict):
        return str(field.json_schema_extra["flag"])
    if field is not None and field.is_required() and not is_table(field):
        return name
    no = "no-" if field is not None and field.annotation is bool and field.default else ""
    return f"--{no}{name.replace('_', '-')}"


def attribute_texts(kind: type) -> dict[str, str]:
    """Text of every attribute by its name, from the sections "Attributes:" of a class and its bases."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        section = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        for match in re.finditer(r"^    (\w[\w, ]*): (.*(?:\n        .*)*)", section, re.MULTILINE):
            text = " ".join(match[2].split()).rstrip(".")
            found |= dict.fromkeys(match[1].split(", "), text.replace("`", ""))
    return found


def _inner(annotation: Any) -> Any:
    """A type without None and without its checks."""
    if get_origin(annotation) is Annotated:
        return _inner(get_args(annotation)[0])
    choices = [choice for choice in get_args(annotation) if choice is not types.NoneType]
    return _inner(choices[0]) if get_origin(annotation) in (Union, types.UnionType) and len(choices) == 1 else annotation


def _element(annotation: Any) -> Any:
    """The type T of the elements of tuple[T, ...]; None for other types."""
    inner = _inner(annotation)
    return get_args(inner)[0] if get_origin(inner) is tuple else None


def is_table(field: FieldInfo) -> bool:
    """Whether a field is an array of tables, which has no option."""
    element = _element(field.annotation)
    return isinstance(element, type) and issubclass(element, Configuration)


def _metavar(name: str, annotation: Any) -> str:
    inner = _inner(annotation)
    if get_origin(inner) is Literal:
        return "{" + ",".join(map(str, get_args(inner))) + "}"
    if get_origin(inner) is dict:
        return "JSON"
    singular = re.sub("s$", "", re.sub("ies$", "y", name))
    return METAVARS.get(name) or NUMBERS.get(inner) or singular.upper()


def _default(field: FieldInfo) -> str:
    own = field.get_default(call_default_factory=True, validated_data={})
    if field.is_required():
        return " (required)" if field.json_schema_extra else ""
    if own is None or own == () or own == {}:
        return ""
    return f" (default: {' '.join(map(str, own)) if isinstance(own, tuple) else own})"


def _read(given: Any, annotation: Any) -> Any:
    """The value of a text as its type; the text itself where it has none of that type, for the class to refuse."""
    element, inner = _element(annotation), _inner(annotation)
    if element is not None:
        return [_read(text, element) for text in given]
    if get_origin(inner) is dict:
        return _json_object(given)
    if get_origin(inner) is Literal:
        return {str(choice): choice for choice in get_args(inner)}.get(given, given)
    try:
        return inner(given) if inner in NUMBERS else given
    except ValueError:
        return given


def _json_object(text: str) -> dict[str, Any]:
    try:
        value = parse_json(text)
    except ValueError as error:
        raise ValueError(f"--options {config.shown(text)} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f'--options {config.shown(text)} should be a JSON object, such as {{"fidelity": "fast"}}')
    return value
