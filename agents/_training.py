"""What a training is: the keys of the files in configs/ that train.py reads, strictly.

Every key is an attribute of `Training`; `--set key=value` goes before what a file says, with dotted keys such as options.fidelity.
"""

import inspect
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from _agents import algorithm_class
from _residual import ResidualSettings
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.configuration import Configuration, ConfigurationError, Problem, not_among, override
from soft_tendon_env.envs import Options
from soft_tendon_env.scene import NotNegative, Positive

OTHERWISE = ("self", "policy", "env", "learning_rate", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model")
REPLAY = ("replay_buffer_class", "replay_buffer_kwargs")
"""Arguments of the algorithms that other keys say."""


class Stage(Configuration):
    """One stage of a curriculum: `options` that go before the training's own from step `start` on, until the next stage."""

    start: int = Field(ge=0)
    options: dict[str, Any]


class Normalisation(Configuration):
    """Whether observations and rewards are divided by their standard deviations so far, and what of them is cut off beyond so many."""

    observations: bool = True
    rewards: bool = True
    clip: Positive = 10.0


class Evaluation(Configuration):
    """After every so many steps, without exploration, on the first `episodes` evaluation seeds; errors count from `skip` [s] on.

    The arm is randomised as in training, without its curriculum.
    """

    every: int = Field(default=100_000, ge=1)
    episodes: int = Field(default=20, ge=1, le=20)
    skip: NotNegative = 1.0


class Hindsight(Configuration):
    """Hindsight experience replay (HER), for Reach: for each transition as it was, `goals` with goals that were reached later."""

    goals: int = Field(default=4, ge=1)
    strategy: Literal["future", "final", "episode"] = "future"


class Training(Configuration):
    """One training.

    Attributes:
        task, algorithm: what is to be learned, and how.
        steps: of all arms together.
        arms: that move side by side.
        seconds: length of an episode.
        seed: of the networks, of the arms and of the exploration.
        threads: of PyTorch and of the environment. One is best where several trainings run side by side, and makes them repeatable.
        learning_rate: a number, or (first, last) with a straight line between them.
        hyperparameters: further arguments of the algorithm in Stable-Baselines3, by its names.
        options: of the environment, see `soft_tendon_env.envs.Options`.
        curriculum: stages, in the order of their starts. They may change anything but what is observed and what actions mean.
        residual: add the agent's actions to those of a controller.
        hindsight: experience replay, for SAC and TQC on Reach.
        checkpoint_every: steps between checkpoints.
    """

    task: Literal["TipPose", "Shape", "Reach"]
    algorithm: Literal["PPO", "SAC", "TQC"]
    steps: int = Field(ge=1)
    arms: int = Field(default=64, ge=1)
    seconds: Positive = 10.0
    seed: int = Field(default=0, ge=0)
    threads: int = Field(default=1, ge=1)
    learning_rate: Positive | tuple[NotNegative, NotNegative] = 3e-4
    hyperparameters: dict[str, Any] = Field(default={})
    options: dict[str, Any] = Field(default={})
    curriculum: tuple[Stage, ...] = ()
    normalise: Normalisation = Normalisation()
    residual: ResidualSettings | None = None
    hindsight: Hindsight | None = None
    evaluation: Evaluation = Evaluation()
    checkpoint_every: int = Field(default=100_000, ge=1)

    @field_validator("options")
    @classmethod
    def _of_an_environment(cls, options: dict[str, Any]) -> dict[str, Any]:
        Options.parse(options, "options")
        return options

    @model_validator(mode="after")
    def _fits(self) -> "Training":
        arguments = inspect.signature(algorithm_class(self.algorithm).__init__).parameters
        known = [name for name in arguments if name not in (*OTHERWISE, *REPLAY)]
        problems = [
            Problem(("hyperparameters", name), f"is no argument of {self.algorithm}: {not_among(name, known)}")
            for name in self.hyperparameters
            if name not in known
        ]
        if self.hindsight is not None and (self.task != "Reach" or self.algorithm == "PPO"):
            problems.append(Problem(("hindsight",), f"is for SAC and TQC on Reach, not for {self.algorithm} on {self.task}"))
        starts = [stage.start for stage in self.curriculum]
        if starts != sorted(set(starts)):
            problems.append(Problem(("curriculum",), f"starts at {starts}: each stage should start after the one before"))
        for index, stage in enumerate(self.curriculum):
            try:
                Options.parse({**self.options, **stage.options}, "options")
            except ConfigurationError as error:
                problems += [Problem(("curriculum", index, "options", *key), text) for key, text in error.problems]
        if problems:
            raise ConfigurationError(problems)
        return self

    def episode_steps(self, options: dict[str, Any]) -> int:
        """Control periods of an episode in an environment with these options."""
        return max(1, round(self.seconds / Options.parse(options, "options").control_period))

    def options_at(self, step: int) -> dict[str, Any]:
        """Of the environment at a step of the training."""
        begun = [stage.options for stage in self.curriculum if stage.start <= step]
        return {**self.options, **(begun[-1] if begun else {})}


def read_training(path: Path, changes: Sequence[str] = (), **more: Any) -> Training:
    """A file's, with `changes` "key=value" and `more` keys before it. Raises ConfigurationError, ValueError, OSError."""
    with open(path, "rb") as file:
        table = tomllib.load(file)
    Training.parse(table, str(path))
    override(table, dict(parsed_change(change) for change in changes))
    return Training.parse({**table, **more}, str(path) if not (changes or more) else f"{path}, changed")


def parsed_change(change: str) -> tuple[str, Any]:
    """Key and value of "dotted.key=value", the value as in TOML or else a text. Raises ValueError."""
    key, equals, text = change.partition("=")
    if not equals or not key.strip():
        raise ValueError(f"{change!r} should be KEY=VALUE, such as options.fidelity=fast")
    try:
        return key.strip(), tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), text
