"""Policies by name: a controller of the catalogue, or the .zip file of a Stable-Baselines3 agent. Both have `predict`.

"measured:NAME" is the controller NAME, told strains at sensors and the tip's pose in place of the coordinates.

Beside an agent's file may stand `vecnormalize.pkl`, the statistics by which it sees observations (loading runs what is in both files:
take them from nobody whom you do not trust), and `config.json`, whose "options" are those of the environment that it was trained in.
"""

import importlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.control import CONTROLLERS
from soft_tendon_env.envs import Options
from soft_tendon_env.envs.evaluation import Policy
from soft_tendon_env.envs.policy import make_policy, observation_options

ALGORITHMS = {
    **dict.fromkeys(("A2C", "DDPG", "PPO", "SAC", "TD3"), "stable_baselines3"),
    **dict.fromkeys(("ARS", "CrossQ", "RecurrentPPO", "TQC", "TRPO"), "sb3_contrib"),
}
OWN_POLICIES = {"ars": "ARS", "crossq": "CrossQ", "sac": "SAC", "td3": "TD3", "tqc": "TQC"}  # DDPG is a TD3
SETTINGS = {"clip_range": "PPO", "cg_max_steps": "TRPO", "gae_lambda": "A2C"}  # tell apart those that share their policies
ALL = "all"
MEASURED = "measured:"


def policies_of(task: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, each once, with those of the catalogue in place of "all". Raises ValueError."""
    chosen = [name for given in names for name in (CONTROLLERS[task] if given == ALL else (given,))]
    if not chosen:
        raise ValueError(f"policies is {list(names)}: no controller is known for {task}, name an agent's .zip file")
    return tuple(dict.fromkeys(chosen))


def options_for(name: str, task: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment in which a policy sees what it needs: its own, and those given. Raises ValueError, OSError."""
    if is_agent(name):
        return {**agent_options(agent_file(name)[1]), **given}
    controller, measured = controller_of(name)
    return {**observation_options(controller, task, Options.parse(given, "options").control_period, measured), **given}


def load_policy(name: str, env: gym.Env) -> Policy:
    """The policy for an environment with the options that it needs. Raises ValueError, OSError, ModuleNotFoundError."""
    if is_agent(name):
        return Agent(name, env)
    controller, measured = controller_of(name)
    return make_policy(controller, env, measured=measured)


def controller_of(name: str) -> tuple[str, bool]:
    """Its name in the catalogue, and whether it is told strains."""
    return name.removeprefix(MEASURED), name.startswith(MEASURED)


def is_agent(name: str) -> bool:
    return name.endswith(".zip")


def short_name(name: str) -> str:
    """For pictures: of an agent's file or of a folder of runs, what tells it from others."""
    return "/".join(Path(name).with_suffix("").parts[-2:]) if is_agent(name) else Path(name).name


def agent_file(name: str) -> tuple[str | None, Path]:
    """Algorithm (None: not said) and path of "path.zip" or "ALGORITHM:path.zip". Raises ValueError, FileNotFoundError."""
    before, colon, after = name.partition(":")
    algorithm, path = (before, Path(after)) if colon and not Path(name).exists() else (None, Path(name))
    if algorithm is not None and algorithm not in ALGORITHMS:
        raise ValueError(f"{name}: the algorithm is {algorithm!r}; valid: {', '.join(sorted(ALGORITHMS))}")
    if not path.is_file():
        raise FileNotFoundError(f"{name}: there is no file {path}")
    return algorithm, path


def agent_options(path: Path) -> dict[str, Any]:
    """Options of the environment that an agent was trained in, but for what differed from episode to episode. Raises ValueError."""
    beside = path.with_name("config.json")
    if not beside.exists():
        return {}
    config = json.loads(beside.read_text())
    options = config.get("options", {}) if isinstance(config, dict) else None
    if not isinstance(options, dict):
        raise ValueError(f'{beside} should be {{"options": {{...}}}}, the options of an environment')
    Options.parse(options, f"{beside}: options")
    return {key: value for key, value in options.items() if key != "randomize"}


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


class Agent:
    """A trained agent, which sees observations through the statistics of its training."""

    def __init__(self, name: str, env: gym.Env) -> None:
        try:
            import torch
            from stable_baselines3.common.save_util import load_from_zip_file
            from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(f'{name} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"') from error
        torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
        algorithm, path = agent_file(name)
        algorithm = algorithm or algorithm_of(path)
        _check_spaces(name, load_from_zip_file(path, device="cpu")[0], env)
        kind = getattr(importlib.import_module(ALGORITHMS[algorithm]), algorithm)
        self._model = kind.load(path, env=env, device="cpu", custom_objects={"buffer_size": 1})  # nothing is learned here
        statistics = path.with_name("vecnormalize.pkl")
        self._normalise = None
        if statistics.exists():
            self._normalise = VecNormalize.load(str(statistics), DummyVecEnv([lambda: env])).normalize_obs

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self._normalise is None else self._normalise(observation)
        return self._model.predict(seen, state, episode_start, deterministic)


def _check_spaces(name: str, trained: dict[str, Any], env: gym.Env) -> None:
    """Raises ValueError where an agent was trained on other observations or actions."""
    for key in ("observation_space", "action_space"):
        if trained[key] != getattr(env, key):
            text = f"{name} was trained with {key} {_shown(trained[key])}, this environment has {_shown(getattr(env, key))}"
            raise ValueError(f"{text}: see that the task is right, and that config.json beside it says its options")


def _shown(space: gym.Space) -> str:
    return str({key: part.shape for key, part in space.items()} if isinstance(space, gym.spaces.Dict) else space.shape)
