"""Folders of runs as `soft-tendon sweep` leaves them: several seeds of one training, which are one policy."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from soft_tendon_env.policies.agent_files import is_agent
from soft_tendon_env.policies.load import expand_policies
from soft_tendon_env.policies.names import BEST, PolicyName, Seeds
from soft_tendon_env.tools.files import read_json

SEED = re.compile(r"seed_(\d+)")
OWN = ("seed", "record", "checkpoint_every", "checkpoint_seconds")  # what a run may have for itself; the rest is that of all seeds


def agents_of(task: str, names: tuple[str, ...]) -> dict[str, dict[int | None, str]]:
    """Agents of every policy by seed: a folder's are the best of its runs. Raises ValueError, OSError."""
    parsed = {name: PolicyName.parse(name, task) for name in expand_policies(task, names)}
    return {name: seed_files(policy.folder, task) if isinstance(policy, Seeds) else {None: name} for name, policy in parsed.items()}


def every_file(files: Mapping[str, Mapping[int | None, str]]) -> list[str]:
    """Every agent or controller of policies once."""
    return [*dict.fromkeys(file for of_policy in files.values() for file in of_policy.values())]


def seed_folders(folder: Path) -> dict[int, Path]:
    """Runs seed_0, seed_1, ... of a folder by seed, in their order. Raises FileNotFoundError where there are none."""
    found = {int(match[1]): path for path in folder.glob("seed_*") if path.is_dir() and (match := SEED.fullmatch(path.name))}
    if not found:
        text = f"{folder} has no folders seed_0, seed_1, ... of runs, as `soft-tendon sweep` leaves them"
        raise FileNotFoundError(f"{text}; of a single run name its best agent, {folder / BEST}")
    return dict(sorted(found.items()))


def read_run(run: Path) -> dict[str, Any]:
    """Configuration of a run. Raises ValueError, FileNotFoundError without one."""
    path = run / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{run} is no run: it has no config.json, as `soft-tendon train` writes it")
    return read_json(path)


def seed_files(folder: Path, task: str) -> dict[int | None, str]:
    """Best agent of every seed. Raises ValueError, FileNotFoundError unless all were trained on the task, and alike."""
    files: dict[int | None, str] = {}
    first: dict[str, Any] | None = None
    for seed, run in seed_folders(folder).items():
        agent, config = run / BEST, read_run(run)
        first = first or config
        if config.get("task") != task:
            raise ValueError(f"{run} was trained on {config.get('task')}, not on {task}")
        for key in sorted((first | config).keys() - OWN):
            if config.get(key) != first.get(key):
                raise ValueError(f"{run} has {key} = {config.get(key)!r}, the first seed has {first.get(key)!r}: compare them apart")
        if not is_agent(str(agent)):
            raise FileNotFoundError(f"{run} has no agent in {BEST}: finish its training with `soft-tendon sweep`, or take it away")
        files[seed] = str(agent)
    return files
