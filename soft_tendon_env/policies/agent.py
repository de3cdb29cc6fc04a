"""Trained agents as policies, loaded without unpickling: a folder of three files, or the .zip file of Stable-Baselines3.

`weights.pt`: the tensors of the policy network; `statistics.npz`: the running mean and variance by which it sees observations, absent
where it sees them as they are; `config.json`: the configuration that it was trained with, which says all else, see `AgentConfig`. Of a
.zip file the weights and the plain settings are read, never what is pickled in it; the other two files may stand beside it.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
from pydantic import ConfigDict, Field, field_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import resolved_scene, sensor_places
from soft_tendon_env.policies.integral import IntegralPolicy
from soft_tendon_env.policies.network import (
    WEIGHTS,
    Architecture,
    algorithm_in,
    algorithm_names,
    architecture_in,
    make_network,
    read_weights,
    read_zip,
    save_weights,
)
from soft_tendon_env.policies.normalization import STATISTICS, Normalization, check_observations, read_normalization, save_normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.policies.residual import Residual, ResidualPolicy, ResidualSettings
from soft_tendon_env.registration import IDS
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import Configuration, not_among, shown
from soft_tendon_env.tools.files import check_digests, read_json, shipped_folder
from soft_tendon_env.tools.types import Positive

CONFIG = "config.json"
SHIPPED = "agent"
"""The name of the agent that ships for a task."""
ARM = ("scene", "fidelity", "control_period", "tension_limits")
INTERFACE = ("observation", "preview", "history", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""
PHYSICS = ("segments", "tendons", "effects")
"""What of a scene is the arm, not how it is computed."""
PICKLED = "vecnormalize.pkl"


class AgentConfig(Configuration):
    """What is read of the config.json beside an agent; other keys are left alone.

    Attributes:
        algorithm: that trained it; needed where the weights are in weights.pt.
        hyperparameters: of the algorithm; `policy_kwargs` and `use_sde` say what the network is like.
        options: of the environment that it was trained in; None: not known.
        layout: the groups of its observation in their order, with their sizes; None: not known.
        strain: the strain parametrisation that its arm had, which says what coordinates are; None: that of its options today.
        residual: of an agent that adds to a controller's actions.
        integral_time: [s] of an agent that sees the target with the integral of the error added; None: as it is.
        normalise: where its "observations" are false, it sees them as they are.
        imitation, start_from, arms, steps_done: of its training, see trained_by.py; None: none, or not known.
        files: SHA-256 of the files that belong together, by name.
    """

    model_config = ConfigDict(extra="ignore")

    algorithm: str | None = None
    hyperparameters: dict[str, Any] = Field(default={})
    options: dict[str, Any] | None = None
    layout: dict[str, int] | None = None
    strain: dict[str, Any] | None = None
    residual: ResidualSettings | None = None
    integral_time: Positive | None = None
    normalise: dict[str, Any] = Field(default={})
    imitation: dict[str, Any] | None = None
    start_from: str | None = None
    arms: int | None = None
    steps_done: int | None = Field(default=None, ge=0)
    files: dict[str, str] = Field(default={})

    @field_validator("options")
    @classmethod
    def _of_an_environment(cls, options: dict[str, Any] | None) -> dict[str, Any] | None:
        if options is not None:
            Options.parse(options, "options")
        return options

    @field_validator("algorithm")
    @classmethod
    def _is_known(cls, algorithm: str | None) -> str | None:
        if algorithm is not None and algorithm not in algorithm_names():
            raise ValueError(f"should be an algorithm: {not_among(algorithm, algorithm_names())}")
        return algorithm


class AgentFiles(NamedTuple):
    """Where an agent is, and the algorithm that was named with it (None: not named)."""

    path: Path
    algorithm: str | None = None

    @property
    def folder(self) -> Path:
        return self.path.parent if self.is_zip else self.path

    @property
    def is_zip(self) -> bool:
        return self.path.suffix == ".zip"

    @property
    def weights(self) -> Path:
        return self.path if self.is_zip else self.path / WEIGHTS

    @property
    def config(self) -> Path:
        return self.folder / CONFIG

    @property
    def statistics(self) -> Path:
        return self.folder / STATISTICS


def is_agent(name: str) -> bool:
    """Whether a policy is an agent: "agent", the folder of one, or a .zip file."""
    folder = Path(name)
    return name == SHIPPED or name.endswith(".zip") or any((folder / file).is_file() for file in (WEIGHTS, CONFIG)) and not is_run(folder)


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a training, with its best agent in it."""
    return (folder / "best").is_dir() and not (folder / WEIGHTS).is_file()


def trained_folder() -> Path:
    """The folder of the agents that ship, one per task."""
    return shipped_folder("policies/trained", "agents/trained")


def find_agent(name: str, task: str) -> AgentFiles:
    """Of "agent" (which ships for the task), a folder, "path.zip" or "ALGORITHM:path.zip". Raises ValueError, FileNotFoundError."""
    if name == SHIPPED and not Path(name).exists():
        folder = trained_folder() / task
        if task not in IDS or not folder.is_dir():
            raise FileNotFoundError(f"no agent ships for {task}: there is no folder {folder}")
        return AgentFiles(folder)
    before, colon, after = name.partition(":")
    files = AgentFiles(Path(after), before) if colon and not Path(name).exists() else AgentFiles(Path(name))
    if files.algorithm is not None and files.algorithm not in algorithm_names():
        raise ValueError(f"{name}: the algorithm is {files.algorithm!r}; valid: {', '.join(algorithm_names())}")
    if not files.weights.is_file():
        beside = f": the agent is its folder, {files.folder}" if files.is_zip and (files.folder / WEIGHTS).is_file() else ""
        if not files.is_zip and (files.folder / "model.zip").is_file():
            beside = f": `python -m soft_tendon_env.policies.convert {files.folder}` makes it of model.zip"
        raise FileNotFoundError(f"{name}: there is no file {files.weights}{beside}")
    return files


def read_config(files: AgentFiles) -> AgentConfig:
    """What stands in config.json with an agent; nothing is known of a .zip file without. Raises ValueError, FileNotFoundError."""
    if files.is_zip and not files.config.exists():
        return AgentConfig()
    return AgentConfig.parse(read_json(files.config), str(files.config))


def agent_options(name: str, task: str) -> dict[str, Any]:
    """The arm that an agent was trained on, and how it sees and moves it: not what was to be learned. Raises ValueError, OSError."""
    config = read_config(find_agent(name, task))
    return {key: value for key, value in (config.options or {}).items() if key in (*ARM, *INTERFACE)}


def agent_arm(name: str, task: str) -> dict[str, Any] | None:
    """The arm that an agent was trained on, as resolved options; None where no config.json says so. Raises ValueError, OSError."""
    options = read_config(find_agent(name, task)).options
    return None if options is None else Options.parse(options, "options").model_dump(mode="json", include=set(ARM))


def agent_algorithm(name: str, task: str) -> str:
    """The algorithm that trained an agent. Raises ValueError, OSError."""
    files = find_agent(name, task)
    return _architecture(name, files, read_config(files))[0].algorithm


def caveats(judged: Mapping[str, tuple[str, dict[str, Any]]]) -> list[str]:
    """What should be known of agents that are judged on a task under these options, in lines. Raises as `find_agent`, `read_config`."""
    found: dict[str, list[str]] = {}
    for name, (task, options) in judged.items():
        files = find_agent(name, task)
        config = read_config(files)
        for text in [*_differences(config.options, options), *_unsaid(files, config)]:
            found.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in found.items()]


def _unsaid(files: AgentFiles, config: AgentConfig) -> list[str]:
    """Whether nothing says how an agent saw observations. Of a .zip file the file itself does, see `_normalization`."""
    if files.is_zip or files.statistics.exists() or "observations" in config.normalise:
        return []
    text = f"there is no {STATISTICS}, and {CONFIG} does not say normalise.observations; numbers are right only if it learned without"
    return [f"{text} VecNormalize's statistics of observations"]


def _differences(trained: dict[str, Any] | None, options: dict[str, Any]) -> list[str]:
    if trained is None:
        return ["no config.json says what it was trained on; numbers are right only if that was the arm and the options of this evaluation"]
    before, now = Options(**trained), Options(**options)
    other = [key for key in ARM if getattr(before, key) != getattr(now, key)]
    found = [f"trained with {key} = {shown(getattr(before, key))}, judged with {shown(getattr(now, key))}" for key in other]
    left_out = sorted(key for key in trained if key not in (*ARM, *INTERFACE) and trained[key] != options.get(key))
    return [*found, f"judged without the {', '.join(left_out)} of the training"] if left_out else found


class Agent:
    """A model or a policy network of Stable-Baselines3, which sees observations through the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self._model, self._normalise = model, normalise

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self._normalise is None else self._normalise(observation)
        return self._model.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any, other_effects: bool = False) -> Policy:
    """A trained agent, for an environment like its own, single or vector; nothing is unpickled. Raises ValueError, OSError,
    ModuleNotFoundError.

    name: "agent" (which ships for the environment's task), an agent's folder, or the .zip file of Stable-Baselines3. other_effects: whether
    the arm may have effects that it was not trained with.
    """
    files = find_agent(name, env.unwrapped.episodes.task.name)
    config = read_config(files)
    needed = {file: config.files[file] for file in (files.weights.name, STATISTICS) if file in config.files}
    check_digests(files.folder, needed, files.config)
    architecture, weights, settings = _architecture(name, files, config)
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    residual = None if config.residual is None else Residual(config.residual, env)
    rows = isinstance(env, gym.vector.VectorEnv)
    actions = env.single_action_space if rows else env.action_space
    space = env.single_observation_space if rows else env.observation_space
    space = space if residual is None else residual.observation_space(space)
    _check_arm(name, config, env, [part for part in PHYSICS if not (other_effects and part == "effects")])
    normalization = _normalization(files, config, settings, space)
    _check_sizes(name, settings, space, actions)
    try:
        network = make_network(architecture, weights, space, actions)
    except ValueError as error:
        raise ValueError(f"{files.weights}: {error}") from error
    agent = Agent(network, normalization)
    return acting_policy(agent, env, residual, config.integral_time)


def acting_policy(agent: Policy, env: Any, residual: Residual | None, integral_time: float | None) -> Policy:
    """What acts where an agent has learned: it alone or its sum with a controller, under integral action if there is an integral_time [s].

    Raises ValueError as IntegralPolicy does.
    """
    policy = agent if residual is None else ResidualPolicy(residual, agent)
    return policy if integral_time is None else IntegralPolicy(policy, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> None:
    """Write an agent's weights and statistics into a folder, for a config.json that says the rest. Raises OSError, RuntimeError."""
    save_weights(folder / WEIGHTS, network)
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)


def _architecture(name: str, files: AgentFiles, config: AgentConfig) -> tuple[Architecture, dict[str, Any], dict[str, Any]]:
    """What an agent's network is like, its weights, and the settings of a .zip file. Raises ValueError where that is not known."""
    if files.is_zip:
        settings, weights = read_zip(files.path)
        return architecture_in(settings, _checked_algorithm(name, files.algorithm, algorithm_in(settings)), files.path), weights, settings
    algorithm = _checked_algorithm(name, files.algorithm, config.algorithm)
    policy = config.hyperparameters.get("policy_kwargs") or {}
    if not isinstance(policy, dict):
        raise ValueError(f"{files.config}: hyperparameters.policy_kwargs is {shown(policy)}: it should be a table")
    if config.hyperparameters.get("use_sde"):
        policy = {**policy, "use_sde": True}
    return Architecture(algorithm, policy), read_weights(files.weights), {}


def _checked_algorithm(name: str, given: str | None, found: str | None) -> str:
    """Raises ValueError where an agent is of another algorithm than was given, or does not say."""
    if given is not None and found not in (None, given) and (given, found) != ("DDPG", "TD3"):  # which share everything but a default
        raise ValueError(f"{name}: the file is of {found}, not of {given}")
    algorithm = given or found
    if algorithm is None:
        raise ValueError(f"{name} does not say which algorithm it is of: name it ALGORITHM:{name}")
    return algorithm


def _check_arm(name: str, config: AgentConfig, env: Any, physics: Iterable[str]) -> None:
    """Raises ValueError where an agent was trained on another arm, or with other observations or actions of the same size."""
    episodes = env.unwrapped.episodes
    trained = None if config.options is None else Options(**config.options)
    scene = None if trained is None else resolved_scene(trained)
    for part in physics:
        if scene is not None and getattr(scene, part) != getattr(episodes.model.scene, part):
            text = f"{name} was trained on an arm with other {part} (scene {scene.name!r}) than this environment's"
            raise ValueError(f"{text} ({episodes.model.scene.name!r}): an arm that differs from it is what `randomize` is for")
    layout = layout_of(episodes)
    arm = [] if trained is None else [key for key in ARM if getattr(trained, key) != getattr(episodes.options, key)]
    remedy = "".join(f"; its {key} was {shown(getattr(trained, key))}" for key in arm)
    if config.layout is not None and [*config.layout.items()] != [*layout.items()]:  # in the same order
        raise ValueError(f"{name} was trained with the observation {sizes(config.layout)}, this environment has {sizes(layout)}{remedy}")
    before, now = (_interface(options, episodes) for options in (trained or episodes.options, episodes.options))
    if config.strain is not None and before["strain"] is not None:
        before["strain"] = config.strain
    for key in before:
        if before[key] != now[key]:
            raise ValueError(f"{name} was trained with {key} = {shown(before[key])}, this environment has {shown(now[key])}{remedy}")


def _interface(options: Options, episodes: Any) -> dict[str, Any]:
    """What observations and actions mean beyond the names and sizes of groups, as far as there are such groups."""
    groups, scene = tuple(episodes.layout.slices), resolved_scene(options)
    return {
        "strain": strain_of(scene) if any("coordinates" in group or group == "rates" for group in groups) else None,
        "action": options.action,
        "tension_rate": options.tension_rate if options.action == "increment" else None,
        "preview": options.preview if any("preview" in group for group in groups) else None,
        "sensors": tuple(sensor_places(options, scene)) if any(group.startswith("strain") for group in groups) else None,
    }


def strain_of(scene: Scene) -> dict[str, Any]:
    """The strain parametrisation of a scene as plain tables."""
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Any) -> dict[str, int]:
    """The groups of an observation in their order, with their sizes."""
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def sizes(layout: Mapping[str, int]) -> str:
    """A layout in words."""
    return ", ".join(f"{group} ({size})" for group, size in layout.items())


def _check_sizes(name: str, settings: Mapping[str, Any], observations: gym.Space[Any], actions: gym.Space[Any]) -> None:
    """Raises ValueError where a .zip file says that it was trained on observations or actions of other sizes."""
    for key, space in (("observation_space", observations), ("action_space", actions)):
        said = settings.get(key)
        size = said.get("_shape") if isinstance(said, dict) else None
        if isinstance(size, list) and tuple(size) != space.shape:
            text = f"{name} was trained with {key} {tuple(size)}, this environment has {space.shape or _shapes(space)}"
            raise ValueError(f"{text}: see that the task is right, and that config.json beside it says its options")


def _shapes(space: gym.Space[Any]) -> Any:
    return {key: part.shape for key, part in space.items()} if isinstance(space, gym.spaces.Dict) else space.shape


def was_normalised(settings: Mapping[str, Any]) -> bool:
    """Whether the settings of a .zip file are of an agent whose environment had a VecNormalize, which may have left observations alone.

    Stable-Baselines3 then keeps the last observation from before it.
    """
    return settings.get("_last_original_obs") is not None


def _normalization(
    files: AgentFiles, config: AgentConfig, settings: Mapping[str, Any], space: gym.Space[Any]
) -> Normalization | None:
    """What to do to observations; None for an agent that learned from them as they are.

    Raises ValueError, FileNotFoundError where the statistics of an agent that needs some are missing, or of other observations.
    """
    if not files.statistics.exists():
        normalised = was_normalised(settings) if files.is_zip else "observations" in config.normalise
        if normalised and config.normalise.get("observations", True):
            text = "it sees observations through the statistics of its training (VecNormalize), and would see others without"
            if (files.folder / PICKLED).exists():
                convert = f"python -m soft_tendon_env.policies.convert {files.folder}"
                text += f"; {PICKLED} can only be read by running what is in it: `{convert}` does so, if you trust it"
            text += f". If it saw them as they are (norm_obs=False), {CONFIG} should say so: {{\"normalise\": {{\"observations\": false}}}}"
            raise FileNotFoundError(f"{files.path} should have its {STATISTICS} beside it: {text}")
        return None
    normalization = read_normalization(files.statistics)
    check_observations(files.statistics, normalization, space)
    return normalization
