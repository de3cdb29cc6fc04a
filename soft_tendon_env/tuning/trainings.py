"""Tuning of trainings of Stable-Baselines3: any keys of their configuration, by the least validation error of a short training."""

import shutil
from collections.abc import Mapping
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.evaluation.conditions import SEEDS
from soft_tendon_env.evaluation.play import validation_scores
from soft_tendon_env.learning.config import Training, find_config
from soft_tendon_env.policies import load_policy
from soft_tendon_env.scene.scene import rod_length
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, dotted, override, read_toml, shown
from soft_tendon_env.tools.types import Array
from soft_tendon_env.tuning.search import Report, Search

LOST = 1.0
"""Cost of an episode that diverged, as a share of the rod's length: more than an agent has that leaves the arm anywhere."""


class TrainingSearch(Search):
    """Search for keys of a training: costs are its validation errors, the root mean square of the task's first error.

    Attributes:
        training: name of a training that ships, or path of a TOML file.
        set: dotted keys of it that all trials change, such as steps = 60_000.
        seeds: number of trainings, with other seeds, by which the best parameters are compared with those of the file; 0: not.
    """

    training: str
    set: dict[str, Any] = Field(default={})
    seeds: int = Field(default=2, ge=0)

    @model_validator(mode="after")
    def _fits(self) -> "TrainingSearch":
        ends = [(("search", name, *key), name, value) for name, parameter in self.search.items() for key, value in parameter.ends.items()]
        problems = [Problem(("set",), f"does not fit {self.training}: {text}") for text in self._mistakes({})] or [
            Problem(key, f"is {shown(value)}: {text}") for key, name, value in ends for text in self._mistakes({name: value})
        ]
        if problems:
            raise ConfigurationError(problems)
        return self

    def _mistakes(self, values: Mapping[str, Any]) -> list[str]:
        """Problems of the training with these values of keys."""
        try:
            self._training(values)
        except ConfigurationError as error:
            return [f"{dotted(key)} {text}".strip() for key, text in error.problems]
        return []

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        table = deepcopy(read_toml(find_config(self.training)))
        override(table, {**_flat(self.set), **values})
        return table

    def _training(self, values: Mapping[str, Any], **more: Any) -> Training:
        return Training.parse({**self.file(values), **more}, self.training)

    @property
    def defaults(self) -> dict[str, Any]:
        tables = (self._training({}).model_dump(mode="json"), self.file({}))
        return {name: next((value for table in tables if (value := _at(table, name)) is not None), None) for name in self.search}

    @property
    def reports(self) -> int:
        training = self._training({})
        return 1 + -(-training.steps // training.evaluation.every)

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        costs: list[float] = []

        def watch(row: Mapping[str, float]) -> None:
            costs.append(row_cost(row, training.evaluation.episodes, lost))
            report(costs[-1])

        training = self._training(values)
        lost = LOST * rod_length(resolved_scene(Options.parse(training.options, "options")))
        try:
            self._train(training, folder, watch)
        finally:
            shutil.rmtree(folder / "last", ignore_errors=True)  # nothing goes on from it
        return min(costs)

    def judge(self, values: Mapping[str, Any], folder: Path) -> Array:
        """Costs [m] (seeds, episodes): errors of the best agent of every training."""
        costs = []
        for k in range(1, self.seeds + 1):
            training = self._training(values, seed=self._training({}).seed + k)
            own = folder / f"seed_{training.seed}"
            self._train(training, own, None)
            best, skip = str(own / "best"), training.evaluation.skip
            make = partial(load_policy, best)
            scores = validation_scores(make, training.task, training.options, SEEDS["evaluation"], training.seconds, skip)
            costs.append([LOST * score.length if score.diverged else next(iter(score.errors.values())).rms for score in scores])
        return np.array(costs)

    @staticmethod
    def _train(training: Training, folder: Path, watch: Any) -> None:
        from soft_tendon_env.learning import train

        folder.mkdir(parents=True, exist_ok=True)
        train.train(training, folder, train.checkpoint_to_resume(folder, training, resume=True), watch)


def row_cost(row: Mapping[str, float], episodes: int, lost: float) -> float:
    """Cost [m] of a row of a learning curve: the first error, and `lost` of episodes that diverged."""
    error = next(value for name, value in row.items() if name.endswith("_rms"))
    share = row["diverged"] / episodes
    return lost if share == 1.0 else (1.0 - share) * error + share * lost


def _flat(tables: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Values of nested tables by dotted keys."""
    found: dict[str, Any] = {}
    for name, value in tables.items():
        found |= _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else {f"{before}{name}": value}
    return found


def _at(table: Mapping[str, Any], name: str) -> Any:
    """Value at a dotted key, with positions in arrays as in learning_rate[0]; None without."""
    value: Any = table
    for part in name.replace("[", ".").replace("]", "").split("."):
        if isinstance(value, Mapping):
            value = value.get(part)
        else:
            value = value[int(part)] if isinstance(value, list) and part.isdecimal() and int(part) < len(value) else None
    return value
