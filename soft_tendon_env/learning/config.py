"""Configuration of a training: the keys of the files in configs/, read strictly, and what `--set key=value` changes of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import check_fit, groups_of, resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation import SEEDS, VALIDATION_SEEDS
from soft_tendon_env.evaluation.settings import TaskName, episode_steps
from soft_tendon_env.learning.hyperparameters import DAGGER, learns_from_replay, trained_algorithms, unknown_hyperparameters
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, override, parsed_changes, read_toml
from soft_tendon_env.tools.files import configs_folder
from soft_tendon_env.tools.types import NotNegative, Positive

MOST_ARMS, MOST_THREADS = 100_000, 256
"""More arms than Stable-Baselines3 can look after in minutes, and more threads than can be started in seconds."""
Share = Annotated[float, Field(ge=0, le=1)]


class Normalisation(Configuration):
    """Normalisation of observations and rewards by VecNormalize of Stable-Baselines3: running mean and standard deviation.

    By default observations keep the scales that the environment gives them, about one and the same for ever. Under running statistics a
    few arms that whirl change what all others see, and by that the gains of the policy, outside of what PPO limits (ratio, KL).

    Attributes:
        observations: less their running mean, divided by their standard deviation so far.
        rewards: divided by the standard deviation of the discounted return so far.
        clip: what of either is cut off beyond so many deviations.
    """

    observations: bool = False
    rewards: bool = True
    clip: Positive = 10.0


class Evaluation(Configuration):
    """Validation after every so many steps, without exploration, on the first `episodes` validation seeds; errors count from `skip` [s] on.

    The arm is randomised as in training.
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
        hyperparameters: further arguments of the algorithm, by Stable-Baselines3's names; `activation_fn` is a name in torch.nn.
        options: options of the environment, see `soft_tendon_env.envs.Options`.
        start_from: folder of an agent whose network it begins with, such as `last/` of another run, to be refined. Observations,
            actions and network have to be the same; None: a new network.
        integral_time: [s], integral action around the agent once it acts, see policies/integral.py: in a constant error's way to the target
            that is added again. It learns without, and is evaluated with. None: none.
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
    learning_rate: Share | tuple[Share, Share] = 3e-4
    hyperparameters: dict[str, Any] = Field(default={})
    options: dict[str, Any] = Field(default={})
    normalise: Normalisation = Normalisation()
    start_from: str | None = Field(default=None, min_length=1)
    integral_time: Positive | None = None
    hindsight: Hindsight | None = None
    evaluation: Evaluation = Evaluation()
    checkpoint_every: int = Field(default=100_000, ge=1)
    checkpoint_seconds: Positive = 60.0

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
        parsed = Options.parse(options, "options")
        try:
            resolved_scene(parsed)
        except ConfigurationError as error:
            problems = [Problem(("scene",), f"cannot be used: {line}") for line in str(error).splitlines()]
            raise ConfigurationError(problems, "options") from error
        return options

    @model_validator(mode="after")
    def _fits(self) -> "Training":
        problems = unknown_hyperparameters(self.algorithm, self.hyperparameters)
        options, task = Options.parse(self.options, "options"), TASKS[self.task]
        scene = resolved_scene(options)
        try:
            check_fit(options, task, scene)
            groups_of(options, task)
        except ConfigurationError as error:
            problems += [Problem(("options", *key), text) for key, text in error.problems]
        try:
            episode_steps(self.seconds, self.evaluation.skip, self.options)
        except ValueError as error:
            problems.append(Problem((), str(error)))
        if self.hindsight is not None and not (task.goal and learns_from_replay(self.algorithm)):
            text = f"is for SAC, TQC and CrossQ on tasks with goals, such as Reach, not for {self.algorithm} on {self.task}"
            problems.append(Problem(("hindsight",), text))
        if self.integral_time is not None and self.integral_time < options.control_period:
            text = f"is {self.integral_time:g}: it should be at least a control period, {options.control_period:g} s"
            problems.append(Problem(("integral_time",), text))
        if self.algorithm == DAGGER and self.normalise.observations:
            problems.append(Problem(("normalise", "observations"), f"is true: {DAGGER} has a scale of its own for what it observes"))
        if problems:
            raise ConfigurationError(problems)
        return self

    @property
    def episode_steps(self) -> int:
        """Number of control periods of an episode."""
        return episode_steps(self.seconds, 0.0, self.options)


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
