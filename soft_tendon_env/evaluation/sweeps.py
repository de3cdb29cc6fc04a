"""Several seeds of one training as one policy: folders of runs, as `soft-tendon sweep` leaves them.

What a policy's summary shows of several seeds: errors, the share reached, effort, rate and return are interquartile means over the seeds'
numbers, with 95 % intervals (see interquartile.py). Counts (settled, violations, diverged) and the settling time, which a seed may not
have, are of all episodes of all seeds together, as is the worst episode. Times per action are medians of the seeds'.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.evaluation import EpisodeScore, Summary, summarise
from soft_tendon_env.evaluation.metrics import ActionTime, ErrorScore
from soft_tendon_env.evaluation.provenance import result_record
from soft_tendon_env.evaluation.statistics import Interval, bootstrap_interval, interquartile_mean
from soft_tendon_env.policies.agent import is_agent, is_run
from soft_tendon_env.policies.load import BEST, expand_policies
from soft_tendon_env.tools.files import read_json

SEED = re.compile(r"seed_(\d+)")
OWN = ("seed", "record", "checkpoint_every", "checkpoint_seconds")  # what a run may have for itself; the rest is that of all seeds
Scores = dict[tuple[str, str], list[EpisodeScore]]  # by policy and model error
Summaries = dict[tuple[str, str], Summary]


@dataclass(frozen=True)
class SeedSummary(Summary):
    """A summary of several seeds. `intervals` are those of the interquartile means, by the names of `Summary.numbers`."""

    seeds: int
    intervals: Mapping[str, Interval]


class Results(NamedTuple):
    """Of a task. `files`: of every policy, by seed (None: no folder); `scores` and `summaries` are by file and model error."""

    files: dict[str, dict[int | None, str]]
    scores: Scores
    summaries: Summaries

    def keys(self) -> list[tuple[str, str]]:
        """Every policy with every model error."""
        errors = dict.fromkeys(error for _, error in self.summaries)
        return [(policy, error) for policy in self.files for error in errors]

    def all_summaries(self) -> Summaries:
        """A summary per policy and model error."""
        return {key: self._summary(*key) for key in self.keys()}

    def records(self) -> list[dict[str, Any]]:
        """Every policy on every arm, for JSON: a folder's has a record per seed."""
        return [self._record(*key) for key in self.keys()]

    def _summary(self, policy: str, error: str) -> Summary:
        keys = [(file, error) for file in self.files[policy].values()]
        if not is_folder(policy):
            return self.summaries[keys[0]]
        return over_seeds([self.summaries[key] for key in keys], [self.scores[key] for key in keys])

    def _record(self, policy: str, error: str) -> dict[str, Any]:
        summary, files = self._summary(policy, error), self.files[policy]
        if not is_folder(policy):
            return result_record(policy, error, summary, self.scores[policy, error])
        together = result_record(policy, error, summary, [])
        del together["episodes"]
        seeds = [
            {"seed": seed, **result_record(file, error, self.summaries[file, error], self.scores[file, error])}
            for seed, file in files.items()
        ]
        return {**together, "seeds": seeds}


def agents_of(task: str, names: tuple[str, ...]) -> dict[str, dict[int | None, str]]:
    """The agents of every policy by seed: a folder's are the best of its runs. Raises ValueError, OSError."""
    return {name: seed_files(Path(name), task) if is_folder(name) else {None: name} for name in expand_policies(task, names)}


def is_folder(name: str) -> bool:
    """Whether a policy is a folder of runs: a path, but no agent's file and no controller."""
    controller = any(name in entries for entries in CONTROLLERS.values())
    path = Path(name)
    return not is_agent(name) and not controller and not is_run(path) and (path.is_dir() or len(path.parts) > 1)


def seed_folders(folder: Path) -> dict[int, Path]:
    """Its runs seed_0, seed_1, ... by seed, in their order. Raises FileNotFoundError where there are none."""
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
        "action_time": ActionTime(*np.median([summary.action_time for summary in summaries], axis=0).tolist()),
        **{name: means[name] for name in ("reached", "mean_return") if name in means},
    }
    intervals = {key: bootstrap_interval(of_seeds) for key, of_seeds in values.items()}
    return SeedSummary(**{**vars(pooled), **changed}, seeds=len(summaries), intervals=intervals)
