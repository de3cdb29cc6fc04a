"""Trained agents as policies: their files, network, normalisation of observations and integral
action.

An agent's folder has `weights.npz`, the arrays of its network; `statistics.npz`, mean and variance
by which it sees observations, absent where it sees them as they are; and `config.json`, which says
all else, see `AgentConfig`. It acts by NumPy alone.
"""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import gymnasium as gym
import numpy as np
from pydantic import AfterValidator, Field, field_validator

from soft_tendon_env.accuracy.fidelity import AS_SCENE
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.options import given_scene, resolved_scene
from soft_tendon_env.policies.algorithms import ALGORITHMS, OF_PACKAGE, network_kind
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
from soft_tendon_env.policies.weights import WEIGHTS, acting_arrays, build_network, read_weights
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, not_among, read_toml
from soft_tendon_env.tools.files import check_digests, read_json, shipped_folder
from soft_tendon_env.tools.messages import describe
from soft_tendon_env.tools.types import Positive

CONFIG = "config.json"
OLD_WEIGHTS = "weights.pt"  # tensors of agents up to version 0.3
# name of the best agent that ships for a task, as agents.toml in the folder of them all has it
IN_REPOSITORY = "but in agents/trained of the repository: clone it and run the same command there"
"""Where the agents are that a wheel lacks, and what to do."""

AGENT = "agent"
ARM = ("scene", "fidelity", "control_period", "tension_limits")  # options that define the arm
INTERFACE = ("observation", "preview", "history", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""
SAME = (*INTERFACE[1:], "control_period")  # options that should be those of the training
OF_TRAINING = (
    *(
        "arms",
        "checkpoint_every",
        "checkpoint_seconds",
        "engine",
        "evaluated",
        "evaluation",
        "hindsight",
        "learning_rate",
        "record",
    ),
    *("runners", "seconds", "seconds_learned", "seed", "start_from", "steps", "threads"),
)
"""Keys of config.json that concern the training alone: an agent acts as it does whatever they
say."""

EnvironmentOptions = Annotated[
    dict[str, Any], AfterValidator(lambda options: Options.parse(options, "options") and options)
]
"""Options of an environment as plain tables."""
PHYSICS = (
    "segments",
    "tendons",
    "base",
    "effects",
)  # tables of a scene that define the physical arm, as opposed to how it is computed


class AgentConfig(Configuration):
    """Configuration of a trained agent, config.json, as far as it acts; keys of OF_TRAINING are
    left out. None: not known."""

    algorithm: str  # name of the algorithm that trained it
    hyperparameters: dict[str, Any] = Field(
        default={}
    )  # of the algorithm; `policy_kwargs` and `use_sde` say what the network is like
    task: str | None = None  # name of the task that it was trained on
    options: EnvironmentOptions = Field(
        default={}, validate_default=True
    )  # of the environment that it was trained in
    layout: dict[str, int] | None = (
        None  # groups of its observation in their order, with their sizes
    )
    strain: dict[str, Any] | None = (
        # parametrisation that its arm had, which says what coordinates are; by default that of
        # options
        None
    )
    integral_time: Positive | None = (
        None  # [s] of integral action around it, see integral.py; None: none
    )
    normalise: dict[str, Any] = Field(
        default={}
    )  # {"observations": true} where it sees observations through its statistics
    steps_done: int | None = Field(default=None, ge=0)  # of its training
    files: dict[str, str] = Field(default={})  # SHA-256 of the files that belong together, by name

    @classmethod
    def parse(cls, values: Mapping[str, Any], source: str) -> Self:
        """The configuration of a plain table. Raises ConfigurationError, also for keys that it does
        not know."""
        return super().parse(
            {key: value for key, value in values.items() if key not in OF_TRAINING}, source
        )

    @field_validator("options")
    @classmethod
    def _say_action(cls, options: dict[str, Any]) -> dict[str, Any]:
        return {"action": "tension", **options}  # the default of trainings that did not say it

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str) -> str:
        if algorithm not in (names := sorted([*ALGORITHMS, *OF_PACKAGE])):
            raise ValueError(f"should be an algorithm: {not_among(algorithm, names)}")
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
    return (
        is_shipped(name)
        or (Path(name) / WEIGHTS).is_file()
        or (Path(name) / CONFIG).is_file()
        and not (Path(name) / "best").is_dir()
    )


def trained_folder() -> Path:
    """Folder of the agents that ship, NAME/TASK."""
    return shipped_folder("policies/trained", "agents/trained")


def _agents_table() -> dict[str, Any]:
    """agents.toml of the agents that ship. Raises ValueError, FileNotFoundError."""
    return read_toml(trained_folder() / "agents.toml")


def shipped_as(name: str, task: str) -> str:
    """Name of the folder of an agent that ships for a task: what "agent" stands for.

    Raises:
        FileNotFoundError: there is no such agent for the task, or none in a wheel.
        ValueError: agents.toml was damaged.
    """
    table = _agents_table()
    folder_name = str(table.get(task)) if name == AGENT else name
    of_task = [
        known for known in shipped() if (trained_folder() / known / task / WEIGHTS).is_file()
    ]
    if folder_name in of_task:
        return folder_name
    text = f"the agent {name!r} does not ship for {task}; what does: {', '.join(of_task) or 'none'}"
    if folder_name in table["repository_alone"].get(task, ()):
        text = f"the agent {name!r} for {task} is not in a wheel, {IN_REPOSITORY}"
    raise FileNotFoundError(text)


def lacks_seeds(name: str, task: str) -> bool:
    """Whether an agent that ships was trained with several seeds, of which only one is here, as in
    a wheel. Raises ValueError, FileNotFoundError as `shipped_as`."""
    if not is_shipped(name):
        return False
    folder_name = shipped_as(name, task)
    several = _agents_table()["several_seeds"]
    if folder_name not in several.get(task, ()):
        return False
    return not any((trained_folder() / folder_name / task).glob("seed_*"))


def find_agent(name: str, task: str) -> Path:
    """Folder of an agent by its name: one of `shipped` for the task, or a folder. Raises
    ValueError, FileNotFoundError."""
    folder = trained_folder() / shipped_as(name, task) / task if is_shipped(name) else Path(name)
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
    """Configuration of the agent in a folder. Raises ValueError, FileNotFoundError."""
    return AgentConfig.parse(read_json(folder / CONFIG), str(folder / CONFIG))


class TrainingWarning(UserWarning):
    """An agent acts in another environment than it was trained in."""


class NetworkPolicy:
    """Policy network, or another object with Stable-Baselines3's `predict`, that sees observations
    normalised by the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self.network, self.normalise = model, normalise

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        seen = observation if self.normalise is None else self.normalise(observation)
        return self.network.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any, other_effects: bool = False) -> Policy:
    """Trained agent as a policy for an environment like its own, single or vector; nothing is
    unpickled.

    name: of an agent that ships for the environment's task, or an agent's folder. other_effects:
    whether the arm may have effects that it was not trained with. Warns (TrainingWarning) of
    another task or preset than in its training. Raises TypeError for environments of other
    packages, ValueError, also for another arm or control period, OSError, ModuleNotFoundError.
    """
    episodes = episodes_of(env)
    folder = find_agent(name, episodes.task.name)
    config = read_config(folder)
    check_digests(
        folder,
        {file: config.files[file] for file in (WEIGHTS, STATISTICS) if file in config.files},
        folder / CONFIG,
    )
    _check_agent(name, config, episodes, other_effects)
    rows = isinstance(env, gym.vector.VectorEnv)
    spaces = (
        (env.single_observation_space, env.single_action_space)
        if rows
        else (env.observation_space, env.action_space)
    )
    network = load_network(folder, config, *spaces)
    normalization = None
    if (folder / STATISTICS).exists():
        normalization = read_normalization(folder / STATISTICS, spaces[0])
    elif config.normalise.get("observations"):
        raise FileNotFoundError(
            f"{folder} should have {STATISTICS}: the agent sees observations through it, and would"
            " see others without"
        )
    return acting_policy(NetworkPolicy(network, normalization), env, config.integral_time)


def load_network(
    folder: Path, config: AgentConfig, observations: gym.Space[Any], actions: gym.Space[Any]
) -> PolicyNetwork:
    """Policy network of the agent in a folder, for the spaces of an environment. Raises ValueError,
    OSError."""
    arrays = read_weights(folder / WEIGHTS)
    arguments = dict(config.hyperparameters.get("policy_kwargs") or {})
    if config.hyperparameters.get("use_sde"):
        arguments["use_sde"] = True
    try:
        architecture = read_architecture(network_kind(config.algorithm), arguments)
        return build_network(architecture, arrays, observations, actions)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{folder / WEIGHTS}: the weights are not of a {config.algorithm} policy for this"
            f" environment: {describe(error)}"
        ) from error


def acting_policy(agent: Policy, env: Any, integral_time: float | None) -> Policy:
    """Policy of an agent in its environment, with integral action for an integral_time [s]. Raises
    ValueError as IntegralPolicy does."""
    return agent if integral_time is None else IntegralPolicy(agent, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> None:
    """Write an agent's weights and statistics into a folder, for a config.json that says the rest.

    Args:
        folder: that is there.
        network: policy of Stable-Baselines3, `model.policy`; its tensors that actions depend on are
            written.
        normalization: of its observations, see `normalization_of`; None: there is none.

    Raises:
        OSError: the folder cannot be written.
    """
    np.savez_compressed(folder / WEIGHTS, allow_pickle=False, **acting_arrays(network.state_dict()))
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)


def strain_of(scene: Scene) -> dict[str, Any]:
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Episodes) -> dict[str, int]:
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def disturbances(options: Options) -> set[str]:
    """Names of effects that a training draws from nothing on, or from the least that there is: an
    arm has them or not."""
    found, scene = dict[str, bool](), given_scene(options.scene)
    for drawn in options.randomize.ranges(scene):
        for key, value in zip(drawn.keys, drawn.values, strict=True):
            table, name, number, *_ = key.split(".")
            if table == "effects":
                effect = getattr(
                    scene.effects, name
                )  # None: it is there where its number is drawn alone
                others = effect and any(
                    np.any(getattr(effect, strength))
                    for strength in effect.strengths
                    if strength != number
                )
                found[name] = (
                    found.get(name, True) and value in (0.0, drawn.least) and not others
                )  # still water is there without a current
    return {name for name, holds in found.items() if holds}


def undisturbed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a training with the arm alone: without what it draws, and changes of the scene by
    which there are disturbances."""
    scene, names = options.get("scene"), disturbances(Options.parse(options, "options"))
    if not isinstance(scene, Mapping) or "segments" in scene:
        return {**options, "randomize": {}}
    left = {
        key: value
        for key, value in scene.items()
        if not (key.startswith("effects.") and key.split(".")[1] in names)
    }
    return {
        **options,
        "randomize": {},
        "scene": left["scene"] if left.keys() == {"scene"} else left,
    }


def _physics(scene: Scene, names: set[str]) -> dict[str, Any]:
    """Physical arm of a scene by the names of PHYSICS, without effects of these names."""
    effects = {name: effect for name, effect in scene.effects.chosen().items() if name not in names}
    return {**{key: getattr(scene, key) for key in PHYSICS}, "effects": effects}


def _as_written(options: Options) -> Scene:
    """The scene of options with the strain, quadrature and integrator that it has, so that no trial
    of the arm is needed."""
    return resolved_scene(options.model_copy(update={"fidelity": AS_SCENE}))


def _is_of(options: Options, scene: Scene) -> bool:
    """Whether a scene is that of options but for its name: the same physical arm, and then the same
    at their fidelity."""
    if _physics(_as_written(options), set()) != _physics(scene, set()):
        return False
    return resolved_scene(options).replace({"name": scene.name}) == scene


def _check_agent(name: str, config: AgentConfig, episodes: Episodes, other_effects: bool) -> None:
    """Raises ValueError where an agent was trained on another arm, with another control period, or
    with another meaning of observations or actions. other_effects: those of the arm may be others.
    Warns (TrainingWarning) of another task, or arm as it is computed."""
    now, scene, layout, trained = (
        episodes.options,
        episodes.model.scene,
        layout_of(episodes),
        Options(**config.options),
    )
    before, names = _as_written(trained), disturbances(trained)
    there, known = _physics(scene, names), _physics(before, names)
    for key in PHYSICS:
        if known[key] != there[key] and not (other_effects and key == "effects"):
            text = (
                f"{name} was trained on an arm with other {key} (scene {before.name!r}) than this"
                f" environment's ({scene.name!r})"
            )
            raise ValueError(f"{text}: an arm that differs from it is what `randomize` is for")
    groups = [
        ", ".join(f"{group} ({size})" for group, size in of.items())
        for of in (config.layout or layout, layout)
    ]
    values = {
        "observation": (groups[0], groups[1]),
        **{key: (getattr(trained, key), getattr(now, key)) for key in SAME},
    }
    if {"coordinates", "rates", "target_coordinates"} & layout.keys():
        values["strain"] = (config.strain or strain_of(resolved_scene(trained)), strain_of(scene))
    for key, (one, other) in values.items():
        if one != other:
            raise ValueError(
                f"{name} was trained with {key} = {one!r}, this environment has {other!r}"
            )
    same = any(
        _is_of(options, scene) for options in (trained, Options(**undisturbed(config.options)))
    )
    soft = {"task": (config.task or episodes.task.name, episodes.task.name)}
    soft |= {
        key: (getattr(trained, key), getattr(now, key))
        for key in ARM
        if key != "control_period" and not same
    }
    if not other_effects and (
        other := [
            f"{key} = {one!r}, judged with {two!r}"
            for key, (one, two) in soft.items()
            if one != two
        ]
    ):
        text = (
            f"{name}: trained with {'; '.join(other)}. policy_options() has the options of its"
            " training"
        )
        warnings.warn(text, TrainingWarning, stacklevel=5)
