"""Trained agents as policies, loaded without unpickling: their network, normalisation of observations and integral action.

A folder's three files are described in agent_files.py. Of a .zip file of Stable-Baselines3 the weights and the plain settings are read,
never what is pickled in it; the other two files may stand beside it.
"""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_checks import PHYSICS, TrainingWarning, check_arm, differences
from soft_tendon_env.policies.agent_files import CONFIG, AgentConfig, AgentFiles, find_agent, read_config, with_import
from soft_tendon_env.policies.integral import IntegralPolicy
from soft_tendon_env.policies.network import (
    WEIGHTS,
    Architecture,
    algorithm_in,
    architecture_in,
    make_network,
    read_weights,
    read_zip,
    save_weights,
)
from soft_tendon_env.policies.normalization import STATISTICS, Normalization, check_observations, read_normalization, save_normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import ConfigurationError, shown
from soft_tendon_env.tools.files import check_digests


class NetworkPolicy:
    """Model or policy network of Stable-Baselines3 that sees observations normalised by the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self.network, self.normalise = model, normalise

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self.normalise is None else self.normalise(observation)
        return self.network.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any, other_effects: bool = False) -> Policy:
    """Trained agent as a policy for an environment like its own, single or vector; nothing is unpickled.

    name: of an agent that ships for the environment's task, an agent's folder, or the .zip file of Stable-Baselines3. other_effects:
    whether the arm may have effects that it was not trained with. Warns (TrainingWarning) of another task, arm, preset or control period
    than in its training. Raises TypeError for environments of other packages, ValueError, OSError, ModuleNotFoundError.
    """
    episodes = episodes_of(env)
    files = find_agent(name, episodes.task.name)
    config = read_config(files)
    needed = {file: config.files[file] for file in (files.weights.name, STATISTICS) if file in config.files}
    check_digests(files.folder, needed, files.config)
    architecture, weights, settings = architecture_of(name, files, config)
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    rows = isinstance(env, gym.vector.VectorEnv)
    actions = env.single_action_space if rows else env.action_space
    space = env.single_observation_space if rows else env.observation_space
    try:
        check_arm(name, config, episodes, [part for part in PHYSICS if not (other_effects and part == "effects")])
    except ConfigurationError as error:  # of the arm that it was trained on
        raise with_import(error, str(files.config)) from error
    if not other_effects and (other := differences(config, episodes.options, episodes.task.name)):
        text = f"{name}: {'; '.join(other)}. policy_options() has the options of its training"
        warnings.warn(text, TrainingWarning, stacklevel=4)
    normalization = _normalization(files, config, settings, space)
    _check_sizes(name, settings, space, actions)
    try:
        network = make_network(architecture, weights, space, actions)
    except ValueError as error:
        raise ValueError(f"{files.weights}: {error}") from error
    agent = NetworkPolicy(network, normalization)
    return acting_policy(agent, env, config.integral_time)


def acting_policy(agent: Policy, env: Any, integral_time: float | None) -> Policy:
    """Policy of an agent in its environment, with integral action for an integral_time [s]. Raises ValueError as IntegralPolicy does."""
    return agent if integral_time is None else IntegralPolicy(agent, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> None:
    """Write an agent's weights and statistics into a folder, for a config.json that says the rest. Raises OSError, RuntimeError."""
    save_weights(folder / WEIGHTS, network)
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)


def architecture_of(name: str, files: AgentFiles, config: AgentConfig) -> tuple[Architecture, dict[str, Any], dict[str, Any]]:
    """Architecture of an agent's network, its weights, and the settings of a .zip file. Raises ValueError where they are not known."""
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
    """Algorithm of an agent. Raises ValueError where it is another than was given, or not known."""
    if given is not None and found not in (None, given) and (given, found) != ("DDPG", "TD3"):  # which share everything but a default
        raise ValueError(f"{name}: the file is of {found}, not of {given}")
    algorithm = given or found
    if algorithm is None:
        raise ValueError(f"{name} does not say which algorithm it is of: name it ALGORITHM:{name}")
    return algorithm


def _check_sizes(name: str, settings: Mapping[str, Any], observations: gym.Space[Any], actions: gym.Space[Any]) -> None:
    """Raises ValueError where a .zip file says that it was trained on observations or actions of other sizes."""
    for key, space in (("observation_space", observations), ("action_space", actions)):
        said = settings.get(key)
        size = said.get("_shape") if isinstance(said, dict) else None
        if isinstance(size, list) and tuple(size) != space.shape:
            shape = {key: part.shape for key, part in space.items()} if isinstance(space, gym.spaces.Dict) else space.shape
            text = f"{name} was trained with {key} {tuple(size)}, this environment has {shape}"
            raise ValueError(f"{text}: see that the task is right, and that config.json beside it says its options")


def _normalization(files: AgentFiles, config: AgentConfig, settings: Mapping[str, Any], space: gym.Space[Any]) -> Normalization | None:
    """Normalisation of observations; None for an agent that learned from them as they are.

    Raises ValueError, FileNotFoundError where the statistics of an agent that needs some are missing, or of other observations.
    """
    if not files.statistics.exists():
        last = settings.get("_last_original_obs")  # which Stable-Baselines3 keeps from before a VecNormalize, if there is one
        normalised = last is not None if files.is_zip else "observations" in config.normalise
        if normalised and config.normalise.get("observations", True):
            text = "it sees observations through the statistics of its training (VecNormalize), and would see others without"
            text += "; save_normalization of soft_tendon_env.policies.normalization writes them"
            text += f'. If it saw them as they are (norm_obs=False), {CONFIG} should say so: {{"normalise": {{"observations": false}}}}'
            raise FileNotFoundError(f"{files.path} should have its {STATISTICS} beside it: {text}")
        return None
    normalization = read_normalization(files.statistics)
    check_observations(files.statistics, normalization, space)
    return normalization
