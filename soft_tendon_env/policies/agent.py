"""Trained agents as policies: their network, normalisation of observations and integral action. See agent_files.py for their files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_checks import check_agent
from soft_tendon_env.policies.agent_files import CONFIG, AgentConfig, AgentFiles, find_agent, read_config
from soft_tendon_env.policies.integral import IntegralPolicy
from soft_tendon_env.policies.network import WEIGHTS, Architecture, load_zip, new_network, read_weights, save_weights
from soft_tendon_env.policies.normalization import STATISTICS, Normalization, check_observations, read_normalization, save_normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.files import check_digests


class NetworkPolicy:
    """Model or policy network of Stable-Baselines3 that sees observations normalised by the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self.network, self.normalise = model, normalise

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self.normalise is None else self.normalise(observation)
        return self.network.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any, other_effects: bool = False) -> Policy:
    """Trained agent as a policy for an environment like its own, single or vector.

    A folder is read without unpickling; a .zip file is unpickled by Stable-Baselines3: load those of people whom you trust.

    name: of an agent that ships for the environment's task, an agent's folder, or the .zip file of Stable-Baselines3. other_effects:
    whether the arm may have effects that it was not trained with. Warns (TrainingWarning) of another task, arm, preset or control period
    than in its training. Raises TypeError for environments of other packages, ValueError, OSError, ModuleNotFoundError.
    """
    episodes = episodes_of(env)
    files = find_agent(name, episodes.task.name)
    config = read_config(files)
    check_digests(files.folder, {file: config.files[file] for file in (WEIGHTS, STATISTICS) if file in config.files}, files.config)
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    check_agent(name, config, episodes, other_effects)
    rows = isinstance(env, gym.vector.VectorEnv)
    spaces = (env.single_observation_space, env.single_action_space) if rows else (env.observation_space, env.action_space)
    network, normalised = load_zip(files.path) if files.is_zip else (_network(files, config, *spaces), False)
    if (network.observation_space.shape, network.action_space.shape) != (spaces[0].shape, spaces[1].shape):
        text = (
            f"observations {network.observation_space} and actions {network.action_space}, this environment has {spaces[0]} and {spaces[1]}"
        )
        raise ValueError(f"{name} was trained with {text}")
    normalization = None
    if files.statistics.exists():
        normalization = read_normalization(files.statistics)
        check_observations(files.statistics, normalization, spaces[0])
    elif config.normalise.get("observations", normalised):
        text = "it sees observations through the statistics of its training (VecNormalize), and would see others without"
        text += "; save_normalization of soft_tendon_env.policies.normalization writes them"
        text += f'. If it saw them as they are (norm_obs=False), {CONFIG} should say so: {{"normalise": {{"observations": false}}}}'
        raise FileNotFoundError(f"{files.path} should have its {STATISTICS} beside it: {text}")
    return acting_policy(NetworkPolicy(network, normalization), env, config.integral_time)


def acting_policy(agent: Policy, env: Any, integral_time: float | None) -> Policy:
    """Policy of an agent in its environment, with integral action for an integral_time [s]. Raises ValueError as IntegralPolicy does."""
    return agent if integral_time is None else IntegralPolicy(agent, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> None:
    """Write an agent's weights and statistics into a folder, for a config.json that says the rest. Raises OSError, RuntimeError."""
    save_weights(folder / WEIGHTS, network)
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)


def _network(files: AgentFiles, config: AgentConfig, observations: gym.Space[Any], actions: gym.Space[Any]) -> Any:
    """Network of an agent's folder. Raises ValueError where the weights are not of these spaces or its architecture."""
    weights = read_weights(files.weights)
    try:
        network = new_network(Architecture(str(config.algorithm), config.policy_arguments), observations, actions)
        network.load_state_dict(weights)
    except (AssertionError, AttributeError, MemoryError, RuntimeError, TypeError, ValueError, KeyError) as error:
        text = " ".join(str(error).split())[:200]
        raise ValueError(f"{files.weights}: the weights are not of a {config.algorithm} policy for this environment: {text}") from error
    return network
