"""Hyperparameter search: the search space, and what a kind of search is, for the keys of a file such as configs/tune_predictive.toml."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

Report = Callable[[float], None]
"""Takes the cost [m] of a trial so far; raises optuna.TrialPruned where it is not worth going on."""
PLAIN = (bool, int, float, str)


class Parameter(Configuration):
    """Range or choices of one parameter.

    Attributes:
        low, high: bounds of a range, of whole numbers where both are.
        log: whether the range is searched on a logarithmic scale.
        choices: values, in place of a range.
    """

    low: int | float | None = None
    high: int | float | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    @model_validator(mode="after")
    def _fits(self) -> "Parameter":
        if bool(self.choices) == (self.low is not None or self.high is not None):
            raise ConfigurationError([Problem((), "should have either low and high, or choices")])
        if self.choices:
            return self
        for key, value in (("low", self.low), ("high", self.high)):
            if value is None:
                raise ConfigurationError([Problem((key,), "is missing: it is required beside the other bound")])
        assert self.low is not None and self.high is not None
        if not self.low < self.high:
            raise ConfigurationError([Problem(("high",), f"is {self.high}: it should be above low, {self.low}")])
        if self.log and self.low <= 0:
            raise ConfigurationError([Problem(("low",), f"is {self.low}: it should be above 0 on a logarithmic scale")])
        return self

    @property
    def ends(self) -> dict[tuple[str | int, ...], Any]:
        """Values at the bounds, or all choices, by their keys in the file."""
        return {("choices", i): choice for i, choice in enumerate(self.choices)} or {("low",): self.low, ("high",): self.high}

    @property
    def _names(self) -> list[Any]:
        """Choices as Optuna keeps them."""
        return [choice if isinstance(choice, PLAIN) else json.dumps(choice) for choice in self.choices]

    def name_of(self, value: Any) -> Any | None:
        """A value as Optuna keeps it; None where it is not within the search space."""
        if self.choices:
            value = value if isinstance(value, PLAIN) else json.dumps(value)
            return value if value in self._names else None
        assert self.low is not None and self.high is not None
        return value if isinstance(value, int | float) and self.low <= value <= self.high else None

    def suggest(self, trial: Any, name: str) -> Any:
        """Value for a trial of Optuna."""
        if self.choices:
            return self.choices[self._names.index(trial.suggest_categorical(name, self._names))]
        whole = isinstance(self.low, int) and isinstance(self.high, int)
        return (trial.suggest_int if whole else trial.suggest_float)(name, self.low, self.high, log=self.log)


class Search(Configuration, ABC):
    """Hyperparameter search: trials, sampler, pruner and search space.

    Attributes:
        trials: number of trials of the study, of all machines that share it together.
        seed: of the sampler (tree-structured Parzen estimator).
        pruner: ends trials that are worse than others were when they had come as far: "median", below the median; "hyperband", by
            successive halving; "none".
        search: the search space: by name of a parameter {low, high, log} or {choices}.
    """

    trials: int = Field(default=20, ge=1)
    seed: int = Field(default=0, ge=0, lt=2**31)
    pruner: Literal["median", "hyperband", "none"] = "median"
    search: dict[str, Parameter] = Field(min_length=1)

    @field_validator("search", mode="before")
    @classmethod
    def _of_parameters(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        problems, found = [], {}
        for name, table in given.items():
            try:
                found[name] = table if isinstance(table, Parameter) else Parameter(**table) if isinstance(table, Mapping) else table
            except ConfigurationError as error:
                problems += [Problem((name, *key), text) for key, text in error.problems]
        if problems:
            raise ConfigurationError(problems)
        return found

    @property
    @abstractmethod
    def defaults(self) -> dict[str, Any]:
        """Values of the searched parameters where nothing is tuned; the first trial, where they are within the search space."""

    @property
    @abstractmethod
    def reports(self) -> int:
        """Number of costs that a trial reports."""

    @abstractmethod
    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Cost [m] of parameters on episodes for tuning. folder: for what it leaves. Raises what `report` raises, ValueError, UserError."""

    @abstractmethod
    def judge(self, values: Mapping[str, Any], folder: Path) -> Array:
        """Costs [m] (.., episodes) of parameters on the episodes of evaluations. Raises ValueError, UserError."""

    @abstractmethod
    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of a file that uses parameters."""
