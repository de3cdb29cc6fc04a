"""Settings of experiments, as files and command lines have them.

They are episodes, conditions, policies and workers.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, Field, field_validator

from soft_tendon_env.envs import IDS, Options
from soft_tendon_env.evaluation.conditions import (
    EVALUATION_SEEDS,
    MODEL_ERRORS,
    SETTINGS,
    model_error,
)
from soft_tendon_env.policies.agent import EnvironmentOptions
from soft_tendon_env.policies.names import ALL
from soft_tendon_env.policies.regimes import REGIMES
from soft_tendon_env.tools.configuration import Configuration, not_among
from soft_tendon_env.tools.types import NotNegative, Positive


def _one_of(what: str, valid: Mapping[str, Any]) -> AfterValidator:
    """Validator of names of a table."""

    def checked(name: str) -> str:
        if name not in valid:
            hint = not_among(name, valid)
            raise ValueError(f"should be {what}: {hint}")
        return name

    return AfterValidator(checked)


ONCE = AfterValidator(lambda names: tuple(dict.fromkeys(names)))
TaskName = Annotated[str, _one_of("a task", IDS)]
SettingNames = Annotated[tuple[Annotated[str, _one_of("a setting", SETTINGS)], ...], ONCE]
RegimeNames = Annotated[tuple[Annotated[str, _one_of("an information regime", REGIMES)], ...], ONCE]
Seed = Annotated[int, Field(ge=0)]
Seeds = Annotated[tuple[Seed, ...], ONCE]


class Workers(Configuration):
    """Processes that play.

    Attributes:
        workers: processes, or on a cluster processors, side by side.
        cluster: address of a Ray cluster that plays in place of this machine; "auto": the one that
            this machine belongs to.
    """

    workers: int = Field(default=2, ge=1)
    cluster: str | None = None


class EpisodeSettings(Configuration):
    """Length of an episode, and options of its environment.

    Attributes:
        seconds: length of an episode [s].
        skip: time at the beginning of an episode that errors leave out [s].
        options: environment's options, see `soft_tendon_env.envs.Options`; every arm has what
            `randomize` says, unless a model error says otherwise.
    """

    seconds: Positive = 10.0
    skip: NotNegative = 1.0
    options: EnvironmentOptions = Field(default={})


class Settings(EpisodeSettings, Workers):
    """Conditions and episodes of an evaluation.

    Attributes:
        errors: names of model errors (soft_tendon_env.evaluation.MODEL_ERRORS), several at once
            with commas between, as in stiffness+20%,payload-20g,noise; or "all", one by one.
        episodes: number of episodes, on the first of the evaluation seeds.
    """

    errors: tuple[str, ...] = Field(default=tuple(MODEL_ERRORS), min_length=1)
    episodes: int = Field(default=len(EVALUATION_SEEDS), ge=1, le=len(EVALUATION_SEEDS))

    @field_validator("errors")
    @classmethod
    def _expand(cls, errors: tuple[str, ...]) -> tuple[str, ...]:
        every = list[str]()
        for given in errors:
            if given == ALL:
                every += MODEL_ERRORS
            else:
                every.append(given)
        for name in every:
            model_error(name)
        return tuple(dict.fromkeys(every))


MOST_STEPS = 1_000_000
"""Longest episode in control periods: beyond, memory for what is kept of every step runs out."""


def episode_steps(
    seconds: float,
    skip: float,
    options: Mapping[str, Any],
) -> int:
    """Control periods of an episode in an environment with these options.

    Raises ConfigurationError, ValueError.
    """
    period = Options.parse(options, "options").control_period
    steps = seconds / period
    if steps > MOST_STEPS:
        raise ValueError(
            f"seconds is {seconds:g}: it should be at most {MOST_STEPS} control periods,"
            f" {MOST_STEPS * period:g} s"
        )
    whole_steps = round(steps)
    skipped_steps = math.ceil(skip / period - 1e-9)
    if whole_steps < 1 or skipped_steps > whole_steps:
        raise ValueError(
            f"seconds is {seconds:g}: it should be at least one control period, {period:g} s, and"
            f" skip, which is {skip:g}"
        )
    return whole_steps
