"""The command line: `soft-tendon COMMAND`.

A command is a module with a function `run(settings)`, whose annotation is the class of its options;
it is imported when it is called. One of a user's own is a function of its arguments under
`@register("command", "name", description="what it does")`. Where that class has a method
`read_file(config)`, it reads the file of --config, which other options override.
"""

import importlib
import importlib.metadata
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_type_hints

from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.extensions import import_modules
from soft_tendon_env.tools.registry import Registry, register

PROGRAM = "soft-tendon"
IMPORT = "--import"
STOPPED = "stopped: the same command goes on from what is kept"
"""Message after Ctrl-C."""


class Command(NamedTuple):
    """Command of the command line."""

    description: str
    # function of the arguments behind its name; of those that ship the module that has it
    run: Callable[[Sequence[str]], None] | str


def _checked_command(name: str, run: Any, *, description: str) -> Command:
    """Command of a function of the arguments behind its name. Raises TypeError, ValueError."""
    if not re.fullmatch("[a-z][a-z0-9-]*", name):
        raise ValueError(
            f"the command's name {name!r} should be of small letters, digits and dashes"
        )
    if not callable(run) and not isinstance(run, str):
        raise TypeError(f"the command {name!r} should be a function of its arguments, not {run!r}")
    return Command(description, run)


COMMANDS: Registry[Command] = Registry("command", _checked_command)
"""Commands by their names."""

_SHIPPED: dict[str, str] = {
    "demo": "controllers and the shipped agent side by side: a table, a picture, a recording",
    "train": "train an agent with Stable-Baselines3, or with RLlib in several processes",
    "sweep": "train configurations with several seeds, and draw their learning curves",
    "tune": "search for the best parameters of a training or a controller (Optuna)",
    "evaluate": "evaluate one policy on the evaluation episodes, under every model error",
    "compare": "compare controllers and agents on the same episodes",
    "arena": (
        "benchmark of learned and model-based policies on arms that differ from every model, with"
        " intervals"
    ),
    "export": (
        "write a trained agent as one ONNX file, or an arm as a chain of links for MuJoCo, and"
        " check it"
    ),
    "run": "run a policy on a robot in real time, with limits, a watchdog and a log",
    "collect": "collect motions of a robot for identification: drawn holds and releases, a CSV",
    "record": "record policies side by side for the Rerun viewer",
    "reproduce-paper": "figures 2 to 6 of the paper, and what it says beside what is measured",
    "fields": (
        "make the passive strain fields of an arm's own from simulated motions, and report their"
        " accuracy"
    ),
    "accuracy": (
        "accuracy against computing time of an arm: Pareto front, and the cheapest setting for a"
        " tolerance"
    ),
    "identify": (
        "identify an arm from measured marker positions: parameters, intervals, held-out errors"
    ),
    "scenes": "list the scenes that ship, or print one as TOML",
    "effects": "list the effects that a scene can have, with their parameters and units",
    "doctor": (
        "check the installation: versions, extras, kernel cache, one step of every task of a scene,"
        " whose kernels it compiles"
    ),
}

for _name, _description in _SHIPPED.items():
    _module = f"soft_tendon_env.cli.{_name.replace('-', '_')}"
    register("command", _name, _module, description=_description)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; `arguments`: of the process by default. Ends the process with status 2 on
    mistakes, 1 where it cannot go on."""
    if arguments is None:
        arguments = sys.argv[1:]
    words = list(arguments)
    modules = list[str]()
    while words[:1] == [IMPORT]:
        modules += words[1:2]
        words = words[2:]
    name, *rest = words or [""]
    try:
        import_modules(modules)  # which may register a command of this name
        if name not in (*COMMANDS, "", "-h", "--help", "--version"):
            raise ValueError(f"{name!r} is no command: {not_among(name, COMMANDS)}")
    except ValueError as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        sys.exit(2)
    if name == "--version":
        print(importlib.metadata.version("soft_tendon_env"))
        sys.exit(0)
    if name not in COMMANDS:
        print(usage())
        sys.exit(0 if name else 2)
    # Not above: they take longer to import than to print the usage.
    from soft_tendon_env.cli.errors import exit_in_one_line

    own = COMMANDS[name].run
    if callable(own):
        with exit_in_one_line(f"{PROGRAM} {name}", STOPPED):
            own(rest)
        return
    from soft_tendon_env.cli.options import read

    run, kind = shipped_command(name)
    with exit_in_one_line(f"{PROGRAM} {name}", getattr(kind, "STOPPED", STOPPED)):
        run(read(name, kind, rest))


def shipped_command(name: str) -> tuple[Callable[[Any], None], Any]:
    """The function of a command that ships, and the class of its options."""
    module = f"{COMMANDS[name].run}"
    run = importlib.import_module(module).run
    return run, get_type_hints(run)["settings"]


def usage() -> str:
    """The commands with a line for each."""
    lines = [
        f"usage: {PROGRAM} [{IMPORT} MODULE ...] COMMAND [options]     ({PROGRAM} COMMAND --help"
        " lists them)"
    ]
    lines += [
        (
            f"       {IMPORT} MODULE: of your own, with tasks, effects, controllers, metrics ..."
            " that it registers"
        ),
        "",
    ]
    for name, command in COMMANDS.items():
        lines.append(f"  {name:<16} {command.description}")
    return "\n".join(lines)
