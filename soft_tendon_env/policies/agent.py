"""Trained agents as policies: files, network, normalisation and integral action.

An agent's folder has `weights.npz`, the arrays of its network; `statistics.npz`, mean and variance
by which it sees observations, absent where it sees them as they are; and `config.json`, which says
all else, see `AgentConfig`. It acts by NumPy alone.
"""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import gymnasium as gym
import numpy as np
from pydantic import AfterValidator, Field, field_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.policies.algorithms import ALGORITHMS, network_kind
from soft_tendon_env.policies.architecture import read_architecture
from soft_tendon_env.policies.integral import IntegralPolicy
from soft_tendon_env.policies.network import PolicyNetwork
from soft_tendon_env.policies.normalization import (
    STATISTICS,
    Normalization,
    read_normalization,
    save_normalization,
)
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.trained_arm import (
    Outside,
    as_written,
    is_of,
    listed_numbers,
    listed_tables,
    numbers_outside,
    undisturbed,
)
from soft_tendon_env.policies.weights import WEIGHTS, acting_arrays, build_network, read_weights
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, not_registered, read_toml
from soft_tendon_env.tools.files import CONFIGS, check_digests, digest, read_json, shipped_folder
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Positive

CONFIG = "config.json"
OLD_WEIGHTS = "weights.pt"  # tensors of agents up to version 0.3
IN_REPOSITORY = "but in agents/trained of the repository: clone it and run the same command there"
"""Place of the agents that a wheel lacks, and what to do."""
AGENT = "agent"
"""Name of the best agent that ships for a task, as agents.toml in the folder of them all has it."""
ARM = ("scene", "fidelity", "control_period", "tension_limits", "rate_limit")
"""Options that define the arm."""
INTERFACE = ("observation", "preview", "history", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""
SAME = ("preview", "history", "sensors", "action", "tension_rate", "control_period")
"""Options that should be those of the training; observations are compared by their layout."""
OF_TRAINING = (
    "added_effects",
    "arms",
    "checkpoint_every",
    "checkpoint_seconds",
    "engine",
    "evaluated",
    "evaluation",
    "hindsight",
    "learning_rate",
    "record",
    "runners",
    "seconds",
    "seconds_learned",
    "seed",
    "steps",
    "threads",
)
"""Keys of config.json that concern the training alone: an agent acts as it does whatever they
say."""
OF_COORDINATES = {
    "coordinates",
    "rates",
    "target_coordinates",
    "coordinate_preview",
    "wanted_coordinates",
}
"""Observation groups whose meaning depends on the strain parametrisation."""


def _checked_options(options: dict[str, Any]) -> dict[str, Any]:
    """Plain options of an environment as they are.

    Raises ConfigurationError.
    """
    Options.parse(options, "options")
    return options


EnvironmentOptions = Annotated[dict[str, Any], AfterValidator(_checked_options)]
"""Options of an environment as plain tables."""


class AgentConfig(Configuration):
    """Configuration of a trained agent, config.json, as far as it acts.

    Keys of OF_TRAINING are left out. None: not known.
    """

    algorithm: str  # name of the algorithm that trained it
    # of the algorithm; `policy_kwargs` and `use_sde` say what the network is like
    hyperparameters: dict[str, Any] = Field(default={})
    task: str | None = None  # name of the task that it was trained on
    # of the environment that it was trained in
    options: EnvironmentOptions = Field(default={}, validate_default=True)
    # groups of its observation in their order, with their sizes
    layout: dict[str, int] | None = None
    # parametrisation that its arm had, which says what coordinates are; by default that of options
    strain: dict[str, Any] | None = None
    # [s] of integral action around it, see integral.py; None: none
    integral_time: Positive | None = None
    # {"observations": true} where it sees observations through its statistics
    normalise: dict[str, Any] = Field(default={})
    steps_done: int | None = Field(default=None, ge=0)  # of its training
    start_from: str | None = None  # agent whose weights that began with; None: random ones
    files: dict[str, str] = Field(default={})  # SHA-256 of the files that belong together, by name

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """The configuration of a plain table.

        Raises ConfigurationError, also for keys that it does not know.
        """
        acting = {key: value for key, value in values.items() if key not in OF_TRAINING}
        return super().parse(acting, source)

    @field_validator("options")
    @classmethod
    def _say_action(cls, options: dict[str, Any]) -> dict[str, Any]:
        return {"action": "tension", **options}  # the default of trainings that did not say it

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str) -> str:
        if algorithm not in ALGORITHMS:
            raise ValueError(f"should be an algorithm: {not_registered(algorithm, ALGORITHMS)}")
        return algorithm


def shipped() -> tuple[str, ...]:
    """Names of the agents that ship, `agent` for the best of a task first.

    They are those of their folders; a wheel lacks some folders, see agents.toml.
    """
    folders = {path.name for path in trained_folder().iterdir() if path.is_dir()}
    for names in _agents_table()["repository_alone"].values():
        folders.update(names)
    return AGENT, *sorted(folders)


def is_shipped(name: str) -> bool:
    """True for the name of an agent that ships, unless there is a folder or a file of that name."""
    return name in shipped() and not Path(name).exists()


def is_agent(name: str) -> bool:
    """True for the name of an agent: of one that ships, or the folder of one."""
    folder = Path(name)
    if is_shipped(name) or (folder / WEIGHTS).is_file():
        return True
    is_training = (folder / "best").is_dir()
    return (folder / CONFIG).is_file() and not is_training


def trained_folder() -> Path:
    """Folder of the agents that ship, NAME/TASK."""
    return shipped_folder("policies/trained", "agents/trained")


def _agents_table() -> dict[str, Any]:
    """agents.toml of the agents that ship.

    Raises ValueError, FileNotFoundError.
    """
    return read_toml(trained_folder() / "agents.toml")


def shipped_as(name: str, task: str) -> str:
    """Name of the folder of an agent that ships for a task: what "agent" stands for.

    Raises:
        FileNotFoundError: there is no such agent for the task, or none in a wheel.
        ValueError: agents.toml was damaged.
    """
    table = _agents_table()
    folder_name = name
    if name == AGENT:
        folder_name = str(table.get(task))
    folder = trained_folder()
    of_task = []
    for known in shipped():
        weights = folder / known / task / WEIGHTS
        if weights.is_file():
            of_task.append(known)
    if folder_name in of_task:
        return folder_name
    text = f"the agent {name!r} does not ship for {task}; what does: {', '.join(of_task) or 'none'}"
    if folder_name in table["repository_alone"].get(task, ()):
        text = f"the agent {name!r} for {task} is not in a wheel, {IN_REPOSITORY}"
    raise FileNotFoundError(text)


def lacks_seeds(name: str, task: str) -> bool:
    """Whether an agent that ships was trained with several seeds, of which only one is here.

    That is so in a wheel. Raises ValueError, FileNotFoundError as `shipped_as`.
    """
    if not is_shipped(name):
        return False
    folder_name = shipped_as(name, task)
    several = _agents_table()["several_seeds"]
    if folder_name not in several.get(task, ()):
        return False
    return not any((trained_folder() / folder_name / task).glob("seed_*"))


def find_agent(name: str, task: str) -> Path:
    """Folder of an agent by its name: one of `shipped` for the task, or a folder.

    Raises ValueError, FileNotFoundError.
    """
    folder = Path(name)
    if is_shipped(name):
        folder = trained_folder() / shipped_as(name, task) / task
    if not (folder / WEIGHTS).is_file():
        text = f"{name}: there is no file {folder / WEIGHTS}"
        if (folder / OLD_WEIGHTS).is_file():
            text += (
                f"; {OLD_WEIGHTS} is of an earlier version: `save_agent` writes the former from the"
                " model of the training"
            )
        raise FileNotFoundError(text)
    return folder


def read_config(folder: Path) -> AgentConfig:
    """Configuration of the agent in a folder.

    Raises ValueError, FileNotFoundError.
    """
    path = folder / CONFIG
    return AgentConfig.parse(read_json(path), str(path))


class TrainingWarning(UserWarning):
    """An agent acts in another environment than it was trained in."""


class NetworkPolicy:
    """Policy network that sees observations normalised by the statistics of its training.

    The network may be another object with Stable-Baselines3's `predict`.
    """

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self.network = model
        self.normalise = normalise

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        seen = observation if self.normalise is None else self.normalise(observation)
        return self.network.predict(seen, state, episode_start, deterministic)


def load_agent(
    name: str, env: Any, other_effects: bool = False, beyond_training: bool = False
) -> Policy:
    """Loads a trained agent as a policy for an environment like its own, single or vector.

    Nothing is unpickled. A TrainingWarning says where the task, the preset or loads are others than
    in its training, and which number of the arm is outside of what was drawn there.

    Args:
        name: of an agent that ships for the environment's task, or an agent's folder.
        env: the environment.
        other_effects: whether the arm may have effects that it was not trained with.
        beyond_training: whether numbers of the arm may be outside of those in its training.

    Returns:
        The policy, which acts by NumPy alone.

    Raises:
        TypeError: the environment is of another package.
        ValueError: the files were damaged, or are of another arm or control period.
        OSError: a file cannot be read.
    """
    episodes = episodes_of(env)
    folder = find_agent(name, episodes.task.name)
    config = read_config(folder)
    _check_files(folder, config)
    _check_agent(name, config, episodes, other_effects, beyond_training)
    if isinstance(env, gym.vector.VectorEnv):
        observations: gym.Space[Any] = env.single_observation_space
        actions: gym.Space[Any] = env.single_action_space
    else:
        observations = env.observation_space
        actions = env.action_space
    network = load_network(folder, config, observations, actions)
    normalization = None
    if (folder / STATISTICS).exists():
        normalization = read_normalization(folder / STATISTICS, observations)
    elif config.normalise.get("observations"):
        raise FileNotFoundError(
            f"{folder} should have {STATISTICS}: the agent sees observations through it, and would"
            " see others without"
        )
    return acting_policy(NetworkPolicy(network, normalization), env, config.integral_time)


def _check_files(folder: Path, config: AgentConfig) -> None:
    """Raises an error for files that are not those of an agent's training.

    It is a ValueError or a FileNotFoundError, also for files without a digest in config.json.
    """
    for name in (WEIGHTS, STATISTICS):
        is_there = (folder / name).exists()
        if is_there and name not in config.files:
            digest_of_file = digest(folder / name)
            raise ValueError(
                f"{folder / CONFIG} has no digest of {name}, by which a damaged or exchanged file"
                " is noticed: if it is the right one, write"
                f' "files": {{"{name}": "{digest_of_file}"}} into it'
            )
    files = {file: config.files[file] for file in (WEIGHTS, STATISTICS) if file in config.files}
    check_digests(folder, files, folder / CONFIG)


def load_network(
    folder: Path, config: AgentConfig, observations: gym.Space[Any], actions: gym.Space[Any]
) -> PolicyNetwork:
    """Policy network of the agent in a folder, for the spaces of an environment.

    Raises ValueError, OSError.
    """
    arrays = read_weights(folder / WEIGHTS)
    arguments = dict(config.hyperparameters.get("policy_kwargs") or {})
    if config.hyperparameters.get("use_sde"):
        arguments["use_sde"] = True
    try:
        kind = network_kind(config.algorithm)
        architecture = read_architecture(kind, arguments)
        return build_network(architecture, arrays, observations, actions)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{folder / WEIGHTS}: the weights are not of a {config.algorithm} policy for this"
            f" environment: {describe(error)}"
        ) from error


def acting_policy(agent: Policy, env: Any, integral_time: float | None) -> Policy:
    """Policy of an agent in its environment, with integral action for an integral_time [s].

    Raises ValueError as IntegralPolicy does.
    """
    if integral_time is None:
        return agent
    return IntegralPolicy(agent, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> dict[str, str]:
    """Writes an agent's weights and statistics into a folder, beside its config.json.

    Args:
        folder: that is there.
        network: policy of Stable-Baselines3, `model.policy`; its tensors that actions depend on are
            written.
        normalization: of its observations, see `normalization_of`; None: there is none.

    Returns:
        SHA-256 of the files by name, which config.json should have as `files`.

    Raises:
        OSError: the folder cannot be written.
    """
    arrays = acting_arrays(network.state_dict())
    np.savez_compressed(folder / WEIGHTS, allow_pickle=False, **arrays)
    names = [WEIGHTS]
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)
        names.append(STATISTICS)
    return {name: digest(folder / name) for name in names}


def strain_of(scene: Scene) -> dict[str, Any]:
    """Strain parametrisation of a scene as a plain table."""
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Episodes) -> dict[str, int]:
    """Groups of an observation in their order, with their sizes."""
    slices = episodes.layout.slices
    return {group: columns.stop - columns.start for group, columns in slices.items()}


def _check_agent(
    name: str, config: AgentConfig, episodes: Episodes, other_effects: bool, beyond_training: bool
) -> None:
    """Compares an environment with that of an agent's training.

    Args:
        name: of the agent.
        config: its configuration.
        episodes: of the environment.
        other_effects: whether those of the arm may be others.
        beyond_training: whether all numbers of the arm may be others.

    Raises:
        ValueError: the agent was trained on another arm, with another control period, or with
            another meaning of observations or actions.

    Warns:
        TrainingWarning: the task is another, or the arm or how it is computed.
    """
    trained = Options(**config.options)
    outside = numbers_outside(trained, episodes.model.scene)
    if other_effects:
        outside = [number for number in outside if number.table != "effects"]
    if not beyond_training:
        _check_arm(name, config, episodes, outside)
    _check_interface(name, config, trained, episodes)
    if outside or not other_effects:
        _warn_of_changes(name, config, episodes, outside)


def _check_arm(
    name: str, config: AgentConfig, episodes: Episodes, outside: Sequence[Outside]
) -> None:
    """Raises ValueError where numbers outside of a training are those of the arm itself."""
    own = [number for number in outside if not number.is_load]
    if own:
        before = as_written(Options(**config.options)).name
        now = episodes.model.scene.name
        raise ValueError(
            f"{name} was trained on an arm with other {listed_tables(own)} (scene {before!r}) than"
            f" this environment's ({now!r}): {listed_numbers(own)}."
            f" {_advice(config.algorithm, episodes)}"
        )


def _advice(algorithm: str, episodes: Episodes) -> str:
    """Command that trains an agent for the arm of an environment, in words."""
    training = f"{algorithm}_{_words(episodes.task.name)}".lower()
    if not (CONFIGS / f"{training}.toml").is_file():
        return "Train an agent on this arm"
    scene = episodes.options.scene
    arm = scene if isinstance(scene, str) else "my_arm.toml"
    return f"Train an agent for this arm: soft-tendon train {training} --set options.scene={arm}"


def _words(name: str) -> str:
    """A task's name in words, "Tip_Pose" for "TipPose"."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)


def _check_interface(name: str, config: AgentConfig, trained: Options, episodes: Episodes) -> None:
    """Raises ValueError where observations or actions mean something else than in a training."""
    layout = layout_of(episodes)
    # first what others follow from: the usual preview times depend on the control period
    values: dict[str, tuple[Any, Any]] = {
        "control_period": (trained.control_period, episodes.options.control_period),
        "observation": (_group_names(config.layout or layout), _group_names(layout)),
    }
    for key in SAME:
        before = getattr(trained, key)
        now = getattr(episodes.options, key)
        values[key] = (before, now)
    if OF_COORDINATES & layout.keys():
        strain = config.strain or strain_of(resolved_scene(trained))
        values["strain"] = (strain, strain_of(episodes.model.scene))
    for key, (before, now) in values.items():
        if before != now:
            raise ValueError(
                f"{name} was trained with {key} = {before!r}, this environment has {now!r}"
            )


def _group_names(layout: Mapping[str, int]) -> str:
    """Groups of a layout with their sizes, as words."""
    parts = [f"{group} ({size})" for group, size in layout.items()]
    return ", ".join(parts)


def _warn_of_changes(
    name: str, config: AgentConfig, episodes: Episodes, outside: Sequence[Outside]
) -> None:
    """Warns of another task or arm, also as it is computed, than in an agent's training.

    outside: numbers of the arm for which it was not trained.
    """
    trained = Options(**config.options)
    task = episodes.task.name
    values: dict[str, tuple[Any, Any]] = {"task": (config.task or task, task)}
    arms = (trained, Options(**undisturbed(config.options)))
    if not any(is_of(options, episodes.model.scene) for options in arms):
        for key in ARM:
            if key != "control_period":
                before = getattr(trained, key)
                now = getattr(episodes.options, key)
                values[key] = (before, now)
    changes = []
    for key, (before, now) in values.items():
        if before != now:
            changes.append(f"{key} = {before!r}, judged with {now!r}")
    if changes:
        beyond = f". {listed_numbers(outside)}" if outside else ""
        text = (
            f"{name}: trained with {'; '.join(changes)}{beyond}. policy_options() has the options"
            " of its training"
        )
        warnings.warn(text, TrainingWarning, stacklevel=6)
