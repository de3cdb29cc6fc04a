"""Searches: parameters of a controller or keys of a training, as a file such as configs/tune_predictive.toml says.

Either way a trial makes a policy, and its cost [m] is `tracking_cost` on the tuning seeds.
"""

import json
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import Field, model_validator

from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.play import validation_scores
from soft_tendon_env.evaluation.settings import RegimeNames, SettingNames, TaskName
from soft_tendon_env.evaluation.summaries import tracking_cost
from soft_tendon_env.learning.config import Training, find_config
from soft_tendon_env.policies import load_policy
from soft_tendon_env.policies.agent_files import EnvironmentOptions
from soft_tendon_env.policies.names import Controller, PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    override,
    parsed_changes,
    plain,
    read_toml,
)
from soft_tendon_env.tools.types import NotNegative, Positive

Report = Callable[[float], None]
"""Takes the cost [m] of a trial so far; raises optuna.TrialPruned where it is not worth going on."""
BLOCK = 3  # episodes in each condition between two reports


class Parameter(Configuration):
    """Range low to high of one parameter, of whole numbers where both are, searched on a logarithmic scale or not; or choices."""

    low: int | float | None = None
    high: int | float | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    @model_validator(mode="after")
    def _is_a_range(self) -> "Parameter":
        try:
            if bool(self.choices) == (self.low is not None and self.high is not None):
                raise ValueError("it should have low and high, or choices")
            _ = self.distribution
        except ValueError as error:
            raise ConfigurationError([Problem((), f"is no range: {error}")]) from error
        return self

    @property
    def distribution(self) -> BaseDistribution:
        """The range as Optuna has it, which keeps choices as JSON."""
        if self.choices:
            return CategoricalDistribution([json.dumps(choice) for choice in self.choices])
        whole = isinstance(self.low, int) and isinstance(self.high, int)
        return (IntDistribution if whole else FloatDistribution)(self.low, self.high, log=self.log)  # type: ignore[arg-type]

    def contains(self, value: Any) -> bool:
        """Whether a value is within the range."""
        return value in self.choices if self.choices else isinstance(value, int | float) and self.low <= value <= self.high  # type: ignore


Plan = tuple[Callable[[Any], Policy], list[dict[str, Any]], str, float, float]
"""Maker of a policy in an environment, options of the environment by condition, task, seconds of an episode, and those left out."""


class Search(Configuration, ABC):
    """Hyperparameter search.

    Attributes:
        trials: number of trials of the study, of all machines that share it together.
        seed: of the sampler (tree-structured Parzen estimator).
        search: by name of a parameter {low, high, log} or {choices}.
        episodes: number of the tuning seeds that are played in every condition.
    """

    trials: int = Field(default=20, ge=1)
    seed: int = Field(default=0, ge=0, lt=2**31)
    search: dict[str, Parameter] = Field(min_length=1)
    episodes: int = Field(default=len(SEEDS["tuning"]), ge=1, le=len(SEEDS["tuning"]))

    @property
    @abstractmethod
    def defaults(self) -> dict[str, Any]:
        """Values of the searched parameters where nothing is tuned, which the first trial has."""

    @abstractmethod
    def plan(self, values: Mapping[str, Any], folder: Path, report: Report) -> Plan:
        """How to play with these values of parameters. folder: for what is learned."""

    @abstractmethod
    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of a file that uses these values."""

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Mean cost [m] of values over the tuning seeds, reported block by block. Raises what `report` raises, ValueError, UserError."""
        seeds, costs = SEEDS["tuning"][: self.episodes], list[float]()
        make, conditions, task, seconds, skip = self.plan(values, folder, report)
        for start in range(0, len(seeds), BLOCK):
            block = seeds[start : start + BLOCK]
            found = [tracking_cost(validation_scores(make, task, options, block, seconds, skip)) for options in conditions]
            costs += [float(np.mean(found))] * len(block)
            report(float(np.mean(costs)))
        return float(np.mean(costs))


class ControllerSearch(Search):
    """Search for parameters of a controller: costs are means over conditions, every setting in every regime.

    Attributes:
        policy: name of the controller, such as adaptive:predictive@fast. Parameters are the keyword arguments of its class, and those of
            control.kalman.Uncertainty with "estimator." before them.
        task: of the environment.
        settings: names of soft_tendon_env.evaluation.conditions.SETTINGS, how arms differ from what is believed.
        regimes: names of REGIMES, what is observed, with noise; none: what the controller needs, exactly.
        seconds: length of an episode; errors count from `skip` [s] on.
        options: more options of the environment; its `randomize` overrides that of settings.
    """

    policy: str
    task: TaskName = "TipPose"
    settings: SettingNames = Field(default=("model_errors",), min_length=1)
    regimes: RegimeNames = ()
    seconds: Positive = 3.0
    skip: NotNegative = 1.0
    options: EnvironmentOptions = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> "ControllerSearch":
        if not isinstance(PolicyName.parse(self.policy, self.task), Controller):
            raise ConfigurationError([Problem(("policy",), f"is {self.policy!r}: it should be a controller, others have no parameters")])
        for key in self.search.keys() - (known := self._named({}).defaults).keys():
            raise ConfigurationError([Problem(("search", key), f"is no parameter of {self.policy}: {not_among(key, known)}")])
        return self

    def _named(self, values: Mapping[str, Any]) -> Controller:
        name = PolicyName.parse(self.policy, self.task)
        assert isinstance(name, Controller)
        return name.with_parameters({**name.parameters, **values})

    @property
    def defaults(self) -> dict[str, Any]:
        name = self._named({})
        return {key: {**name.defaults, **name.parameters}[key] for key in self.search}

    def plan(self, values: Mapping[str, Any], folder: Path, report: Report) -> Plan:
        name, base, found = self._named(values), self.options.get("scene", "paper"), []
        for setting in map(SETTINGS.__getitem__, self.settings):
            for regime in self.regimes or (None,):
                changes = setting.scene(load_scene(base)) if isinstance(base, str) else {}
                noise = {"noise": dict(REGIMES[regime].noise)} if regime else {}
                randomize = {**setting.randomize, **noise, **plain(self.options.get("randomize", {}))}
                arm = {"scene": {"scene": base, **changes}} if changes else {}
                found.append({**name.options(self.options, regime), **arm, "randomize": randomize})
        return name.load, found, self.task, self.seconds, self.skip

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {"policy": self.policy, "parameters": dict(self._named(values).parameters)}


class TrainingSearch(Search):
    """Search for keys of a training by the best agent of a short one.

    Attributes:
        training: name of a training that ships, or path of a TOML file.
        set: dotted keys of it that all trials change, such as steps = 60_000.
    """

    training: str
    set: dict[str, Any] = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> "TrainingSearch":
        try:
            find_config(self.training)
        except ConfigurationError as error:
            raise ConfigurationError(Problem(("training",), text) for _, text in error.problems) from error
        for name, parameter in self.search.items():
            for value in parameter.choices or (parameter.low, parameter.high):
                Training.parse(self.file({name: value}), self.training)
        return self

    @property
    def defaults(self) -> dict[str, Any]:
        return {name: _at(self.file({}), name) for name in self.search}

    def plan(self, values: Mapping[str, Any], folder: Path, report: Report) -> Plan:
        from soft_tendon_env.learning import train

        training = Training.parse(self.file(values), self.training)
        try:
            train.train(training, folder, watch=lambda row: report(next(row[name] for name in row if name.endswith("_rms"))))
        finally:
            shutil.rmtree(folder / "last", ignore_errors=True)  # nothing goes on from it
        make = partial(load_policy, str(folder / "best"))
        return make, [training.options], training.task, training.seconds, training.evaluation.skip

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        table = read_toml(find_config(self.training))
        override(table, {**self.set, **values})
        return table


def _at(table: Any, name: str) -> Any:
    """Value at a dotted key, with positions in arrays as in learning_rate[0]; None without."""
    for part in name.replace("[", ".").replace("]", "").split("."):
        table = table[int(part)] if isinstance(table, list) else (table or {}).get(part)
    return table


def read_search(path: Path, changes: tuple[str, ...] = (), **more: Any) -> ControllerSearch | TrainingSearch:
    """The search of a file, with `changes` "key=value" and `more` keys. Raises ConfigurationError, ValueError."""
    table = read_toml(path)
    override(table, parsed_changes(changes))
    return (TrainingSearch if "training" in table else ControllerSearch).parse({**table, **more}, str(path))
