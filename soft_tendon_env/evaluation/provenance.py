"""Records of results as JSON: scores, settings, and where they come from (command, commit, versions, machine)."""

import importlib.metadata
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation import EpisodeScore, Summary, model_error
from soft_tendon_env.evaluation.settings import Run, Settings

PACKAGE = Path(__file__).parents[1]
PACKAGES = ("soft_tendon_env", "numpy", "scipy", "numba", "gymnasium", "daqp", "stable_baselines3", "sb3_contrib", "torch", "ray")


def result_record(policy: str, error: str, summary: Summary, scores: list[EpisodeScore]) -> dict[str, Any]:
    """One policy on one arm, for JSON. Times per action are in the summary alone."""
    together = {**summary.record(), "action_time": summary.action_time._asdict(), "flagged": summary.flagged}
    episodes = [score.record() for score in scores]
    for episode in episodes:
        del episode["action_seconds"]
    return {"policy": policy, "model_error": error, "summary": together, "episodes": episodes}


def configuration_record(settings: Settings, runs: list[Run]) -> dict[str, Any]:
    """All that results depend on: settings, every policy's environment as resolved, model errors, versions, machine."""
    nominal = {(run.task, run.policy): run.options for run in runs}
    return {
        **origin(),
        "settings": settings.model_dump(mode="json"),
        "seeds": settings.seeds,
        "model_errors": {name: model_error(name) for name in settings.errors},
        "environments": [
            {"task": task, "policy": policy, "options": Options(**options).model_dump(mode="json")}
            for (task, policy), options in nominal.items()
        ],
    }


def origin() -> dict[str, Any]:
    """Where a result comes from: command, time, commit, machine, versions."""
    return {
        "command": command_line(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "machine": machine(),
        "versions": versions(),
    }


def command_line() -> str:
    """What this process was called with, for a shell."""
    name = Path(sys.argv[0]).name
    called = ["python", "-m", "soft_tendon_env"] if name == "__main__.py" else [name]
    return shlex.join([*called, *sys.argv[1:]])


def versions() -> dict[str, str]:
    """Of the packages that are installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def commit() -> str | None:
    """Of the clone that the package is used from, with "+" where files differ from it; None for an installed package."""
    if not (PACKAGE.parent / ".git").exists():
        return None
    try:
        head, changed = (
            subprocess.run(["git", *arguments], cwd=PACKAGE, capture_output=True, text=True, check=True).stdout.strip()
            for arguments in (("rev-parse", "HEAD"), ("status", "--porcelain"))
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")


def machine() -> str:
    """What times depend on."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}"


def write_json(path: Path, content: Any, say: bool = True) -> None:
    """What is not finite becomes null, which is what JSON has."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(_plain(content), indent=1, allow_nan=False) + "\n")
    if say:
        print(f"written: {path}")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
