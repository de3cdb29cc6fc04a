"""Ends of commands that cannot go on: one line that says what to do, and an exit status, in place
of a traceback."""

import os
import sys
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.files import make_writable
from soft_tendon_env.tools.messages import UserError, describe

MISTAKES = (
    ValueError,
    TypeError,
    OSError,
    MemoryError,
    ModuleNotFoundError,
    DependencyNotInstalled,
)  # before anything runs
EXTRAS = {  # modules by the extra that installs them
    "agents": ("torch", "stable_baselines3", "sb3_contrib"),
    "recording": ("rerun", "pyarrow"),
    "pictures": ("matplotlib",),
    "tuning": ("optuna",),
    "export": ("torch", "onnx", "onnxruntime"),
    "robots": ("dynamixel_sdk",),
    "rllib": ("ray", "tree", "stable_baselines3"),
}


class Mistake(UserError):
    """Ends a command before it runs, since an option, a file or a folder cannot be used: exit
    status 2."""


@contextmanager
def mistakes() -> Iterator[None]:
    """Context in which errors are the user's: raises Mistake."""
    try:
        yield
    except MISTAKES as error:
        raise Mistake(describe(error)) from error


@contextmanager
def exit_in_one_line(program: str, stopped: str) -> Iterator[None]:
    """End the process in one line, which names the program, where it cannot go on; `stopped` is
    what to say after Ctrl-C."""
    from soft_tendon_env import SimulationDiverged

    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads what is printed has seen enough
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        sys.exit(1)
    except Mistake as mistake:
        print(
            *(f"{program}: error: {line}" for line in describe(mistake).splitlines()),
            sep="\n",
            file=sys.stderr,
        )
        sys.exit(2)
    except BrokenProcessPool:
        sys.exit(
            f"{program}: error: a process of --workers was killed: it may have had too little"
            " memory, fewer --workers need less"
        )
    except (UserError, ConfigurationError, OSError, MemoryError, SimulationDiverged) as error:
        sys.exit(f"{program}: error: {describe(error)}")
    except KeyboardInterrupt:
        print(f"\n{stopped}", file=sys.stderr)
        sys.exit(130)  # the exit status that shells give to what Ctrl-C ends


def is_installed(extra: str) -> bool:
    """Whether every module of an extra is there."""
    return all(find_spec(module) is not None for module in EXTRAS[extra])


def require(*extras: str) -> None:
    """Checks that extras are installed. Raises ModuleNotFoundError with the pip command for those
    that are missing."""
    if missing := ",".join(extra for extra in extras if not is_installed(extra)):
        raise ModuleNotFoundError(f'extras must be there: pip install "soft_tendon_env[{missing}]"')


def writable_folder(path: Path) -> Path:
    """The folder, made if need be, in which a file can be written. Raises ValueError."""
    try:
        return make_writable(path)
    except OSError as error:
        raise ValueError(
            f"--out is {path}: it should be a folder that can be written, and there"
            f" {describe(error)}"
        ) from error
