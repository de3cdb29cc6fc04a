"""Asymmetric actor-critic: a critic that is told the parameters drawn for every arm, which the policy cannot observe.

The value of a state depends on the stiffness, the payload or the delay that domain randomisation has drawn. A critic that is told them
has less to guess, and only the policy is needed to act (L. Pinto et al., Asymmetric actor critic for image-based robot learning,
RSS 2018). The parameters are columns of the observation after all others, which the policy's features have as zeros.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from soft_tendon_env.envs.arms import Material
from soft_tendon_env.envs.effect_ranges import EffectRanges
from soft_tendon_env.envs.episodes import Episodes
from soft_tendon_env.envs.randomization import Randomization
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.tools.types import Array


class DrawnParameters:
    """Parameters that domain randomisation draws, each from -1 to 1 within its range, for rows of episodes."""

    def __init__(self, episodes: Episodes, randomization: Randomization) -> None:
        self._episodes, self._effects = episodes, EffectRanges(randomization.effects, episodes.model)
        tendons, ends = episodes.model.tendon_count, []
        scene = episodes.model.scene.effects
        for i, effects in enumerate([own.effects for own in self._effects.extremes(1.0)] if self._effects else [scene, scene]):
            material = [getattr(randomization, name)[i] for name in Material._fields]
            actuators = np.repeat([randomization.tension_gain[i], randomization.tension_offset[i]], tendons)
            ends.append([*material, *actuators, randomization.latency[i], *self._of_effects(effects)])
        least, greatest = np.array(ends)
        self._drawn = np.flatnonzero(least < greatest)
        self._middle, self._half = (0.5 * (greatest + own * least)[self._drawn] for own in (1.0, -1.0))

    @property
    def size(self) -> int:
        """Number of parameters that differ from episode to episode."""
        return self._drawn.size

    def of(self, row: int) -> Array:
        """Parameters (size,) of a row."""
        draw = self._episodes.draws[row]
        raw = [*draw.material, *draw.gain, *draw.offset, draw.latency, *self._of_effects(self._episodes.arms.effects_of(row))]
        return (np.array(raw)[self._drawn] - self._middle) / self._half

    def _of_effects(self, effects: Any) -> Array:
        return np.concatenate([[], *map(np.ravel, self._effects.values(effects).values())])


class ToldVecEnv(VecEnvWrapper):
    """Vector environment whose observations end with the parameters drawn for every row, see DrawnParameters."""

    def __init__(self, env: VecEnv, randomization: Randomization) -> None:
        self._parameters = DrawnParameters(unwrapped(env).env.episodes, randomization)
        super().__init__(env, observation_space=_wider(env.observation_space, self._parameters.size))
        self._told = np.zeros((env.num_envs, self._parameters.size), dtype=np.float32)

    def reset(self) -> Any:
        observation = self.venv.reset()
        self._take(range(self.num_envs))
        return _joined(observation, self._told)

    def step_wait(self) -> VecEnvStepReturn:
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones).tolist()
        for row in ended:
            infos[row]["terminal_observation"] = _joined(infos[row]["terminal_observation"], self._told[row])
        self._take(ended)
        return _joined(observation, self._told), rewards, dones, infos

    def _take(self, rows: Any) -> None:
        for row in rows:
            self._told[row] = self._parameters.of(row)


def _wider(space: gym.Space[Any], count: int) -> Any:
    """Space of observations with so many parameters at the end."""
    if isinstance(space, gym.spaces.Dict):
        return gym.spaces.Dict({**space.spaces, "observation": _wider(space["observation"], count)})
    assert isinstance(space, gym.spaces.Box)
    low, high = (np.append(bound, np.full(count, end, dtype=np.float32)) for bound, end in ((space.low, -1.0), (space.high, 1.0)))
    return gym.spaces.Box(low, high, dtype=np.float32)


def _joined(observation: Any, told: Any) -> Any:
    """Observations, in dictionaries the last of their arrays, with the parameters at the end."""
    if isinstance(observation, dict):
        return {**observation, "observation": _joined(observation["observation"], told)}
    return np.concatenate([observation, told], axis=-1)


class Untold(torch.nn.Module):
    """Features of observations with zeros in place of all from a column on."""

    def __init__(self, extractor: Any, columns: int) -> None:
        super().__init__()
        self.extractor = extractor
        self.register_buffer("known", (torch.arange(extractor.features_dim) < columns).float(), persistent=False)

    def forward(self, observation: Any) -> torch.Tensor:
        features: torch.Tensor = self.extractor(observation) * self.known
        return features


def told_env(model: BaseAlgorithm) -> ToldVecEnv | None:
    """Environment of a model whose critic is told more than its policy; None: it is not."""
    env: Any = model.get_env()
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, ToldVecEnv):
            return env
        env = env.venv
    return None


def hide_from_policy(model: BaseAlgorithm) -> None:
    """Let the critic alone see what it is told, if anything."""
    if (env := told_env(model)) is not None:
        columns, policy = gym.spaces.flatdim(env.venv.observation_space), model.policy
        owner, name = (policy.actor, "features_extractor") if hasattr(policy, "actor") else (policy, "pi_features_extractor")
        setattr(owner, name, Untold(getattr(owner, name), columns))


def acting_network(model: BaseAlgorithm) -> Any:
    """Policy network that observes what agents do: the model's own, or one without what its critic is told. Its critic is as for an arm in
    the middle of all ranges."""
    policy: Any = model.policy
    if (env := told_env(model)) is None:
        return policy
    arguments = {"use_sde": getattr(model, "use_sde", False), **model.policy_kwargs}
    network = type(policy)(env.venv.observation_space, policy.action_space, lambda _: 0.0, **arguments)
    network.load_state_dict(resized(policy.state_dict(), network.state_dict(), gym.spaces.flatdim(env.venv.observation_space)))
    return network


def resized(weights: Mapping[str, Any], like: Mapping[str, Any], columns: int) -> dict[str, Any]:
    """Weights by name with inputs after so many columns left out, or put in with zeros, where others `like` them have fewer, or more."""
    found = dict(weights)
    for name in weights.keys() & like.keys():
        for axis, (size, wanted) in enumerate(zip(weights[name].shape, like[name].shape, strict=False)):
            kept = torch.tensor([*range(columns), *range(columns + abs(wanted - size), max(wanted, size))])
            if wanted < size:
                found[name] = found[name].index_select(axis, kept)
            elif wanted > size:
                shape = [*found[name].shape[:axis], wanted, *found[name].shape[axis + 1 :]]
                found[name] = found[name].new_zeros(shape).index_copy(axis, kept, found[name])
    return found
