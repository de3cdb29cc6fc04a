"""Modules of a user's own that register effects, tasks, controllers, metrics ...: imported first, in each process of a command."""

import importlib
import os
import sys
from collections.abc import Iterable

from soft_tendon_env.tools.messages import describe

VARIABLE = "SOFT_TENDON_ENV_IMPORT"
"""Environment variable with their names and commas between, which processes that are started inherit."""


def import_extensions(names: Iterable[str] = ()) -> None:
    """Import modules of these names, and those that VARIABLE names; the current folder is looked in too. Raises ValueError."""
    for name in (every := list(dict.fromkeys([*extensions(), *names]))):
        look_in_this_folder()
        try:
            importlib.import_module(name)
        except ImportError as error:
            where = "it should be a module, in this folder or on PYTHONPATH"
            raise ValueError(f"--import names {name!r}: {where}; {describe(error)}") from error
    if every:
        os.environ[VARIABLE] = ",".join(every)


def look_in_this_folder() -> None:
    """Lets modules of the current folder be imported, after all others: scripts that pip installs do not see it."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def extensions() -> list[str]:
    """Names of VARIABLE."""
    return [name for name in os.environ.get(VARIABLE, "").split(",") if name]
