"""Trained agents as policies: what is in an agent's .zip file, and what must stand beside it.

`vecnormalize.pkl`: the statistics by which it sees observations (loading runs what is in both files: take them from nobody whom you do
not trust). `config.json`: the configuration that it was trained with, of which "options", "layout" and "residual" are read here.
"""

import importlib
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
from _residual import Residual, ResidualPolicy, ResidualSettings

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.evaluation import Policy
from soft_tendon_env.envs.options import resolved_scene

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


def agent_config(path: Path) -> dict[str, Any]:
    """What stands in config.json beside an agent, {} without. Raises ValueError."""
    beside = path.with_name("config.json")
    if not beside.exists():
        return {}
    config = json.loads(beside.read_text())
    if not isinstance(config, dict) or not isinstance(config.get("options", {}), dict):
        raise ValueError(f'{beside} should be {{"options": {{...}}}}, the options of an environment')
    Options.parse(config.get("options", {}), f"{beside}: options")
    return config


def agent_options(path: Path) -> dict[str, Any]:
    """The arm that an agent was trained on, and how it sees and moves it: not what was to be learned. Raises ValueError."""
    return {key: value for key, value in agent_config(path).get("options", {}).items() if key in (*ARM, *INTERFACE)}


def algorithm_of(path: Path) -> str:
    """The algorithm that wrote a file of Stable-Baselines3. Raises ValueError."""
    try:
        with zipfile.ZipFile(path) as file:
            data = json.loads(file.read("data"))
    except (zipfile.BadZipFile, KeyError) as error:
        raise ValueError(f"{path} is no agent of Stable-Baselines3") from error
    module = data["policy_class"].get("__module__", "").split(".")
    found = [OWN_POLICIES[part] for part in module if part in OWN_POLICIES] + [SETTINGS[key] for key in SETTINGS if key in data]
    if not found:
        raise ValueError(f"{path} does not say which algorithm it is of: name it ALGORITHM:{path}")
    return "RecurrentPPO" if "recurrent" in module else found[0]


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
    kind = algorithm_class(algorithm or algorithm_of(path))
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    config = agent_config(path)
    residual = None if config.get("residual") is None else Residual(ResidualSettings.parse(config["residual"], f"{path}: residual"), env)
    space = env.observation_space if residual is None else residual.observation_space(env.observation_space)
    _check_arm(name, config, env)
    model = kind.load(path, device="cpu", custom_objects=LEARNING)
    _check_spaces(name, model, space, env.action_space)
    agent = Agent(model, _normalisation(path.with_name("vecnormalize.pkl")))
    return agent if residual is None else ResidualPolicy(residual, agent)


def _check_arm(name: str, config: dict[str, Any], env: Any) -> None:
    """Raises ValueError where an agent was trained on another arm, or with other observations of the same size."""
    trained = resolved_scene(Options(**config.get("options", {}))) if "options" in config else None
    episodes = env.unwrapped.episodes
    for part in PHYSICS if trained is not None else ():
        if getattr(trained, part) != getattr(episodes.model.scene, part):
            text = f"{name} was trained on an arm with other {part} (scene {trained.name!r}) than this environment's"
            raise ValueError(f"{text} ({episodes.model.scene.name!r}): an arm that differs from it is what `randomize` is for")
    layout = layout_of(episodes)
    if [*config.get("layout", layout).items()] != [*layout.items()]:  # in the same order
        raise ValueError(f"{name} was trained with the observation {_sizes(config['layout'])}, this environment has {_sizes(layout)}")


def layout_of(episodes: Any) -> dict[str, int]:
    """The groups of an observation in their order, with their sizes."""
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def _sizes(layout: dict[str, int]) -> str:
    return ", ".join(f"{group} ({size})" for group, size in layout.items())


def _check_spaces(name: str, trained: Any, observation_space: gym.Space, action_space: gym.Space) -> None:
    """Raises ValueError where an agent was trained on other observations or actions."""
    for key, space in (("observation_space", observation_space), ("action_space", action_space)):
        if getattr(trained, key) != space:
            text = f"{name} was trained with {key} {_shown(getattr(trained, key))}, this environment has {_shown(space)}"
            raise ValueError(f"{text}: see that the task is right, and that config.json beside it says its options")


def _shown(space: gym.Space) -> str:
    return str({key: part.shape for key, part in space.items()} if isinstance(space, gym.spaces.Dict) else space.shape)


def _normalisation(statistics: Path) -> Callable[[Any], Any] | None:
    """What to do to observations; None without the file."""
    if not statistics.exists():
        return None
    with open(statistics, "rb") as file:
        return pickle.load(file).normalize_obs
