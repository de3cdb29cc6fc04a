"""Command-line options out of configuration classes: one option per field, its help from the class's docstring, its checks the class's.

Options that are not given are left to the class's defaults. A mistake is a line that names the option and what is allowed.
"""

import argparse
import inspect
import re
import sys
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from soft_tendon_env.cli.errors import MISTAKES
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Key, dotted, override, parsed_changes, shown
from soft_tendon_env.tools.files import parse_json
from soft_tendon_env.tools.messages import describe

Kind = TypeVar("Kind", bound=Configuration)
SHORTCUTS = {
    "scene": "of the environment: a shipped scene's name, or the path of a TOML file",
    "fidelity": "of the environment: fast, standard, fine, scene or a length such as 1mm; standard for what a scene leaves open by default",
    "target": "of the environment: random, hold, circle or ramp; by default the task's (tables with settings go into --options)",
}
"""Options of environments that have an option of their own beside --options."""
SET = "options of the environment by dotted keys, values as in TOML: randomize.stiffness=1.1 control_period=0.01; they go before --options"
METAVARS = {"config": "FILE", "write_docs": "FILE", "out": "PATH", "set": "KEY=VALUE", "policie": "POLICY", "difficultie": "DIFFICULTY"}
"""What help writes for values, where that is not the name."""


class Once(argparse.Action):
    """Store one value; an option that is given again is a mistake, where argparse would take the last without a word."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, value: Any, option: str | None = None) -> None:
        if option is not None and hasattr(namespace, self.dest):
            parser.error(f"{option} is given twice, with {getattr(namespace, self.dest)} and {value}")
        setattr(namespace, self.dest, value)


class Parser(argparse.ArgumentParser):
    """Parser of one command, described by the first line of its configuration class; errors are one line, without the usage."""

    def __init__(self, command: str, kind: type[Configuration]) -> None:
        description = inspect.cleandoc(kind.__doc__ or "").partition("\n")[0]
        super().__init__(f"soft-tendon {command}", description=description, allow_abbrev=False, argument_default=argparse.SUPPRESS)

    def error(self, message: str) -> NoReturn:
        for line in message.splitlines():
            print(f"{self.prog}: error: {line}", file=sys.stderr)
        sys.exit(2)

    @contextmanager
    def mistakes(self) -> Iterator[None]:
        """What is wrong with options, files and folders is said in a line each: exit status 2."""
        try:
            yield
        except MISTAKES as error:
            self.error(describe(error))

    def read(self, kind: type[Kind], arguments: Sequence[str], positional: Sequence[str] = ()) -> Kind:
        """The configuration that a command line says."""
        add_options(self, kind, positional)
        given = vars(self.parse_args(arguments))
        with self.mistakes():
            return configure(kind, given, positional)


def add_options(parser: argparse.ArgumentParser, kind: type[Configuration], positional: Sequence[str] = ()) -> None:
    """Add an option for every field, an argument without dashes for those in `positional`."""
    helps = attribute_texts(kind)
    for name, field in kind.model_fields.items():
        text = helps.get(name, "")
        if name == "options":
            for shortcut, words in SHORTCUTS.items():
                parser.add_argument(flag(shortcut), action=Once, metavar=shortcut.upper(), help=_escaped(words))
            parser.add_argument("--set", action="extend", nargs="+", metavar=METAVARS["set"], help=_escaped(SET))
        if name in positional:
            parser.add_argument(name, help=_escaped(text), **_positional(name, field))
            continue
        shape = _shape(name, field.annotation)
        own = None if field.is_required() or field.annotation is bool else field.get_default(call_default_factory=True, validated_data={})
        default = "" if own in (None, (), {}) else f" (default: {_plain(own)})"
        parser.add_argument(_flag_of(kind, name), dest=name, help=_escaped(text + default), **shape)


def configure(kind: type[Kind], given: Mapping[str, Any], positional: Sequence[str] = (), file: Mapping[str, Any] | None = None) -> Kind:
    """The configuration of what was given, which goes before what stands in a file. Raises ConfigurationError, ValueError."""
    fields = kind.model_fields
    values: dict[str, Any] = {name: _read(value, fields[name].annotation) for name, value in given.items() if name in fields}
    own = {name: given[name] for name in SHORTCUTS if name in given and "options" in fields}
    if own or "options" in values:
        options = values.get("options", {})
        if twice := sorted(own.keys() & options.keys()):
            raise ValueError(f"--options has {', '.join(twice)}, and so has {flag(twice[0])}: give it once")
        values["options"] = {**(file or {}).get("options", {}), **options, **own}
    changes = parsed_changes(given["set"]) if "set" in given and "options" in fields else {}
    if changes:
        values["options"] = deepcopy(values.get("options", (file or {}).get("options", {})))
        try:
            override(values["options"], changes)
        except ConfigurationError as error:
            raise ValueError("\n".join(f"--set: {dotted(key)} {text}" for key, text in error.problems)) from error
    try:
        return kind(**{**(file or {}), **values})
    except ConfigurationError as error:
        said = [f"{_option(kind, key, own, positional, changes)} {text}".strip() for key, text in error.problems]
        raise ValueError("\n".join(said)) from error


def _option(kind: type[Configuration], key: Key, own: Mapping[str, Any], positional: Sequence[str], changes: Iterable[str] = ()) -> str:
    """A key as the command line has it."""
    name, rest = str(key[0]), key[1:]
    if name == "options" and rest and any(f"{dotted(rest)}.".startswith(f"{change}.") for change in changes):
        return f"--set: {dotted(rest)}"
    if name == "options" and rest and rest[0] in own:
        name, rest = str(rest[0]), rest[1:]
    option = name if name in positional else _flag_of(kind, name)
    return f"{option}: {dotted(rest)}" if rest and isinstance(rest[0], str) else f"{option}{dotted(rest)}"


def flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _flag_of(kind: type[Configuration], name: str) -> str:
    """The option of a field: of its name, unless json_schema_extra says another as "flag"."""
    field = kind.model_fields.get(name)
    extra = None if field is None else field.json_schema_extra
    return str(extra["flag"]) if isinstance(extra, dict) else flag(name)


def attribute_texts(kind: type) -> dict[str, str]:
    """What the sections "Attributes:" of a class and its bases say, by name."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        section = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        for match in re.finditer(r"^    (\w[\w, ]*): (.*(?:\n        .*)*)", section, re.MULTILINE):
            text = " ".join(match[2].split()).rstrip(".")
            found |= dict.fromkeys(match[1].split(", "), text.replace("`", ""))
    return found


def _inner(annotation: Any) -> Any:
    """Without None and what only checks."""
    if get_origin(annotation) is Annotated:
        return _inner(get_args(annotation)[0])
    choices = [choice for choice in get_args(annotation) if choice is not types.NoneType]
    return _inner(choices[0]) if get_origin(annotation) in (Union, types.UnionType) and len(choices) == 1 else annotation


def _element(annotation: Any) -> Any:
    """The type of the elements of tuple[T, ...]; None for what is no tuple."""
    inner = _inner(annotation)
    return get_args(inner)[0] if get_origin(inner) is tuple else None


def _shape(name: str, annotation: Any) -> dict[str, Any]:
    """How argparse reads an option of a type."""
    if annotation is bool:
        return {"action": "store_true"}
    element = _element(annotation)
    several = {"action": "extend", "nargs": "+"} if element else {"action": Once}
    return {"metavar": _metavar(name.removesuffix("s") if element else name, element or annotation), **several}


def _positional(name: str, field: FieldInfo) -> dict[str, Any]:
    return {"nargs": "+"} if _element(field.annotation) else {} if field.is_required() else {"nargs": "?"}


def _metavar(name: str, annotation: Any) -> str:
    inner = _inner(annotation)
    if get_origin(inner) is Literal:
        return "{" + ",".join(map(str, get_args(inner))) + "}"
    if get_origin(inner) is dict:
        return "JSON"
    plain = {int: "N", float: "NUMBER"}.get(inner if isinstance(inner, type) else type(None))
    return plain or METAVARS.get(name, name.upper())


def _read(given: Any, annotation: Any) -> Any:
    """What text says as a value of a type; the text itself where it says none, for the class to refuse."""
    element, inner = _element(annotation), _inner(annotation)
    if element is not None:
        return [_read(text, element) for text in given]
    if get_origin(inner) is dict:
        return _json_object(given)
    if not isinstance(given, str):
        return given
    literals = {str(choice): choice for choice in get_args(inner)} if get_origin(inner) is Literal else {}
    try:
        return inner(given) if inner in (int, float) else literals.get(given, given)
    except ValueError:
        return given


def _json_object(text: str) -> dict[str, Any]:
    try:
        value = parse_json(text)
    except ValueError as error:
        raise ValueError(f"--options {shown(text)} is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise ValueError(f'--options {shown(text)} should be a JSON object, such as {{"fidelity": "fast"}}')
    return value


def _plain(default: Any) -> str:
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)


def _escaped(text: str) -> str:
    """For argparse, which fills in what follows a percent sign."""
    return text.replace("%", "%%")
