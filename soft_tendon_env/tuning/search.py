"""Searches: parameters of a controller or keys of a training, as a file such as
configs/tune_predictive.toml says.

Either way a trial makes a policy, and its cost [m] is `tracking_cost` on the tuning seeds.
"""

import json
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from optuna.trial import Trial
from pydantic import Field, model_validator

from soft_tendon_env.envs import IDS
from soft_tendon_env.evaluation.conditions import NOMINAL, SEEDS, SETTINGS
from soft_tendon_env.evaluation.experiment import believed_scene
from soft_tendon_env.evaluation.play import evaluate_rows
from soft_tendon_env.evaluation.settings import RegimeNames, SettingNames, TaskName, episode_steps
from soft_tendon_env.evaluation.summaries import tracking_cost
from soft_tendon_env.learning.config import Training, find_config
from soft_tendon_env.policies import load_policy
from soft_tendon_env.policies.agent import EnvironmentOptions
from soft_tendon_env.policies.names import Controller, PolicyName
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    override,
    parsed_changes,
    read_toml,
)
from soft_tendon_env.tools.types import NotNegative, Positive

Report = Callable[
    [float], None
]  # takes the cost [m] of a trial so far; raises optuna.TrialPruned where it is not worth going on


class Parameter(Configuration):
    """Range of one parameter, of whole numbers where both ends are; or choices."""

    low: int | float | None = None
    high: int | float | None = None
    log: bool = False
    choices: tuple[Any, ...] = ()

    @model_validator(mode="after")
    def _is_a_range(self) -> "Parameter":
        is_range = False
        if self.low is not None and self.high is not None:
            is_positive = self.low > 0
            is_range = self.low < self.high and (is_positive or not self.log)
        if is_range == bool(self.choices):
            text = (
                "is no range: it should have low < high (both positive where log = true),"
                " or choices"
            )
            raise ConfigurationError([Problem((), text)])
        return self

    def suggest(self, trial: Trial, name: str) -> Any:
        """Value that a trial tries; Optuna keeps choices as JSON."""
        if self.choices:
            choices = [json.dumps(choice) for choice in self.choices]
            return json.loads(trial.suggest_categorical(name, choices))
        if isinstance(self.low, int) and isinstance(self.high, int):
            return trial.suggest_int(name, self.low, self.high, log=self.log)
        assert self.low is not None and self.high is not None  # a range has both, see _is_a_range
        return trial.suggest_float(name, self.low, self.high, log=self.log)


class Search(Configuration, ABC):
    """Hyperparameter search."""

    trials: int = Field(default=20, ge=1)  # of the study, of all machines that share it together
    seed: int = Field(
        default=0, ge=0, lt=2**31
    )  # of the sampler (tree-structured Parzen estimator)
    search: dict[str, Parameter] = Field(
        min_length=1
    )  # by name of a parameter {low, high, log} or {choices}
    episodes: int = Field(
        default=len(SEEDS["tuning"]), ge=1, le=len(SEEDS["tuning"])
    )  # tuning seeds that are played in every condition

    @abstractmethod
    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Mean cost [m] of values over the tuning seeds. folder: for what is learned. Raises
        ValueError, UserError."""

    @abstractmethod
    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of a file that uses these values."""

    def play(
        self,
        make: Callable[[Any], Policy],
        task: str,
        options: Mapping[str, Any],
        seconds: float,
        skip: float,
    ) -> float:
        """Cost [m] of a policy over the tuning seeds, under one condition."""
        steps = episode_steps(seconds, skip, options)
        with closing(
            gym.make_vec(IDS[task], num_envs=self.episodes, max_episode_steps=steps, **options)
        ) as envs:
            return tracking_cost(
                evaluate_rows(make(envs), envs, SEEDS["tuning"][: self.episodes], skip)
            )


class ControllerSearch(Search):
    """Search for parameters of a controller: its cost is the geometric mean over all settings in
    all information regimes.

    Parameters are the keyword arguments of its class, and those of control.kalman.Uncertainty with
    "estimator." before them.
    """

    policy: str  # name of the controller, such as adaptive:predictive@fast
    task: TaskName = "TipPose"
    # what is observed, with noise; none: what the controller needs, exactly
    regimes: RegimeNames = ()
    settings: SettingNames = (
        NOMINAL,
    )  # of the benchmark, in which it is played; the model of the controller knows nothing of them
    seconds: Positive = 3.0  # length of an episode
    skip: NotNegative = 1.0  # [s] from which on errors count
    options: EnvironmentOptions = Field(
        default={}
    )  # of the environment; `randomize` says how arms differ from the controller's model

    @model_validator(mode="after")
    def _fits(self) -> "ControllerSearch":
        known = self._controller({}).defaults
        for key in self.search.keys() - known.keys():
            raise ConfigurationError(
                [
                    Problem(
                        ("search", key),
                        f"is no parameter of {self.policy}: {not_among(key, known)}",
                    )
                ]
            )
        return self

    def _controller(self, values: Mapping[str, Any]) -> Controller:
        name = PolicyName.parse(self.policy, self.task)
        if not isinstance(name, Controller):
            raise ConfigurationError(
                [
                    Problem(
                        ("policy",),
                        f"is {self.policy!r}: it should be a controller, others have no parameters",
                    )
                ]
            )
        return name.with_parameters({**name.parameters, **values})

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        name, costs, scene = (
            self._controller(values),
            list[float](),
            self.options.get("scene", "paper"),
        )
        make = partial(
            name.load,
            scene=believed_scene(name, scene if isinstance(scene, Mapping) else {"scene": scene}),
        )
        for setting, regime in product(self.settings, self.regimes or (None,)):
            noise = {"noise": dict(REGIMES[regime].noise)} if regime else {}
            given = {
                **name.options(self.options, regime),
                "randomize": {**noise, **self.options.get("randomize", {})},
            }
            costs.append(
                self.play(
                    make, self.task, SETTINGS[setting].options(given), self.seconds, self.skip
                )
            )
            report(float(np.exp(np.mean(np.log(costs)))))
        return float(np.exp(np.mean(np.log(costs))))

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {"policy": self.policy, "parameters": dict(self._controller(values).parameters)}


class TrainingSearch(Search):
    """Search for keys of a training by the best agent of a short one."""

    training: str  # name of a training that ships, or path of a TOML file
    set: dict[str, Any] = Field(
        default={}
    )  # dotted keys of it that all trials change, such as steps = 60_000

    @model_validator(mode="after")
    def _fits(self) -> "TrainingSearch":
        try:
            find_config(self.training)
        except ConfigurationError as error:
            raise ConfigurationError(
                Problem(("training",), text) for _, text in error.problems
            ) from error
        for name, parameter in self.search.items():
            for value in parameter.choices or (parameter.low, parameter.high):
                Training.parse(self.file({name: value}), self.training)
        return self

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        from soft_tendon_env.learning import train

        training = Training.parse(self.file(values), self.training)
        try:
            train.train(
                training,
                folder,
                watch=lambda row: report(next(row[name] for name in row if name.endswith("_rms"))),
            )
        finally:
            shutil.rmtree(folder / "last", ignore_errors=True)  # nothing goes on from it
        make = partial(load_policy, str(folder / "best"))
        return self.play(
            make, training.task, training.options, training.seconds, training.evaluation.skip
        )

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        table = read_toml(find_config(self.training))
        override(table, {**self.set, **values})
        return table


def read_search(
    path: Path, changes: tuple[str, ...] = (), **more: Any
) -> ControllerSearch | TrainingSearch:
    """The search of a file, with `changes` "key=value" and `more` keys. Raises ConfigurationError,
    ValueError."""
    table = read_toml(path)
    override(table, parsed_changes(changes))
    return (TrainingSearch if "training" in table else ControllerSearch).parse(
        {**table, **more}, str(path)
    )
