"""Policies that are compared: single ones, and folders of runs.

`soft-tendon sweep` leaves a folder with several seeds of one training.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from soft_tendon_env.control import controllers_of
from soft_tendon_env.policies.agent import is_agent
from soft_tendon_env.policies.names import ALL, BEST, Agent, Controller, PolicyName, split_name
from soft_tendon_env.tools.files import read_json

SEED = re.compile(r"seed_(\d+)")
ALIKE = ("task", "algorithm", "hyperparameters", "options", "steps")
"""Keys of the configurations of runs that all seeds share."""


def agents_of(task: str, names: Sequence[str]) -> dict[str, dict[int | None, str]]:
    """Policies of every name by seed of training, None: no folder of seeds.

    The name "all" is every controller. Raises ValueError, OSError.
    """
    every = list[str]()
    for name in names:
        if name == ALL:
            every += controllers_of(task)
        else:
            every.append(name)
    agents = dict[str, dict[int | None, str]]()
    for name in every:
        before, folder, behind = split_name(name)
        runs = seed_files(Path(folder), task)
        if runs:
            agents[name] = {seed: f"{before}{run}{behind}" for seed, run in runs.items()}
        else:
            agent = PolicyName.parse(name, task)
            agents[name] = {None: agent.text}
    return agents


def trained_alike(policy: PolicyName) -> dict[int | None, str]:
    """Agents of one training by its seed: an agent, and those in folders seed_1, seed_2, ...

    beside its files; None: it is alone, or not an agent. Raises ValueError, OSError unless all were
    trained alike.
    """
    if not isinstance(policy, Agent):
        return {None: policy.text}
    folder = policy.folder
    if not any(folder.glob("seed_*")):
        return {None: policy.text}
    seed = read_run(folder).get("seed")
    others = seed_folders(folder)
    if seed in others:
        raise ValueError(f"{others[seed]} has the seed of the agent beside it, {folder}")
    every_folder = [(seed, folder), *others.items()]
    folders = dict[int | None, Path](every_folder)
    check_alike(list(folders.values()), policy.task)
    return {seed: policy.with_folder(path) for seed, path in folders.items()}


def seed_files(folder: Path, task: str) -> dict[int | None, str]:
    """Best agents of the runs of a folder, by seed.

    There are none in another folder, such as an agent's own. Raises ValueError, OSError unless all
    were trained on the task, and alike.
    """
    has_seeds = any(folder.glob("seed_*"))
    if not has_seeds or is_agent(str(folder)):
        return {}
    runs = seed_folders(folder)
    check_alike(list(runs.values()), task)
    for run in runs.values():
        if not (run / BEST).is_dir():
            raise FileNotFoundError(
                f"{run} has no agent in {BEST}: finish its training with `soft-tendon sweep`, or"
                " take it away"
            )
    return {seed: str(run / BEST) for seed, run in runs.items()}


def check_alike(folders: Sequence[Path], task: str) -> None:
    """Raises ValueError, OSError unless all runs or agents were trained on the task, and alike."""
    first: dict[str, Any] = {"task": task}
    for folder in folders:
        config = read_run(folder)
        differences = []
        for key in ALIKE:
            value = config.get(key)
            first.setdefault(key, value)
            if value != first[key]:
                difference = f"{key} = {value!r}, not {first[key]!r}"
                differences.append(difference)
        if differences:
            message = f"{folder} has {', '.join(differences)}: compare it apart"
            raise ValueError(message)


def seed_folders(folder: Path) -> dict[int, Path]:
    """Runs seed_0, seed_1, ...

    of a folder by seed, in their order. Raises FileNotFoundError where there are none.
    """
    runs = list[tuple[int, Path]]()
    for path in folder.glob("seed_*"):
        match = SEED.fullmatch(path.name)
        if match is not None:
            numbered = (int(match[1]), path)
            runs.append(numbered)
    if not runs:
        raise FileNotFoundError(
            f"{folder} has no folders seed_0, seed_1, ... of runs, as `soft-tendon sweep` leaves"
            " them"
        )
    return dict(sorted(runs))


def read_run(run: Path) -> dict[str, Any]:
    """Configuration of a run.

    Raises ValueError, FileNotFoundError without one.
    """
    path = run / "config.json"
    if not path.is_file():
        raise FileNotFoundError(
            f"{run} is no run: it has no config.json, as `soft-tendon train` writes it"
        )
    return read_json(path)


def model_in_the_loop(policy: PolicyName, told: bool = False) -> str:
    """A policy's use of a model of the arm at run time, in words.

    It is "none" for agents alone, "own" for users' policies, of which it is not known. told:
    whether its model has the effects of a benchmark's setting.
    """
    if not isinstance(policy, Controller | Agent):
        return "own"
    words = list[str]()
    if isinstance(policy, Controller):
        words.append("controller")
    if policy.estimator is not None:
        words.append(f"{policy.estimator} estimator")
    if words and told:
        words.append("told of the effects")
    return ", ".join(words) or "none"
