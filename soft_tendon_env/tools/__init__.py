"""Tools of the whole package that know nothing of arms: argument validation, configuration, files."""

import contextlib
from pathlib import Path

STARTED_IN = Path()
"""The working folder when the package was imported, which relative paths in environment variables refer to."""

with contextlib.suppress(FileNotFoundError):  # it was deleted
    STARTED_IN = Path.cwd()
