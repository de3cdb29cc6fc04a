"""Trained agents as policies: their network, normalisation of observations and integral action. See agent_files.py for their files."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym

from soft_tendon_env.envs import Options
from soft_tendon_env.envs.episodes import Episodes, episodes_of
from soft_tendon_env.envs.options import resolved_scene
from soft_tendon_env.policies.agent_files import ARM, CONFIG, INTERFACE, AgentConfig, find_agent, read_config
from soft_tendon_env.policies.integral import IntegralPolicy
from soft_tendon_env.policies.network import WEIGHTS, Architecture, new_network, read_weights
from soft_tendon_env.policies.normalization import STATISTICS, Normalization, read_normalization, save_normalization
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.files import check_digests

PHYSICS = ("segments", "tendons", "effects")  # tables of a scene that define the physical arm, as opposed to how it is computed


class TrainingWarning(UserWarning):
    """An agent acts in another environment than it was trained in."""


class NetworkPolicy:
    """Model or policy network of Stable-Baselines3 that sees observations normalised by the statistics of its training."""

    def __init__(self, model: Any, normalise: Callable[[Any], Any] | None = None) -> None:
        self.network, self.normalise = model, normalise

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        seen = observation if self.normalise is None else self.normalise(observation)
        return self.network.predict(seen, state, episode_start, deterministic)


def load_agent(name: str, env: Any, other_effects: bool = False) -> Policy:
    """Trained agent as a policy for an environment like its own, single or vector; nothing is unpickled.

    name: of an agent that ships for the environment's task, or an agent's folder. other_effects: whether the arm may have effects that it
    was not trained with. Warns (TrainingWarning) of another task, arm, preset or control period than in its training. Raises TypeError for
    environments of other packages, ValueError, OSError, ModuleNotFoundError.
    """
    episodes = episodes_of(env)
    folder = find_agent(name, episodes.task.name)
    config = read_config(folder)
    check_digests(folder, {file: config.files[file] for file in (WEIGHTS, STATISTICS) if file in config.files}, folder / CONFIG)
    _check_agent(name, config, episodes, other_effects)
    rows = isinstance(env, gym.vector.VectorEnv)
    spaces = (env.single_observation_space, env.single_action_space) if rows else (env.observation_space, env.action_space)
    network, normalization = _network(folder / WEIGHTS, config, *spaces), None
    if (folder / STATISTICS).exists():
        normalization = read_normalization(folder / STATISTICS, spaces[0])
    elif config.normalise.get("observations"):
        raise FileNotFoundError(f"{folder} should have {STATISTICS}: the agent sees observations through it, and would see others without")
    return acting_policy(NetworkPolicy(network, normalization), env, config.integral_time)


def acting_policy(agent: Policy, env: Any, integral_time: float | None) -> Policy:
    """Policy of an agent in its environment, with integral action for an integral_time [s]. Raises ValueError as IntegralPolicy does."""
    return agent if integral_time is None else IntegralPolicy(agent, env, integral_time)


def save_agent(folder: Path, network: Any, normalization: Normalization | None) -> None:
    """Write an agent's weights and statistics into a folder, for a config.json that says the rest. Raises OSError, RuntimeError."""
    import torch

    torch.save(dict(network.state_dict()), folder / WEIGHTS)
    if normalization is not None:
        save_normalization(folder / STATISTICS, normalization)


def strain_of(scene: Scene) -> dict[str, Any]:
    return scene.strain.model_dump(mode="json", exclude_none=True)


def layout_of(episodes: Episodes) -> dict[str, int]:
    return {group: where.stop - where.start for group, where in episodes.layout.slices.items()}


def _network(path: Path, config: AgentConfig, observations: gym.Space[Any], actions: gym.Space[Any]) -> Any:
    """Network of an agent's weights. Raises ValueError where they are not of these spaces or its architecture."""
    import torch

    torch.set_num_threads(1)  # faster for one observation, and what other threads do does not matter
    weights = read_weights(path)
    try:
        network = new_network(Architecture(config.algorithm, config.policy_arguments), observations, actions)
        network.load_state_dict(weights)
    except (AssertionError, AttributeError, MemoryError, RuntimeError, TypeError, ValueError, KeyError) as error:
        text = " ".join(str(error).split())[:200]
        raise ValueError(f"{path}: the weights are not of a {config.algorithm} policy for this environment: {text}") from error
    return network


def _check_agent(name: str, config: AgentConfig, episodes: Episodes, other_effects: bool) -> None:
    """Raises ValueError where an agent was trained on another arm, or with another meaning of observations or actions. other_effects:
    those of the arm may be others. Warns (TrainingWarning) of another task, control period, or arm as it is computed."""
    now, scene, layout, trained = episodes.options, episodes.model.scene, layout_of(episodes), Options(**config.options)
    before = resolved_scene(trained)
    for key in PHYSICS:
        if getattr(before, key) != getattr(scene, key) and not (other_effects and key == "effects"):
            text = f"{name} was trained on an arm with other {key} (scene {before.name!r}) than this environment's ({scene.name!r})"
            raise ValueError(f"{text}: an arm that differs from it is what `randomize` is for")
    groups = [", ".join(f"{group} ({size})" for group, size in of.items()) for of in (config.layout or layout, layout)]
    values = {"observation": (groups[0], groups[1]), **{key: (getattr(trained, key), getattr(now, key)) for key in INTERFACE[1:]}}
    if {"coordinates", "rates", "target_coordinates"} & layout.keys():
        values["strain"] = (config.strain or strain_of(before), strain_of(scene))
    for key, (one, other) in values.items():
        if one != other:
            raise ValueError(f"{name} was trained with {key} = {one!r}, this environment has {other!r}")
    same = before.replace({"name": "arm"}) == scene.replace({"name": "arm"})
    soft = {"task": (config.task or episodes.task.name, episodes.task.name)}
    soft |= {key: (getattr(trained, key), getattr(now, key)) for key in ARM if key == "control_period" or not same}
    if not other_effects and (other := [f"{key} = {one!r}, judged with {two!r}" for key, (one, two) in soft.items() if one != two]):
        text = f"{name}: trained with {'; '.join(other)}. policy_options() has the options of its training"
        warnings.warn(text, TrainingWarning, stacklevel=5)
