"""Several seeds of one training as one policy: folders of runs, as `soft-tendon sweep` leaves them.

The summary of several seeds: errors, the share reached, effort, rate and return are interquartile means over the seeds'
numbers, with 95 % intervals (see statistics.py). Counts (settled, violations, diverged) and the settling time, which a seed may not
have, are of all episodes of all seeds together, as is the worst episode. Times per action are medians of the seeds'.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore, Summary, median_times, summarise
from soft_tendon_env.evaluation.statistics import Interval, bootstrap_interval, interquartile_mean
from soft_tendon_env.policies.agent_files import is_agent
from soft_tendon_env.policies.load import expand_policies
from soft_tendon_env.policies.names import BEST, PolicyName, Seeds
from soft_tendon_env.tools.files import read_json

SEED = re.compile(r"seed_(\d+)")
OWN = ("seed", "record", "checkpoint_every", "checkpoint_seconds")  # what a run may have for itself; the rest is that of all seeds


@dataclass(frozen=True)
class SeedSummary(Summary):
    """Summary of several seeds. `intervals` are those of the interquartile means, by the names of `Summary.numbers`."""

    seeds: int
    intervals: Mapping[str, Interval]


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
    """The configuration of a run. Raises ValueError, FileNotFoundError without one."""
    path = run / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{run} is no run: it has no config.json, as `soft-tendon train` writes it")
    return read_json(path)


def seed_files(folder: Path, task: str) -> dict[int | None, str]:
    """The best agent of every seed. Raises ValueError, FileNotFoundError unless all were trained on the task, and alike."""
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


def over_seeds(summaries: Sequence[Summary], scores: Sequence[list[EpisodeScore]]) -> SeedSummary:
    """The seeds' summaries as one, with the scores that they are of."""
    pooled = summarise([score for of_seed in scores for score in of_seed])
    keys = [key for key, value in pooled.numbers.items() if value is not None]
    values = {key: np.array([summary.numbers[key] for summary in summaries], dtype=float) for key in keys}
    means = {key: float(interquartile_mean(of_seeds)) for key, of_seeds in values.items()}
    changed: dict[str, Any] = {
        "errors": {name: ErrorScore(*(means[f"{name}_{kind}"] for kind in ErrorScore._fields)) for name in pooled.errors},
        "metrics": {name: means[name] for name in pooled.metrics},
        "action_time": median_times([summary.action_time for summary in summaries]),
        **{name: means[name] for name in ("reached", "mean_return") if name in means},
    }
    intervals = {key: bootstrap_interval(of_seeds) for key, of_seeds in values.items()}
    return SeedSummary(**{**vars(pooled), **changed}, seeds=len(summaries), intervals=intervals)
