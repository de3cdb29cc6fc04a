"""Searches: parameters of a controller or keys of a training.

A file such as configs/tune_predictive.toml says them.

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
from typing import Annotated, Any

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
from soft_tendon_env.learning.config import Training, find_config, read_table
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

Report = Callable[[float], None]
"""Takes the cost [m] of a trial so far; raises optuna.TrialPruned where it is not worth going
on."""


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
            allows_log = is_positive or not self.log
            is_range = self.low < self.high and allows_log
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
            choice = trial.suggest_categorical(name, choices)
            return json.loads(choice)
        low = self.low
        high = self.high
        # a range has both, see _is_a_range
        assert low is not None
        assert high is not None
        if isinstance(low, int) and isinstance(high, int):
            return trial.suggest_int(name, low, high, log=self.log)
        return trial.suggest_float(name, low, high, log=self.log)


class Search(Configuration, ABC):
    """Hyperparameter search."""

    trials: int = Field(default=20, ge=1)  # of the study, of all machines that share it together
    # of the sampler (tree-structured Parzen estimator)
    seed: int = Field(default=0, ge=0, lt=2**31)
    # by name of a parameter {low, high, log} or {choices}
    search: dict[str, Parameter] = Field(min_length=1)
    # tuning seeds that are played in every condition
    episodes: int = Field(default=len(SEEDS["tuning"]), ge=1, le=len(SEEDS["tuning"]))
    # best trials, which are played again on the other tuning seeds: the best there is the best of
    # the study, since that of many on the same seeds is so by luck too; 0: there are none
    finalists: int = Field(default=0, ge=0)
    _seeds: tuple[int, ...] = ()  # which are played

    @model_validator(mode="after")
    def _has_seeds(self) -> "Search":
        self._seeds = tuple(SEEDS["tuning"][: self.episodes])
        if self.finalists and not self._other_seeds():
            text = f"is {self.finalists}, and `episodes` has all tuning seeds: it should be 0"
            raise ConfigurationError([Problem(("finalists",), text)])
        return self

    def _other_seeds(self) -> tuple[int, ...]:
        """Tuning seeds that trials do not play."""
        return tuple(SEEDS["tuning"][self.episodes :])

    def of_finals(self) -> "Search":
        """Returns the search on the tuning seeds that its trials do not play.

        Returns:
            A search, whose `final_cost` is that of a finalist.
        """
        finals = self.model_copy()
        finals._seeds = self._other_seeds()
        return finals

    @abstractmethod
    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Computes the cost of values: the mean over the tuning seeds.

        Args:
            values: of the parameters, by name.
            folder: for files that a trial makes.
            report: is called with the cost so far [m], and may end the trial.

        Returns:
            Mean cost [m].

        Raises:
            ValueError: for values that cannot be used.
            UserError: for a training that failed.
        """

    def final_cost(self, values: Mapping[str, Any], folder: Path) -> float:
        """Computes the cost of a finalist.

        Args:
            values: of the parameters, by name.
            folder: with the files that its trial has made.

        Returns:
            Mean cost [m].

        Raises:
            ValueError: for values that cannot be used.
        """
        return self.cost(values, folder, lambda cost: None)

    @abstractmethod
    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the tables of a file that uses values.

        Args:
            values: of the parameters, by name.

        Returns:
            Tables as of TOML.
        """

    def first_values(self) -> dict[str, Any]:
        """Returns values to try first: those in use without a search.

        Returns:
            Values by name of the parameter; none by default.
        """
        return {}

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
        made = gym.make_vec(
            IDS[task],
            num_envs=len(self._seeds),
            max_episode_steps=steps,
            **options,
        )
        with closing(made) as envs:
            scores = evaluate_rows(make(envs), envs, self._seeds, skip)
        return tracking_cost(scores)


class ControllerSearch(Search):
    """Search for parameters of a controller.

    Its cost is the geometric mean over all settings in all information regimes.
    Parameters are the keyword arguments of its class, and those of control.uncertainty.Uncertainty
    with "estimator." before them.
    """

    policy: str  # name of the controller, such as filtered:predictive@standard
    task: TaskName = "TipPose"
    # what is observed, with noise; none: what the controller needs, exactly
    regimes: RegimeNames = ()
    # of the benchmark, in which it is played; the model of the controller knows nothing of them
    settings: SettingNames = (NOMINAL,)
    # and settings that act at once: what is best in each by itself may lose arms in two
    together: tuple[Annotated[SettingNames, Field(strict=False)], ...] = ()
    seconds: Positive = 3.0  # length of an episode
    skip: NotNegative = 1.0  # [s] from which on errors count
    # of the environment; `randomize` says how arms differ from the controller's model
    options: EnvironmentOptions = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> "ControllerSearch":
        known = self._controller({}).defaults
        unknown = self.search.keys() - known.keys()
        for key in unknown:
            text = f"is no parameter of {self.policy}: {not_among(key, known)}"
            problem = Problem(("search", key), text)
            raise ConfigurationError([problem])
        return self

    def _controller(self, values: Mapping[str, Any]) -> Controller:
        name = PolicyName.parse(self.policy, self.task)
        if not isinstance(name, Controller):
            text = f"is {self.policy!r}: it should be a controller, others have no parameters"
            problem = Problem(("policy",), text)
            raise ConfigurationError([problem])
        parameters = {**name.parameters, **values}
        return name.with_parameters(parameters)

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Computes the geometric mean of the costs over all settings and regimes."""
        name = self._controller(values)
        scene = self.options.get("scene", "paper")
        if isinstance(scene, Mapping):
            changes = scene
        else:
            changes = {"scene": scene}
        make = partial(name.load, scene=believed_scene(name, changes))
        costs = []
        mean = np.nan
        regimes = self.regimes or (None,)
        alone = [(setting,) for setting in self.settings]
        for settings, regime in product([*alone, *self.together], regimes):
            options = self._options(name, regime)
            for setting in settings:
                options = SETTINGS[setting].options(options)
            cost = self.play(make, self.task, options, self.seconds, self.skip)
            costs.append(cost)
            logarithm = np.mean(np.log(costs))
            mean = float(np.exp(logarithm))
            report(mean)
        return mean

    def first_values(self) -> dict[str, Any]:
        """Returns the controller's values in use.

        Returns:
            Values by name, of parameters whose range has them.
        """
        controller = self._controller({})
        known = {**controller.defaults, **controller.parameters}
        values = {}
        for name, parameter in self.search.items():
            low = parameter.low
            high = parameter.high
            if low is not None and high is not None and low <= known[name] <= high:
                values[name] = known[name]
        return values

    def _options(self, name: Controller, regime: str | None) -> dict[str, Any]:
        """Options of the environment in an information regime; None: exact, what it needs."""
        randomize: dict[str, Any] = {}
        if regime is not None:
            noise = REGIMES[regime].noise
            randomize["noise"] = dict(noise)
        randomize |= self.options.get("randomize", {})
        options = name.options(self.options, regime)
        return {**options, "randomize": randomize}

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the tables of a tuned controller."""
        parameters = self._controller(values).parameters
        return {"policy": self.policy, "parameters": dict(parameters)}


class TrainingSearch(Search):
    """Search for keys of a training by the best agent of a short one."""

    training: str  # name of a training that ships, or path of a TOML file
    # dotted keys of it that all trials change, such as steps = 60_000
    set: dict[str, Any] = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> "TrainingSearch":
        try:
            find_config(self.training)
        except ConfigurationError as error:
            problems = [Problem(("training",), text) for _, text in error.problems]
            raise ConfigurationError(problems) from error
        for name, parameter in self.search.items():
            for value in parameter.choices or (parameter.low, parameter.high):
                Training.parse(self.file({name: value}), self.training)
        return self

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        """Computes the cost of the best agent of a short training."""
        from soft_tendon_env.learning import train

        training = Training.parse(self.file(values), self.training)

        def watch(row: Mapping[str, float]) -> None:
            first = next(name for name in row if name.endswith("_rms"))
            report(row[first])

        try:
            train.train(training, folder, watch=watch)
        finally:
            shutil.rmtree(folder / "last", ignore_errors=True)  # nothing goes on from it
        return self.final_cost(values, folder)

    def final_cost(self, values: Mapping[str, Any], folder: Path) -> float:
        """Computes the cost of the best agent that a training has left in a folder.

        See Search.final_cost.
        """
        training = Training.parse(self.file(values), self.training)
        return self.play(
            partial(load_policy, str(folder / "best")),
            training.task,
            training.options,
            training.seconds,
            training.evaluation.skip,
        )

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the tables of the training with these values."""
        table = read_table(find_config(self.training))
        override(table, {**self.set, **values})
        return table


def read_search(
    path: Path, changes: tuple[str, ...] = (), **more: Any
) -> ControllerSearch | TrainingSearch:
    """Reads a search from a file, with changes.

    Args:
        path: of the TOML file.
        changes: "key=value" with dotted keys, as of `--set`.
        more: values of keys of the file's top, by name.

    Returns:
        A search for a training where the file has the key, else one for a controller.

    Raises:
        ConfigurationError: for keys and values that are not allowed.
        ValueError: for changes that cannot be read.
    """
    table = read_toml(path)
    override(table, parsed_changes(changes))
    values = {**table, **more}
    if "training" in table:
        return TrainingSearch.parse(values, str(path))
    return ControllerSearch.parse(values, str(path))
