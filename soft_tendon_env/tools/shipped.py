"""Folders of files that ship with the package but lie beside it in a clone: the configurations of trainings, the trained agents."""

from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def shipped_folder(inside: str, beside: str) -> Path:
    """The folder `inside` the package, where a wheel has it (see pyproject.toml, force-include), or `beside` the package in a clone."""
    installed = PACKAGE / inside
    return installed if installed.is_dir() else PACKAGE.parent / beside
