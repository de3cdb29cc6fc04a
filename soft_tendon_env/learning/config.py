"""Configuration of a training: the keys of the files in configs/, read strictly, and what `--set key=value` changes of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation import SEEDS, VALIDATION_SEEDS
from soft_tendon_env.evaluation.settings import TaskName, episode_steps
from soft_tendon_env.learning.hyperparameters import (
    APG,
    DAGGER,
    PositiveShare,
    Share,
    Size,
    explain,
    learns_from_replay,
    misfits,
    problems_of,
    trained_algorithms,
)
from soft_tendon_env.policies.agent_files import INTERFACE
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    override,
    parsed_changes,
    read_toml,
    shown,
)
from soft_tendon_env.tools.files import configs_folder
from soft_tendon_env.tools.types import NotNegative, Positive

MOST_ARMS, MOST_THREADS = 100_000, 256
"""More arms than Stable-Baselines3 can look after in minutes, and more threads than can be started in seconds."""
RATE = Annotated[PositiveShare | tuple[Share, Share], explain("should be a number above 0 and at most 1, or [first, last]")]


class Stage(Configuration):
    """One stage of a curriculum: `options` that go before the training's own from step `start` on, until the next stage."""

    start: int = Field(ge=0)
    options: dict[str, Any]


class Normalisation(Configuration):
    """Normalisation of observations and rewards by VecNormalize of Stable-Baselines3: running mean and standard deviation.

    By default observations keep the scales that the environment gives them, about one and the same for ever. Under running statistics a
    few arms that whirl change what all others see, and by that the gains of the policy, outside of what PPO limits (ratio, KL).

    Attributes:
        observations: less their running mean, divided by their standard deviation so far.
        frozen_from: step from which on mean and deviation of observations stay as they are, after a warm-up; None: never.
        rewards: divided by the standard deviation of the discounted return so far.
        clip: what of either is cut off beyond so many deviations.
    """

    observations: bool = False
    frozen_from: int | None = Field(default=None, ge=1)
    rewards: bool = True
    clip: Positive = 10.0

    @model_validator(mode="after")
    def _fits(self) -> "Normalisation":
        if self.frozen_from is not None and not self.observations:
            text = f"is {self.frozen_from}: it needs observations = true, without which there are no statistics to freeze"
            raise ConfigurationError([Problem(("frozen_from",), text)])
        return self


class Evaluation(Configuration):
    """Validation after every so many steps, without exploration, on the first `episodes` validation seeds; errors count from `skip` [s] on.

    The arm is randomised as in training, without its curriculum.
    """

    every: int = Field(default=100_000, ge=1)
    episodes: int = Field(default=20, ge=1, le=len(VALIDATION_SEEDS))
    skip: NotNegative = 1.0


class Hindsight(Configuration):
    """Hindsight experience replay (HER), for tasks with goals: for each transition as it was, `goals` with goals reached later."""

    goals: int = Field(default=4, ge=1)
    strategy: Literal["future", "final", "episode"] = "future"


class Training(Configuration):
    """Training of one agent, by reinforcement learning or by imitation of a teacher.

    Attributes:
        task, algorithm: names of what is to be learned, and of the algorithm.
        steps: number of steps of all arms together.
        arms: number of arms that move side by side.
        seconds: length of an episode.
        seed: seed of networks, arms and exploration.
        threads: number of threads of PyTorch and of the environment. One is best where several trainings run side by side, and makes them
            repeatable.
        learning_rate: a number, or (first, last) with a straight line between them.
        hyperparameters: further arguments of the algorithm in Stable-Baselines3, by its names, see hyperparameters.py.
        options: options of the environment, see `soft_tendon_env.envs.Options`.
        curriculum: stages, in the order of their starts. They may change anything but what is observed and what actions mean.
        start_from: folder of an agent whose network it begins with, such as `last/` of another run, to be refined. Observations,
            actions and network have to be the same; None: a new network.
        critic_steps: steps for which the critic learns alone, before the policy moves: of PPO from an agent whose critic has learned
            nothing, such as one of DAgger.
        asymmetric_critic: tell the critic, not the policy, the parameters that `options.randomize` draws for every arm (asymmetric
            actor-critic), see asymmetric_critic.py. Agents are saved without what it was told.
        integral_time: [s], integral action around the agent once it acts, see policies/integral.py: in a constant error's way to the target
            that is added again. It learns without, where the critic sees all that it is judged by; it is evaluated with. None: none.
        hindsight: experience replay, for SAC, TQC and CrossQ on tasks with goals, such as Reach.
        checkpoint_every: steps between checkpoints.
        checkpoint_seconds: wall time [s] after which there is one, however few the steps were: what a kill loses at most. It is longer
            only where a checkpoint itself takes more than a twentieth of it, as that of a large replay buffer does.
    """

    task: TaskName
    algorithm: str
    steps: int = Field(ge=1)
    arms: int = Field(default=64, ge=1, le=MOST_ARMS)
    seconds: Positive = 10.0
    seed: int = Field(default=0, ge=0, lt=2**32)
    threads: int = Field(default=1, ge=1, le=MOST_THREADS)
    learning_rate: RATE = 3e-4
    hyperparameters: dict[str, Any] = Field(default={})
    options: dict[str, Any] = Field(default={})
    curriculum: tuple[Stage, ...] = ()
    normalise: Normalisation = Normalisation()
    start_from: str | None = Field(default=None, min_length=1)
    critic_steps: int = Field(default=0, ge=0)
    asymmetric_critic: bool = False
    integral_time: Positive | None = None
    hindsight: Hindsight | None = None
    evaluation: Evaluation = Evaluation()
    checkpoint_every: int = Field(default=100_000, ge=1)
    checkpoint_seconds: Positive = 60.0

    @property
    def has_goals(self) -> bool:
        """True for a task whose observations have goals, as those of Reach."""
        return TASKS[self.task].goal is not None

    def arm_seed(self, done: int = 0) -> int:
        """First arm's seed for `reset`, of a training that has done so many steps; those of the others follow, one apart.

        Other ones for every training and every part of it, above all that policies are judged on.
        """
        return SEEDS["training"].start + int(np.random.SeedSequence((self.seed, done)).generate_state(1, np.uint64)[0] >> np.uint64(16))

    @field_validator("algorithm")
    @classmethod
    def _is_trained(cls, algorithm: str) -> str:
        if algorithm not in (names := trained_algorithms()):
            raise ValueError(f"should be an algorithm to train with: {not_among(algorithm, names)}")
        return algorithm

    @field_validator("options")
    @classmethod
    def _of_an_environment(cls, options: dict[str, Any]) -> dict[str, Any]:
        check_options(options)
        return options

    @model_validator(mode="after")
    def _fits(self) -> "Training":
        problems = [*self._of_episodes(), *self._of_the_curriculum()]
        if self.hindsight is not None and not (self.has_goals and learns_from_replay(self.algorithm)):
            text = f"is for SAC, TQC and CrossQ on tasks with goals, such as Reach, not for {self.algorithm} on {self.task}"
            problems.append(Problem(("hindsight",), text))
        if self.integral_time is not None:
            problems += self._of_integral_action(self.integral_time)
        of_ppo = not (learns_from_replay(self.algorithm) or self.algorithm in (APG, DAGGER))
        if self.critic_steps and not (of_ppo and self.start_from):
            text = f"is {self.critic_steps}: it is for PPO with start_from, whose policy has learned already"
            problems.append(Problem(("critic_steps",), text))
        if self.asymmetric_critic:
            problems += self._of_the_critic()
        if self.algorithm == DAGGER and self.normalise.observations:
            problems.append(Problem(("normalise", "observations"), f"is true: {DAGGER} has a scale of its own for what it observes"))
        if problems:
            raise ConfigurationError(problems)
        return self

    def _of_integral_action(self, time: float) -> list[Problem]:
        """Problems with integral action."""
        key, period = ("integral_time",), Options.parse(self.options, "options").control_period
        return [] if time >= period else [Problem(key, f"is {time:g}: it should be at least a control period, {period:g} s")]

    def _of_the_critic(self) -> list[Problem]:
        """Problems with a critic that is told what is drawn."""
        key, network = ("asymmetric_critic",), self.hyperparameters.get("policy_kwargs") or {}
        if self.algorithm not in ("PPO", "SAC", "TQC"):
            return [Problem(key, f"is true: it is for PPO, SAC and TQC, not for {self.algorithm}")]
        other = {"normalise.observations": self.normalise.observations, "share_features_extractor": network.get("share_features_extractor")}
        return [Problem(key, f"is true: it does not go with {name} = true") for name, given in other.items() if given]

    def _of_episodes(self) -> list[Problem]:
        """Problems with the length of episodes, and with hyperparameters."""
        found = problems_of(self.algorithm, self.hyperparameters)
        try:
            steps = episode_steps(self.seconds, self.evaluation.skip, self.options)
        except ValueError as error:
            return [*found, Problem((), str(error))]
        size = Size(self.arms, self.steps, steps, goals=self.has_goals, hindsight=self.hindsight is not None)
        return found or misfits(self.algorithm, self.hyperparameters, size)

    def _of_the_curriculum(self) -> list[Problem]:
        starts = [stage.start for stage in self.curriculum]
        rising = starts == sorted(set(starts))
        problems = [] if rising else [Problem(("curriculum",), f"starts at {starts}: each stage should start after the one before")]
        for index, stage in enumerate(self.curriculum):
            key = ("curriculum", index, "options")
            problems += [
                Problem((*key, name), f"is {shown(stage.options[name])}: a stage cannot change it, the agent learned what it means")
                for name in INTERFACE
                if name in stage.options and stage.options[name] != self.options.get(name)
            ]
            try:
                check_options(options := {**self.options, **stage.options})
                self.episode_steps(options)
            except ConfigurationError as error:
                problems += [Problem((*key, *inner), text) for inner, text in error.problems]
            except ValueError as error:
                problems.append(Problem(key, f"do not fit: {error}"))
        return problems

    def episode_steps(self, options: dict[str, Any]) -> int:
        """Number of control periods of an episode in an environment with these options. Raises ValueError."""
        return episode_steps(self.seconds, 0.0, options)

    def options_at(self, step: int) -> dict[str, Any]:
        """Options of the environment at a step of the training, by its curriculum."""
        begun = [stage.options for stage in self.curriculum if stage.start <= step]
        return {**self.options, **(begun[-1] if begun else {})}


def check_options(options: dict[str, Any]) -> None:
    """Raises ConfigurationError where options, or the scene that they name, cannot be."""
    parsed = Options.parse(options, "options")
    try:
        resolved_scene(parsed)
    except ConfigurationError as error:
        raise ConfigurationError([Problem(("scene",), f"cannot be used: {line}") for line in str(error).splitlines()], "options") from error


NO_TRAININGS = ("compare", "published", "tune_")
"""Prefixes of the files in configs/ that are no trainings."""


def config_names(prefix: str = "") -> tuple[str, ...]:
    """Names of the trainings that ship, sorted; those of other files without their prefix."""
    stems = sorted(path.stem for path in configs_folder().glob(f"{prefix}*.toml"))
    return tuple(stem.removeprefix(prefix) for stem in stems if prefix or not stem.startswith(NO_TRAININGS))


def find_config(name_or_path: str | Path, prefix: str = "") -> Path:
    """Path of the file of a training that ships (or of another kind, by its prefix), by its name, or of any other, by its path.

    Raises ConfigurationError.
    """
    name, names = str(name_or_path), config_names(prefix)
    if name in names and not Path(name).is_file():
        return configs_folder() / f"{prefix}{name}.toml"
    if Path(name).suffix != ".toml" and not Path(name).exists():
        text = f"is neither the path of a .toml file nor a {'search' if prefix else 'training'} that ships: {not_among(name, names)}"
        raise ConfigurationError([Problem((), text)], name)
    return Path(name)


def read_training(path: Path, changes: Sequence[str] = (), **more: Any) -> Training:
    """Training of a file, overridden by `changes` "key=value" and by `more` keys. Raises ConfigurationError, ValueError."""
    table, source = read_toml(path), f"{path}, changed"
    Training.parse(table, str(path))
    given = parsed_changes(changes)
    if twice := given.keys() & more.keys():
        raise ValueError(f"--set has {min(twice)}, which is given twice")
    try:
        override(table, given)
    except ConfigurationError as error:
        raise ConfigurationError(error.problems, source) from error
    return Training.parse({**table, **more}, source if changes or more else str(path))
