"""Modules of a user's own, which register effects, tasks and more when imported.

They also register controllers, metrics or commands. They are those of installed packages, and those
that `--import` names.
"""

import importlib
import os
import sys
import warnings
from collections.abc import Iterable

from soft_tendon_env.tools.messages import describe, first_line

GROUP = "soft_tendon_env"
"""Group of entry points by which an installed package names its modules."""

_imported: list[str] = []
"""Names of the modules that `import_modules` has imported in this process, in their order."""


def load_extensions() -> None:
    """Imports the modules that installed packages name as entry points `soft_tendon_env`.

    An entry point that cannot be loaded is left out, with a warning that names its package.
    """
    # An id of a task has to be in Gymnasium's registry before `gym.make` looks for it, and
    # Gymnasium calls nobody for an id that it does not know. So importing the package loads them.
    if not _is_group_in_use():
        return
    # It takes 20 ms to import, an eighth of what `import soft_tendon_env` takes.
    from importlib import metadata

    for entry_point in metadata.entry_points(group=GROUP):
        try:
            entry_point.load()
        except Exception as error:  # whatever their module raises, the others are loaded
            if entry_point.dist is not None:
                package = entry_point.dist.name
            else:
                package = "a package"
            warnings.warn(
                f"{package} is left out: its entry point {entry_point.name!r} of the group"
                f" {GROUP!r}, {entry_point.value}, cannot be loaded: {first_line(error)}",
                RuntimeWarning,
                stacklevel=2,
            )


def _is_group_in_use() -> bool:
    """Whether the metadata of any installed package has the heading of the group.

    It reads the files that importlib.metadata would, and parses none. Packages inside of zip files
    are not seen.
    """
    # os in place of pathlib, whose import takes longer than all the reading.
    heading = f"[{GROUP}]".encode()
    for folder in dict.fromkeys(sys.path):
        for name in _metadata_folders(folder):
            try:
                with open(os.path.join(folder, name, "entry_points.txt"), "rb") as file:
                    content = file.read()
            except OSError:  # most packages have no entry points
                continue
            if heading in content:
                return True
    return False


def _metadata_folders(folder: str) -> list[str]:
    """Names of the folders with metadata of packages in a folder of sys.path."""
    try:
        # The empty name, which interactive Python has, is the current folder.
        names = os.listdir(folder or os.curdir)
    except OSError:  # sys.path may name zip files, and folders that are not there
        return []
    return [name for name in names if name.endswith((".dist-info", ".egg-info"))]


def import_modules(names: Iterable[str]) -> None:
    """Imports modules by name, for what they register; the current folder is looked in too.

    Args:
        names: of modules, as `--import` has them.

    Raises:
        ValueError: a module cannot be imported.
    """
    for name in names:
        look_in_this_folder()
        try:
            importlib.import_module(name)
        except ImportError as error:
            place = "it should be a module, in this folder or on PYTHONPATH"
            raise ValueError(f"--import names {name!r}: {place}; {describe(error)}") from error
        if name not in _imported:
            _imported.append(name)


def imported_modules() -> tuple[str, ...]:
    """Names of the modules that `import_modules` has imported, which other processes import too."""
    return tuple(_imported)


def look_in_this_folder() -> None:
    """Lets modules of the current folder be imported, after all others.

    Scripts that pip installs do not see it.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
