"""Provenance of results: command, commit, versions, machine; and JSON files."""

import importlib.metadata
import json
import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from soft_tendon_env.tools.files import PACKAGE

PACKAGES = {
    "soft_tendon_env",
    "numpy",
    "scipy",
    "numba",
    "gymnasium",
    "daqp",
    "stable_baselines3",
    "sb3_contrib",
    "torch",
    "ray",
}


def origin() -> dict[str, Any]:
    """Provenance of a result: command, time, commit, machine, versions."""
    program = Path(sys.argv[0]).name
    return {
        "command": shlex.join([program, *sys.argv[1:]]),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "machine": machine(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that are installed, by name."""
    installed = {
        package.name.replace("-", "_"): package.version
        for package in importlib.metadata.distributions()
    }
    named = {"python": platform.python_version()}
    for name in sorted(PACKAGES & installed.keys()):
        named[name] = installed[name]
    return named


def commit() -> str | None:
    """Commit of the clone that the package is in; None for an installed package.

    It has "+" where other files than documents differ.
    """
    if not (PACKAGE.parent / ".git").exists():
        return None
    status = ["status", "--porcelain", "--", ":/", ":!/docs", ":!/*.md"]
    commands = (["rev-parse", "HEAD"], status)
    try:
        head, changed = (
            subprocess.run(["git", *words], cwd=PACKAGE, capture_output=True, text=True, check=True)
            for words in commands
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    if changed.stdout.strip():
        mark = "+"
    else:
        mark = ""
    return head.stdout.strip() + mark


def machine() -> str:
    """Processor, cores and Python version, on which times depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, StopIteration):
        processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}"


def write_json(
    path: Path,
    content: Any,
    say: bool = True,
) -> None:
    """Writes a JSON file, and prints its path.

    Numbers that are not finite become null, which JSON has. Raises OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    written = json.dumps(content)
    plain = json.loads(written, parse_constant=lambda number: None)
    content_text = json.dumps(plain, indent=1)
    path.write_text(content_text + "\n")
    if say:
        print(f"written: {path}")
