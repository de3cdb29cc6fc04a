"""How every script ends where it cannot go on: in one line that says what to do, and an exit status, in place of a traceback."""

import functools
import os
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from gymnasium.error import DependencyNotInstalled

from soft_tendon_env import SimulationDiverged

MISTAKES = (ValueError, TypeError, OSError, MemoryError, ModuleNotFoundError, DependencyNotInstalled)
"""What arguments, files and folders are refused with, before anything runs: exit status 2, after the usage."""
INTERRUPTED = 130  # the exit status that shells give to what Ctrl-C ends
PROBE = bytes(1 << 16)  # more than a full disk keeps in reserve for small files


class Mishap(Exception):
    """What ends a script that has begun, and that its user can do something about."""


def command(stopped: str) -> Callable[[Callable[[], None]], Callable[[], None]]:
    """A script's `main` which says in one line why it ended: a Mishap, a file that cannot be written, memory, workers that died, Ctrl-C.

    stopped: what to say after Ctrl-C.
    """

    def decorate(main: Callable[[], None]) -> Callable[[], None]:
        @functools.wraps(main)
        def run() -> None:
            try:
                main()
            except BrokenPipeError:  # whoever reads what is printed has seen enough
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                sys.exit(1)
            except BrokenProcessPool:
                fail("a process of --workers was killed: it may have had too little memory, fewer --workers need less")
            except (Mishap, OSError, MemoryError, SimulationDiverged) as error:
                fail(said(error))
            except KeyboardInterrupt:
                print(f"\n{stopped}", file=sys.stderr)
                sys.exit(INTERRUPTED)

        return run

    return decorate


def fail(text: str) -> None:
    """Exit status 1."""
    sys.exit(f"{Path(sys.argv[0]).name}: error: {text}")


def said(error: BaseException) -> str:
    """An error in words: of an OSError the file comes first, without the number."""
    if isinstance(error, OSError) and error.strerror:
        names = ", ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
        return f"{names}: {error.strerror}" if names else error.strerror
    if isinstance(error, MemoryError):
        return f"there is too little memory: {error}" if str(error) else "there is too little memory"
    return str(error) or type(error).__name__


def writable_folder(path: Path, argument: str = "--out") -> Path:
    """The folder, made if need be, in which there is room for a file. Raises ValueError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(PROBE)
    except OSError as error:
        raise ValueError(f"{argument} is {path}: it should be a folder that can be written, and there {said(error)}") from error
    return path
