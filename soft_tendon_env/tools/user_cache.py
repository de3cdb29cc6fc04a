"""Folders in the user's cache: machine code, strain fields and calibrations, which are made once and kept."""

import errno
import os
import tempfile
from pathlib import Path

from soft_tendon_env.tools import STARTED_IN
from soft_tendon_env.tools.messages import say_once

WRITABLE = "set NUMBA_CACHE_DIR to a folder that can be written"


def cache_parents() -> list[Path]:
    """Candidate parents of the cache folder, best first: what the user has chosen, then the usual places."""
    user = getattr(os, "getuid", int)()
    temporary = Path(tempfile.gettempdir(), f"soft_tendon_env-{user}")
    named = os.environ.get("NUMBA_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME"), os.path.expanduser("~/.cache")
    parents = [(STARTED_IN / folder).absolute() for folder in named if folder and not folder.startswith("~")]
    is_own = not temporary.exists() or temporary.stat().st_uid == user  # else somebody has put it there, with code that numba would run
    return [*parents, temporary] if is_own else parents


def data_folders(name: str) -> list[Path]:
    """The folders `<user's cache>/soft_tendon_env/<name>` that exist, best first, see `cache_parents`."""
    return [folder for parent in cache_parents() if os.path.isdir(folder := parent / "soft_tendon_env" / name)]


def new_data_folder(name: str) -> Path:
    """The first of these folders that can be written, created when missing. Raises OSError where there is none."""
    refused = []
    for folder in (parent / "soft_tendon_env" / name for parent in cache_parents()):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()  # a folder can exist and yet not be writable
        except OSError as error:
            refused.append(f"{folder.parents[1]} cannot be used ({error.strerror})")
            continue
        if refused:
            say_once(f"{', '.join(refused)}: what is kept is in {folder.parent}; {WRITABLE}")
        return folder
    raise OSError(errno.EROFS, f"{', '.join(refused)}; {WRITABLE}")
