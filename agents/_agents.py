"""Trained agents as policies: what is in an agent's .zip file, and what must stand beside it.

`vecnormalize.pkl`: the statistics by which it sees observations (loading runs what is in both files: take them from nobody whom you do
not trust). `config.json`: the configuration that it was trained with, see `AgentConfig`.
"""

import importlib
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
from _files import check_digests, first_line, read_json, read_pickle
from _residual import Residual, ResidualPolicy, ResidualSettings
from pydantic import ConfigDict, Field, field_validator

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.options import resolved_scene, sensor_places
from soft_tendon_env.evaluation.run import Policy
from soft_tendon_env.tools.configuration import Configuration, shown

ALGORITHMS = {
    **dict.fromkeys(("A2C", "DDPG", "PPO", "SAC", "TD3"), "stable_baselines3"),
    **dict.fromkeys(("ARS", "CrossQ", "RecurrentPPO", "TQC", "TRPO"), "sb3_contrib"),
}
OWN_POLICIES = {"ars": "ARS", "crossq": "CrossQ", "sac": "SAC", "td3": "TD3", "tqc": "TQC"}  # DDPG is a TD3
SETTINGS = {"clip_range": "PPO", "cg_max_steps": "TRPO", "gae_lambda": "A2C"}  # tell apart those that share their policies
ARM = ("scene", "fidelity", "control_period", "tension_limits")
INTERFACE = ("observation", "preview", "sensors", "action", "tension_rate")
"""Options that say what a policy observes and how its actions are read."""
LEARNING = {
    "learning_rate": 0.0,
    "lr_schedule": lambda _: 0.0,
    "clip_range": lambda _: 0.0,
    "buffer_size": 1,
    "replay_buffer_class": None,
    "replay_buffer_kwargs": {},
}
"""What an agent that learns no more has in place of what it learned with."""
PHYSICS = ("segments", "tendons", "effects")
"""What of a scene is the arm, not how it is computed."""
STATISTICS = "vecnormalize.pkl"


class AgentConfig(Configuration):
    """What is read of the config.json beside an agent; other keys are left alone.

    Attributes:
        options: of the environment that it was trained in; None: not known.
        layout: the groups of its observation in their order, with their sizes; None: not known.
        residual: of an agent that adds to a controller's actions.
        normalise: where its "observations" are false, it sees them as they are.
        files: SHA-256 of the files that belong together, by name.
    """

    model_config = ConfigDict(extra="ignore")

    options: dict[str, Any] | None = None
    layout: dict[str, int] | None = None
    residual: ResidualSettings | None = None
    normalise: dict[str, Any] = Field(default={})
    files: dict[str, str] = Field(default={})

    @field_validator("options")
    @classmethod
    def _of_an_environment(cls, options: dict[str, Any] | None) -> dict[str, Any] | None:
        if options is not None:
            Options.parse(options, "options")
        return options


def is_agent(name: str) -> bool:
    return name.endswith(".zip")


def agent_file(name: str) -> tuple[str | None, Path]:
    """Algorithm (None: not said) and path of "path.zip" or "ALGORITHM:path.zip". Raises ValueError, FileNotFoundError."""
    before, colon, after = name.partition(":")
    algorithm, path = (before, Path(after)) if colon and not Path(name).exists() else (None, Path(name))
    if algorithm is not None and algorithm not in ALGORITHMS:
        raise ValueError(f"{name}: the algorithm is {algorithm!r}; valid: {', '.join(sorted(ALGORITHMS))}")
    if not path.is_file():
        raise FileNotFoundError(f"{name}: there is no file {path}")
    return algorithm, path


def agent_config(path: Path) -> AgentConfig:
    """What stands in config.json beside an agent; nothing is known without. Raises ValueError."""
    beside = path.with_name("config.json")
    return AgentConfig.parse(read_json(beside), str(beside)) if beside.exists() else AgentConfig()


def agent_options(path: Path) -> dict[str, Any]:
    """The arm that an agent was trained on, and how it sees and moves it: not what was to be learned. Raises ValueError."""
    return {key: value for key, value in (agent_config(path).options or {}).items() if key in (*ARM, *INTERFACE)}


def caveats(judged: Mapping[str, dict[str, Any]]) -> list[str]:
    """What should be known of agents' files that are judged under these options, in lines. Raises as `agent_file`, `agent_config`."""
    found: dict[str, list[str]] = {}
    for name, options in judged.items():
        for text in _differences(agent_config(agent_file(name)[1]).options, options):
            found.setdefault(text, []).append(name)
    return [f"{', '.join(names)}: {text}" for text, names in found.items()]


def _differences(trained: dict[str, Any] | None, options: dict[str, Any]) -> list[str]:
    if trained is None:
        return ["no config.json says what it was trained on; numbers are right only if that was the arm and the options of this evaluation"]
    before, now = Options(**trained), Options(**options)
    other = [key for key in ARM if getattr(before, key) != getattr(now, key)]
    found = [f"trained with {key} = {shown(getattr(before, key))}, judged with {shown(getattr(now, key))}" for key in other]
    left_out = sorted(key for key in trained if key not in (*ARM, *INTERFACE) and trained[key] != options.get(key))
    return [*found, f"judged without the {', '.join(left_out)} of the training"] if left_out else found


def saved_settings(path: Path) -> dict[str, Any]:
    """What Stable-Baselines3 keeps of a model beside its weights. Raises ValueError."""
    try:
        with zipfile.ZipFile(path) as file:
            data = json.loads(file.read("data"))
        policy = data["policy_class"]["__module__"].split(".")
    except Exception as error:  # zipfile raises whatever it meets in a damaged file
        raise ValueError(f"{path} is no agent of Stable-Baselines3, or was cut or damaged: {first_line(error)}") from error
    return {**data, "policy_module": policy}


def algorithm_of(path: Path) -> str:
    """The algorithm that wrote a file of Stable-Baselines3. Raises ValueError."""
    algorithm = _algorithm_in(saved_settings(path))
    if algorithm is None:
        raise ValueError(f"{path} does not say which algorithm it is of: name it ALGORITHM:{path}")
    return algorithm


def _algorithm_in(data: dict[str, Any]) -> str | None:
    """None where the settings do not say."""
    module = data["policy_module"]
    found = [OWN_POLICIES[part] for part in module if part in OWN_POLICIES] + [SETTINGS[key] for key in SETTINGS if key in data]
    return "RecurrentPPO" if found and "recurrent" in module else next(iter(found), None)


def algorithm_class(algorithm: str) -> Any:
    """Its class in Stable-Baselines3. Raises ModuleNotFoundError."""
    try:
        return getattr(importlib.import_module(ALGORITHMS[algorithm]), algorithm)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f'{algorithm} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"') from error


class Agent:
    """A model of Stable-Baselines3, which sees observations through the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self._model, self._normalise = model, normalise

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self._normalise is None else self._normalise(observation)
        return self._model.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any) -> Policy:
    """The agent of a file, for an environment like its own. Raises ValueError, OSError, ModuleNotFoundError."""
    algorithm, path = agent_file(name)
    config = agent_config(path)
    needed = {file: config.files[file] for file in (path.name, STATISTICS) if file in config.files}
    check_digests(path.parent, needed, path.with_name("config.json"))
    settings = saved_settings(path)
    kind = algorithm_class(_checked_algorithm(name, algorithm, settings))
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    residual = None if config.residual is None else Residual(config.residual, env)
    space = env.observation_space if residual is None else residual.observation_space(env.observation_space)
    _check_arm(name, config, env)
    normalise = _normalisation(path, settings, config, space)
    model = read_model(kind, path, custom_objects=LEARNING)
    _check_spaces(name, model, space, env.action_space)
    agent = Agent(model, normalise)
    return agent if residual is None else ResidualPolicy(residual, agent)


def read_model(kind: Any, path: Path, **arguments: Any) -> Any:
    """A model of an algorithm's class. Raises ValueError, FileNotFoundError."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    try:
        return kind.load(path, device="cpu", **arguments)
    except Exception as error:  # unpickling raises whatever it meets
        raise ValueError(f"{path} cannot be loaded as {kind.__name__}, it may be cut or damaged: {first_line(error)}") from error


def _checked_algorithm(name: str, given: str | None, settings: dict[str, Any]) -> str:
    """Raises ValueError where a file is of another algorithm than was given, or does not say."""
    found = _algorithm_in(settings)
    if given is not None and found not in (None, given) and (given, found) != ("DDPG", "TD3"):  # which share everything but a default
        raise ValueError(f"{name}: the file is of {found}, not of {given}")
    if given is None and found is None:
        raise ValueError(f"{name} does not say which algorithm it is of: name it ALGORITHM:{name}")
    return given or found


def _check_arm(name: str, config: AgentConfig, env: Any) -> None:
    """Raises ValueError where an agent was trained on another arm, or with other observations or actions of the same size."""
    episodes = env.unwrapped.episodes
    trained = None if config.options is None else Options(**config.options)
    scene = None if trained is None else resolved_scene(trained)
    for part in PHYSICS if scene is not None else ():
        if getattr(scene, part) != getattr(episodes.model.scene, part):
            text = f"{name} was trained on an arm with other {part} (scene {scene.name!r}) than this environment's"
            raise ValueError(f"{text} ({episodes.model.scene.name!r}): an arm that differs from it is what `randomize` is for")
    layout = layout_of(episodes)
    if config.layout is not None and [*config.layout.items()] != [*layout.items()]:  # in the same order
        raise ValueError(f"{name} was trained with the observation {sizes(config.layout)}, this environment has {sizes(layout)}")
    before, now = (_interface(options, episodes) for options in (trained or episodes.options, episodes.options))
    for key in before:
        if before[key] != now[key]:
            raise ValueError(f"{name} was trained with {key} = {shown(before[key])}, this environment has {shown(now[key])}")


def _interface(options: Options, episodes: Any) -> dict[str, Any]:
    """What observations and actions mean beyond the names and sizes of groups, as far as there are such groups."""
    groups = tuple(episodes.layout.slices)
    return {
        "action": options.action,
        "tension_rate": options.tension_rate if options.action == "increment" else None,
        "preview": options.preview if any("preview" in group for group in groups) else None,
        "sensors": tuple(sensor_places(options, episodes.model.scene)) if any(group.startswith("strain") for group in groups) else None,
    }


def layout_of(episodes: Any) -> dict[str, int]:
    """The groups of an observation in their order, with their sizes."""
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def sizes(layout: Mapping[str, int]) -> str:
    """A layout in words."""
    return ", ".join(f"{group} ({size})" for group, size in layout.items())


def _check_spaces(name: str, trained: Any, observation_space: gym.Space, action_space: gym.Space) -> None:
    """Raises ValueError where an agent was trained on other observations or actions."""
    for key, space in (("observation_space", observation_space), ("action_space", action_space)):
        if getattr(trained, key) != space:
            text = f"{name} was trained with {key} {_shown(getattr(trained, key))}, this environment has {_shown(space)}"
            raise ValueError(f"{text}: see that the task is right, and that config.json beside it says its options")


def _shown(space: gym.Space) -> str:
    return str({key: part.shape for key, part in space.items()} if isinstance(space, gym.spaces.Dict) else space.shape)


def _normalisation(path: Path, settings: dict[str, Any], config: AgentConfig, space: gym.Space) -> Callable[[Any], Any] | None:
    """What to do to observations; None for an agent that learned from them as they are.

    Stable-Baselines3 keeps the last observation before its normalisation, of agents whose environments had one. Raises ValueError,
    FileNotFoundError where such an agent's statistics are missing, or of other observations.
    """
    from stable_baselines3.common.vec_env import VecNormalize

    beside = path.with_name(STATISTICS)
    if not beside.exists():
        if settings.get("_last_original_obs") is not None and config.normalise.get("observations", True):
            text = "it sees observations through the statistics of its training (VecNormalize), and would see others without"
            raise FileNotFoundError(f"{path} should have its {STATISTICS} beside it: {text}")
        return None
    statistics = read_pickle(beside, VecNormalize)
    if statistics.observation_space != space:
        raise ValueError(f"{beside} is of observations {_shown(statistics.observation_space)}, this environment has {_shown(space)}")
    return statistics.normalize_obs
