"""Tuning of controllers and of their Kalman filters, over arms that differ from what is believed of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.evaluation.conditions import SEEDS, SETTINGS
from soft_tendon_env.evaluation.play import validation_scores
from soft_tendon_env.evaluation.settings import RegimeNames, SettingNames, TaskName, episode_steps
from soft_tendon_env.evaluation.summaries import tracking_cost
from soft_tendon_env.policies.agent_files import EnvironmentOptions
from soft_tendon_env.policies.names import Controller, PolicyName
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, not_among, plain
from soft_tendon_env.tools.types import Array, NotNegative, Positive
from soft_tendon_env.tuning.search import Report, Search

BLOCK = 3
"""Episodes in each condition between two reports of a trial's cost."""


class ControllerSearch(Search):
    """Search for parameters of a controller: costs are means over conditions, every setting in every regime.

    Attributes:
        policy: name of the controller, such as adaptive:predictive@fast. Parameters are the keyword arguments of its class, and those of
            control.kalman.Uncertainty with "estimator." before them.
        task: of the environment.
        settings: names of soft_tendon_env.evaluation.conditions.SETTINGS, how arms differ from what is believed.
        regimes: names of REGIMES there, what is observed, with noise; none: what the controller needs, exactly.
        episodes: number of the tuning seeds that are played in every condition.
        seconds: length of an episode; errors count from `skip` [s] on.
        options: more options of the environment; its `randomize` overrides that of settings.
        parameters: values of parameters that are not searched.
    """

    policy: str
    task: TaskName = "TipPose"
    settings: SettingNames = Field(default=("model_errors",), min_length=1)
    regimes: RegimeNames = ()
    episodes: int = Field(default=len(SEEDS["tuning"]), ge=1, le=len(SEEDS["tuning"]))
    seconds: Positive = 3.0
    skip: NotNegative = 1.0
    options: EnvironmentOptions = Field(default={})
    parameters: dict[str, int | float] = Field(default={})

    @model_validator(mode="after")
    def _fits(self) -> "ControllerSearch":
        name = PolicyName.parse(self.policy, self.task)
        if not isinstance(name, Controller):
            raise ConfigurationError([Problem(("policy",), f"is {self.policy!r}: it should be a controller, others have no parameters")])
        known = name.defaults
        for table, given in (("search", self.search), ("parameters", self.parameters)):
            for key in given:
                if key not in known:
                    valid = not_among(key, known) if known else "it has none"
                    raise ConfigurationError([Problem((table, key), f"is no parameter of {self.policy}: {valid}")])
        if self.regimes and name.estimator is None:
            raise ConfigurationError([Problem(("regimes",), f"are for controllers with an estimator, such as filtered:{self.policy}")])
        for options in self.conditions():
            episode_steps(self.seconds, self.skip, Options.parse(options, "options").model_dump())
        return self

    def _named(self, values: Mapping[str, Any]) -> Controller:
        name = PolicyName.parse(self.policy, self.task)
        assert isinstance(name, Controller)
        return name.with_parameters({**name.parameters, **self.parameters, **values})

    def conditions(self, values: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
        """Options of the environment in every condition, for these parameters."""
        name, base = self._named(values or {}), self.options.get("scene", "paper")
        found = []
        for setting in map(SETTINGS.__getitem__, self.settings):
            for regime in self.regimes or (None,):
                changes = setting.scene(load_scene(base)) if isinstance(base, str) else {}
                noise = {"noise": dict(REGIMES[regime].noise)} if regime else {}
                randomize = {**setting.randomize, **noise, **plain(self.options.get("randomize", {}))}
                arm = {"scene": {"scene": base, **changes}} if changes else {}
                found.append({**name.options(self.options, regime), **arm, "randomize": randomize})
        return found

    @property
    def defaults(self) -> dict[str, Any]:
        name = self._named({})
        return {key: {**name.defaults, **name.parameters}[key] for key in self.search}

    @property
    def reports(self) -> int:
        return -(-self.episodes // BLOCK)

    def cost(self, values: Mapping[str, Any], folder: Path, report: Report) -> float:
        seeds, name, costs = SEEDS["tuning"][: self.episodes], self._named(values), list[float]()
        for start in range(0, len(seeds), BLOCK):
            block = seeds[start : start + BLOCK]
            of_block = [
                tracking_cost(validation_scores(name.load, self.task, options, block, self.seconds, self.skip))
                for options in self.conditions(values)
            ]
            costs += [float(np.mean(of_block))] * len(block)
            report(float(np.mean(costs)))
        return float(np.mean(costs))

    def judge(self, values: Mapping[str, Any], folder: Path) -> Array:
        name, seeds = self._named(values), SEEDS["evaluation"]
        scores = [validation_scores(name.load, self.task, options, seeds, self.seconds, self.skip) for options in self.conditions(values)]
        return np.mean([[tracking_cost([score]) for score in of_condition] for of_condition in scores], axis=0)

    def file(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {"policy": self.policy, "parameters": dict(self._named(values).parameters)}
