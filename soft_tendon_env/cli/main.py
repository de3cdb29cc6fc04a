"""The command line: `soft-tendon COMMAND`.

A command is a module with a function `run(settings)`, whose annotation is the class of its options;
it is imported when it is called. Where that class has a method `read_file(config)`, it reads the
file of --config, which other options override.
"""

import importlib
import importlib.metadata
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, get_type_hints

from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.extensions import import_modules

COMMANDS: dict[str, str] = {
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
"""Descriptions of the commands, by their names."""
PROGRAM = "soft-tendon"
IMPORT = "--import"
STOPPED = "stopped: the same command goes on from what is kept"
"""Message after Ctrl-C."""
Run = TypeVar("Run", bound=Callable[[Sequence[str]], None])
_own: dict[str, Callable[[Sequence[str]], None]] = {}
"""Functions of the commands that users register, by name."""


def register_command(name: str, description: str) -> Callable[[Run], Run]:
    """Decorator of a function of the arguments behind its name: a command of your own. Raises
    ValueError for a name that is taken."""
    if name in COMMANDS and name not in _own:
        raise ValueError(f"there is a command {name!r} already: choose another name")

    def add(run: Run) -> Run:
        COMMANDS[name] = description
        _own[name] = run
        return run

    return add


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; `arguments`: of the process by default. Ends the process with status 2 on
    mistakes, 1 where it cannot go on."""
    words = list(sys.argv[1:] if arguments is None else arguments)
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

    if name in _own:
        with exit_in_one_line(f"{PROGRAM} {name}", STOPPED):
            _own[name](rest)
        return
    from soft_tendon_env.cli.options import read

    run, kind = shipped_command(name)
    with exit_in_one_line(f"{PROGRAM} {name}", getattr(kind, "STOPPED", STOPPED)):
        run(read(name, kind, rest))


def shipped_command(name: str) -> tuple[Callable[[Any], None], Any]:
    """The function of a command that ships, and the class of its options."""
    run = importlib.import_module(f"soft_tendon_env.cli.{name.replace('-', '_')}").run
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
    return "\n".join([*lines, *(f"  {name:<16} {text}" for name, text in COMMANDS.items())])
