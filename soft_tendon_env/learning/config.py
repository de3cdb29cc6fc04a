"""Configuration of a training: the keys of the files in configs/, read strictly.

A file may extend another, and `--set key=value` changes the keys of both.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import check_fit, groups_of, resolved_scene
from soft_tendon_env.envs.tasks import TASKS
from soft_tendon_env.evaluation import SEEDS, VALIDATION_SEEDS
from soft_tendon_env.evaluation.settings import TaskName, episode_steps
from soft_tendon_env.learning.hyperparameters import (
    APG,
    DAGGER,
    hyperparameter_problems,
    unread_names,
)
from soft_tendon_env.learning.shares import resolved
from soft_tendon_env.policies.algorithms import ALGORITHMS
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    not_registered,
    override,
    parsed_changes,
    read_toml,
    shown,
)
from soft_tendon_env.tools.files import CONFIGS
from soft_tendon_env.tools.types import NotNegative, Positive

Share = Annotated[float, Field(ge=0, le=1)]
Rate = Annotated[float, Field(ge=1e-12, le=1)]
BestBy = Literal["errors", "return"]

EXTENDS = "extends"
"""Key of a file with the training, by name or path, whose keys it has unless it says otherwise."""

WITHOUT_CRITIC = (APG, DAGGER)
"""Algorithms whose agents are all that they learn, so that a training can begin with one."""


class Normalisation(Configuration):
    """Running normalisation by VecNormalize of Stable-Baselines3.

    By default observations keep the scales of the environment: under running statistics an
    oscillating arm changes the observations of all others.
    """

    observations: bool = False
    rewards: bool = True


class Evaluation(Configuration):
    """Validation and checkpoint after every so many steps, without exploration.

    It is on the first `episodes` validation seeds, on arms as in training; errors count from `skip`
    [s] on.
    """

    # steps of all arms together between two evaluations
    every: int = Field(default=100_000, ge=1)
    # how many, on the first of the validation seeds
    episodes: int = Field(default=20, ge=1, le=len(VALIDATION_SEEDS))
    skip: NotNegative = 1.0  # time at the beginning of an episode that does not count [s]
    # the best agent has the smallest errors, or the greatest return
    best_by: BestBy = "errors"


class Training(Configuration):
    """Training of one agent, by reinforcement learning, imitation or gradients.

    Imitation is of an expert, gradients are those of the simulation.

    Attributes:
        task, algorithm: names of what is to be learned, and of the algorithm.
        steps: number of steps of all arms together.
        arms: number of arms that move side by side.
        seconds: length of an episode.
        seed: seed of networks, arms and exploration.
        learning_rate: a number, or (first, last) with a straight line between them, or with
            "geometric" behind them a straight line between their logarithms.
        hyperparameters: further arguments of the algorithm, by Stable-Baselines3's names;
            `activation_fn` is a name in torch.nn. Those that the `cost` of APG does not read are
            refused.
        options: options of the environment, see `soft_tendon_env.envs.Options`.
        integral_time: [s], integral action around the agent once it acts and is evaluated, see
            policies/integral.py; None: none.
        added_effects: numbers of effects by name, for an arm that has none such. What `randomize`
            draws of them is added to those of an arm that has them.
        start_from: agent whose weights the training begins with, the name of one that ships or a
            folder; None: random ones. What that agent has learned is not counted in `steps`.

    Numbers can be shares of the arm, such as "0.5 length": see learning/shares.py. A training has
    them, effects included, in its options, in SI units.
    """

    task: TaskName
    algorithm: str
    steps: int = Field(ge=1)
    arms: int = Field(default=64, ge=1, le=100_000)
    seconds: Positive = 10.0
    seed: int = Field(default=0, ge=0, lt=2**32)
    learning_rate: Share | tuple[Share, Share] | tuple[Rate, Rate, Literal["geometric"]] = 3e-4
    hyperparameters: dict[str, Any] = Field(default={})
    options: dict[str, Any] = Field(default={}, validate_default=True)
    normalise: Normalisation = Normalisation()
    integral_time: Positive | None = None
    evaluation: Evaluation = Evaluation()
    added_effects: dict[str, dict[str, Any]] = Field(default={})
    start_from: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _for_its_arm(cls, values: dict[str, Any]) -> dict[str, Any]:
        return resolved(values)

    def arm_seed(self, done: int = 0) -> int:
        """Returns the first arm's seed for `reset`.

        Those of other arms follow. No two trainings share any.

        Args:
            done: number of steps that the training has done before.

        Returns:
            The seed.
        """
        seeds = (self.seed, done)
        sequence = np.random.SeedSequence(seeds)
        (word,) = sequence.generate_state(1, np.uint64)
        drawn = word >> np.uint64(16)
        return SEEDS["training"].start + int(drawn)

    @field_validator("learning_rate", mode="before")
    @classmethod
    def _is_rate(cls, rate: Any) -> Any:
        is_rate = isinstance(rate, int | float | list | tuple)
        if not is_rate:
            raise ValueError(
                'should be a number such as 3e-4, [first, last], or [first, last, "geometric"]'
            )
        return rate

    @field_validator("algorithm")
    @classmethod
    def _is_trained(cls, algorithm: str) -> str:
        if algorithm not in ALGORITHMS:
            known = not_registered(algorithm, ALGORITHMS)
            raise ValueError(f"should be an algorithm to train with: {known}")
        return algorithm

    @field_validator("options")
    @classmethod
    def _say_action(cls, options: dict[str, Any]) -> dict[str, Any]:
        # so that config.json says it
        return {"action": Options.model_fields["action"].default, **options}

    @model_validator(mode="after")
    def _fits(self) -> "Training":
        problems = hyperparameter_problems(self.algorithm, self.hyperparameters)
        if self.start_from is not None and self.algorithm not in WITHOUT_CRITIC:
            text = (
                f"is {self.start_from!r}: {self.algorithm} would begin with a critic that knows"
                f" nothing of this agent, it is for {', '.join(WITHOUT_CRITIC)}"
            )
            problems.append(Problem(("start_from",), text))
        try:
            self._check_options()
        except ConfigurationError as error:
            of_options = [Problem(("options", *key), text) for key, text in error.problems]
            problems += of_options
        except ValueError as error:
            problems.append(Problem((), str(error)))
        if problems:
            raise ConfigurationError(problems)
        return self

    def _check_options(self) -> None:
        """Raises ConfigurationError, ValueError where the environment cannot be made."""
        options = Options.parse(self.options, "options")
        task = TASKS[self.task]
        try:
            scene = resolved_scene(options)
        except ConfigurationError as error:
            lines = str(error).splitlines()
            problems = [Problem(("scene",), f"cannot be used: {line}") for line in lines]
            raise ConfigurationError(problems) from error
        check_fit(options, task, scene)
        groups_of(options, task)
        episode_steps(self.seconds, self.evaluation.skip, self.options)

    @property
    def episode_steps(self) -> int:
        """Number of control periods of an episode."""
        return episode_steps(self.seconds, 0.0, self.options)


NO_TRAININGS = ("published", "tune")  # prefixes of the files in configs/ that are no trainings


def config_names(prefix: str = "") -> tuple[str, ...]:
    """Names of the trainings that ship, sorted; those of other files without their prefix."""
    files = CONFIGS.glob(f"{prefix}*.toml")
    stems = sorted(path.stem for path in files)
    if prefix:
        return tuple(stem.removeprefix(prefix) for stem in stems)
    return tuple(stem for stem in stems if not stem.startswith(NO_TRAININGS))


def find_config(name_or_path: str | Path, prefix: str = "") -> Path:
    """Path of the file of a training that ships, or of any other file.

    prefix: of another kind of files in configs/. Raises ConfigurationError.
    """
    name = str(name_or_path)
    names = config_names(prefix)
    if name in names and not Path(name).is_file():
        return CONFIGS / f"{prefix}{name}.toml"
    has_other_ending = Path(name).suffix != ".toml"
    if has_other_ending and not Path(name).exists():
        text = (
            f"is neither the path of a .toml file nor a {'search' if prefix else 'training'} that"
            f" ships: {not_among(name, names)}"
        )
        raise ConfigurationError([Problem((), text)], name)
    return Path(name)


def read_table(path: Path, extending: Sequence[Path] = ()) -> dict[str, Any]:
    """Keys of a training's file, and of the one that it extends where it has none itself.

    Tables are merged by key, all else is replaced, lists too. A table of another `type`, and the
    hyperparameters of another algorithm, are replaced as a whole: their keys are of their kind.
    Where a file says another `cost`, what that cost does not read of the extended file's is left
    out.

    Args:
        path: of the TOML file.
        extending: files that extend this one, for messages.

    Returns:
        The keys, without `extends`.

    Raises:
        ConfigurationError: for files that cannot be read, or that extend themselves.
    """
    table = read_toml(path)
    if EXTENDS not in table:
        return table
    chain = [*extending, path]
    given = table.pop(EXTENDS)
    extended = _extended_file(path, given)
    if any(extended.samefile(file) for file in chain):
        files = ", which extends ".join(map(str, [*chain, extended]))
        text = f"is {given!r}: a training cannot extend itself, as {files}"
        raise ConfigurationError([Problem((EXTENDS,), text)], str(path))
    base = read_table(extended, chain)
    if _differ(base, table, "algorithm"):
        base.pop("hyperparameters", None)
    _leave_out_unread(base, table)
    return _merged(base, table)


def _extended_file(path: Path, given: Any) -> Path:
    """The file that another, at `path`, extends by a name or a path from its own folder.

    Raises ConfigurationError.
    """
    names = config_names()
    if not isinstance(given, str):
        text = f"is {shown(given)}: it should be the name of a training, or the path of its file"
        raise ConfigurationError([Problem((EXTENDS,), text)], str(path))
    if given in names:
        return CONFIGS / f"{given}.toml"
    file = path.parent / given
    if not file.is_file():
        text = (
            f"is {given!r}: it is neither a file, from the folder of this one, nor a training that"
            f" ships: {not_among(given, names)}"
        )
        raise ConfigurationError([Problem((EXTENDS,), text)], str(path))
    return file


def _leave_out_unread(base: dict[str, Any], table: Mapping[str, Any]) -> None:
    """Takes out of a base, in place, the hyperparameters that a table's own `cost` does not read.

    Nobody who writes the table has said them, and a record with them would differ from one without.
    """
    algorithm = table.get("algorithm", base.get("algorithm"))
    extended = base.get("hyperparameters")
    own = table.get("hyperparameters")
    # what is no table is refused once it is read
    if not isinstance(extended, dict) or not isinstance(own, Mapping):
        return
    for name in unread_names(algorithm, own):
        extended.pop(name, None)


def _merged(base: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """A table with the keys of a base that it lacks, in its tables too."""
    if _differ(base, table, "type"):
        return dict(table)
    merged = dict(base)
    for key, value in table.items():
        before = base.get(key)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            merged[key] = _merged(before, value)
        else:
            merged[key] = value
    return merged


def _differ(base: Mapping[str, Any], table: Mapping[str, Any], key: str) -> bool:
    """Whether a table says otherwise than its base what it is."""
    is_in_both = key in table and key in base
    return is_in_both and table[key] != base[key]


def read_training(path: Path, changes: Sequence[str] = (), **more: Any) -> Training:
    """Reads a training from a file, with changes.

    Args:
        path: of the TOML file, which may extend another.
        changes: "key=value" with dotted keys, as of `--set`.
        more: values of keys of the file's top, by name.

    Returns:
        The training.

    Raises:
        ConfigurationError: for keys and values that are not allowed.
        ValueError: for changes that cannot be read, or a key that is in both.
    """
    table = read_table(path)
    overrides = parsed_changes(changes)
    if changes or more:
        source = f"{path}, changed"
    else:
        source = str(path)
    twice = overrides.keys() & more.keys()
    if twice:
        raise ValueError(f"--set has {min(twice)}, which is given twice")
    try:
        override(table, overrides)
    except ConfigurationError as error:
        raise ConfigurationError(error.problems, source) from error
    return Training.parse({**table, **more}, source)
