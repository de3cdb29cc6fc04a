"""Ends of commands that cannot go on: one line that says what to do, and an exit status, in place of a traceback."""

import os
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from gymnasium.error import DependencyNotInstalled

from soft_tendon_env.tools.messages import UserError, describe

MISTAKES = (ValueError, TypeError, OSError, MemoryError, ModuleNotFoundError, DependencyNotInstalled)
"""Errors about options, files and folders, before anything runs: exit status 2."""
PROBE = bytes(1 << 16)  # more than a full disk keeps in reserve for small files
EXTRAS = {
    "agents": ("torch", "stable_baselines3", "sb3_contrib"),
    "recording": ("rerun", "pyarrow"),
    "pictures": ("matplotlib",),
    "tuning": ("optuna",),
    "export": ("torch", "stable_baselines3", "sb3_contrib", "onnx", "onnxruntime"),
    "robots": ("dynamixel_sdk",),
}
"""Modules by the extra that installs them."""
APART = {"rllib": ("ray", "tree", "stable_baselines3")}
"""Modules by the extra, of extras that need an environment of their own, as `make rllib` makes it."""


@contextmanager
def exit_in_one_line(program: str, stopped: str) -> Iterator[None]:
    """End the process in one line on: a UserError, a file that cannot be written, memory, workers that died, Ctrl-C, a closed pipe.

    program: named in errors. stopped: what to say after Ctrl-C.
    """
    from soft_tendon_env import SimulationDiverged

    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads what is printed has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except BrokenProcessPool:
        sys.exit(f"{program}: error: a process of --workers was killed: it may have had too little memory, fewer --workers need less")
    except (UserError, OSError, MemoryError, SimulationDiverged) as error:
        sys.exit(f"{program}: error: {describe(error)}")
    except KeyboardInterrupt:
        print(f"\n{stopped}", file=sys.stderr)
        sys.exit(130)  # the exit status that shells give to what Ctrl-C ends


def missing_extras(extras: tuple[str, ...]) -> list[str]:
    """Extras of which a module is not installed."""
    return [extra for extra in extras if not all(_is_there(module) for module in EXTRAS[extra])]


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ValueError:  # it was put out of the way: sys.modules has None
        return False


def install_command(extras: list[str]) -> str:
    return f'pip install "soft_tendon_env[{",".join(extras)}]"'


def require(*extras: str) -> None:
    """Checks that extras are installed. Raises ModuleNotFoundError with the pip command for those that are missing."""
    for extra in extras:
        if extra in APART and not all(map(_is_there, APART[extra])):
            what = f"the extra {extra} must be there, in a virtual environment of its own, since it needs an older Gymnasium"
            raise ModuleNotFoundError(f"{what}: `make {extra}` in a clone, or {install_command([extra])}; docs/how_to/train_at_scale.md")
    if missing := missing_extras(tuple(extra for extra in extras if extra not in APART)):
        what = f"the {'extra' if len(missing) == 1 else 'extras'} {', '.join(missing)}"
        raise ModuleNotFoundError(f"{what} must be there: {install_command(missing)}")


def writable_folder(path: Path) -> Path:
    """The folder, made if need be, in which there is room for a file. Raises ValueError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(PROBE)
    except OSError as error:
        raise ValueError(f"--out is {path}: it should be a folder that can be written, and there {describe(error)}") from error
    return path
