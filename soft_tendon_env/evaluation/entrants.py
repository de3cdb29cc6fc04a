"""Policies that are compared: single ones, and folders of runs, as `soft-tendon sweep` leaves them,
several seeds of one training."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.policies.agent import find_agent, is_agent
from soft_tendon_env.policies.names import ALL, BEST, Agent, Controller, PolicyName
from soft_tendon_env.tools.files import read_json

SEED = re.compile(r"seed_(\d+)")
ALIKE = ("task", "algorithm", "hyperparameters", "options", "steps")
"""Keys of the configurations of runs that all seeds share."""


def agents_of(task: str, names: Sequence[str]) -> dict[str, dict[int | None, str]]:
    """Policies of every name by seed of training, None: no folder of seeds; "all" is every
    controller. Raises ValueError, OSError."""
    every = [
        name
        for given in names
        for name in (CONTROLLERS.get(task, {}) if given == ALL else (given,))
    ]
    return {
        name: seed_files(Path(name), task) or {None: PolicyName.parse(name, task).text}
        for name in every
    }


def trained_alike(policy: PolicyName) -> dict[int | None, str]:
    """Agents of one training by its seed: an agent, and those in folders seed_1, seed_2, ... beside
    its files; None: it is alone, or not an agent. Raises ValueError, OSError unless all were
    trained alike."""
    folder = find_agent(policy.text, policy.task) if isinstance(policy, Agent) else None
    if folder is None or not any(folder.glob("seed_*")):
        return {None: policy.text}
    seed, others = read_run(folder).get("seed"), seed_folders(folder)
    if seed in others:
        raise ValueError(f"{others[seed]} has the seed of the agent beside it, {folder}")
    found = dict[int | None, Path]([(seed, folder), *others.items()])
    check_alike([*found.values()], policy.task)
    return {seed: str(path) for seed, path in found.items()}


def seed_files(folder: Path, task: str) -> dict[int | None, str]:
    """Best agents of the runs of a folder by seed; none of what is no such folder, as an agent's
    own. Raises ValueError, OSError unless all were trained on the task, and alike."""
    runs = seed_folders(folder) if any(folder.glob("seed_*")) and not is_agent(str(folder)) else {}
    check_alike([*runs.values()], task)
    for run in runs.values():
        if not (run / BEST).is_dir():
            raise FileNotFoundError(
                f"{run} has no agent in {BEST}: finish its training with `soft-tendon sweep`, or"
                " take it away"
            )
    return {seed: str(run / BEST) for seed, run in runs.items()}


def check_alike(folders: Sequence[Path], task: str) -> None:
    """Raises ValueError, OSError unless the runs or agents in all folders were trained on the task,
    and alike."""
    first: dict[str, Any] = {"task": task}
    for folder in folders:
        config = read_run(folder)
        first = {**{key: config.get(key) for key in ALIKE}, **first}
        if other := [key for key in ALIKE if config.get(key) != first[key]]:
            found = ", ".join(f"{key} = {config.get(key)!r}, not {first[key]!r}" for key in other)
            raise ValueError(f"{folder} has {found}: compare it apart")


def seed_folders(folder: Path) -> dict[int, Path]:
    """Runs seed_0, seed_1, ... of a folder by seed, in their order. Raises FileNotFoundError where
    there are none."""
    found = sorted(
        (int(match[1]), path)
        for path in folder.glob("seed_*")
        if (match := SEED.fullmatch(path.name))
    )
    if not found:
        raise FileNotFoundError(
            f"{folder} has no folders seed_0, seed_1, ... of runs, as `soft-tendon sweep` leaves"
            " them"
        )
    return dict(found)


def read_run(run: Path) -> dict[str, Any]:
    """Configuration of a run. Raises ValueError, FileNotFoundError without one."""
    if not (path := run / "config.json").is_file():
        raise FileNotFoundError(
            f"{run} is no run: it has no config.json, as `soft-tendon train` writes it"
        )
    return read_json(path)


def model_in_the_loop(policy: PolicyName, told: bool = False) -> str:
    """A policy's use of a model of the arm at run time, in words: "none" for agents, "own" for
    users' policies, of which it is not known. told: whether a controller's model has the effects of
    a benchmark's setting."""
    if isinstance(policy, Controller):
        estimator = [] if policy.estimator is None else [f"{policy.estimator} estimator"]
        return ", ".join(["controller", *estimator, *(["told of the effects"] if told else [])])
    return "none" if isinstance(policy, Agent) else "own"
