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
from soft_tendon_env.envs.options import Options, resolved_scene
from soft_tendon_env.learning.vec_env import unwrapped
from soft_tendon_env.model.model import build_model
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array


class DrawnParameters:
    """Parameters that domain randomisation draws, each from -1 to 1 within its range, for rows of episodes.

    What is drawn within other ranges, as in a stage of a curriculum, is cut off there; what the row's effects do not say is 0.
    """

    def __init__(self, episodes: Episodes, options: Options) -> None:
        """options: those of the ranges, of which the episodes' may be a stage. Raises ConfigurationError where nothing is drawn."""
        model, randomize = build_model(resolved_scene(options)), options.randomize
        self._episodes, self._effects = episodes, EffectRanges(randomize.effects, model)
        scene = model.scene.effects
        effects = [own.effects for own in self._effects.extremes(1.0)] if self._effects else [scene, scene]
        ends = []
        for i in (0, 1):
            material = [getattr(randomize, name)[i] for name in Material._fields]
            actuators = np.repeat([randomize.tension_gain[i], randomize.tension_offset[i]], model.tendon_count)
            ends.append([*material, *actuators, randomize.latency[i], *self._of_effects(effects[i])])
        least, greatest = np.sort(ends, axis=0)  # a factor of a negative number has its least last
        self._drawn = np.flatnonzero(least < greatest)
        if not self._drawn.size:
            text = "is true: options.randomize should draw parameters that the critic can be told"
            raise ConfigurationError([Problem(("asymmetric_critic",), text)])
        self._middle, self._half = (0.5 * (greatest + own * least)[self._drawn] for own in (1.0, -1.0))

    @property
    def size(self) -> int:
        """Number of parameters that differ from episode to episode."""
        return self._drawn.size

    def of(self, row: int) -> Array:
        """Parameters (size,) of a row."""
        draw = self._episodes.draws[row]
        raw = [*draw.material, *draw.gain, *draw.offset, draw.latency, *self._of_effects(self._episodes.arms.effects_of(row))]
        return np.asarray(np.clip(np.nan_to_num((np.array(raw)[self._drawn] - self._middle) / self._half), -1.0, 1.0))

    def _of_effects(self, effects: Any) -> Array:
        return np.concatenate([[], *map(np.ravel, self._effects.values(effects).values())])


class ToldVecEnv(VecEnvWrapper):
    """Vector environment whose observations end with the `told` parameters drawn for every row, see DrawnParameters."""

    def __init__(self, env: VecEnv, options: Options) -> None:
        """options: of the training, see DrawnParameters. Raises ConfigurationError."""
        self._parameters = DrawnParameters(unwrapped(env).env.episodes, options)
        super().__init__(env, observation_space=_wider(env.observation_space, self._parameters.size))
        self.told = self._parameters.size
        self._told = np.zeros((env.num_envs, self.told), dtype=np.float32)

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
    """Policy network of the agent that is saved: the model's own, or a copy without the inputs that only its critic is told. The copy's
    critic values states as for an arm in the middle of all ranges."""
    policy: Any = model.policy
    if (env := told_env(model)) is None:
        return policy
    arguments = {"use_sde": getattr(model, "use_sde", False), **model.policy_kwargs}
    with torch.random.fork_rng():  # the training's own goes on as without
        network = type(policy)(env.venv.observation_space, policy.action_space, lambda _: 0.0, **arguments)
    weights, like = policy.state_dict(), network.state_dict()
    network.load_state_dict({name: own if own.shape == like[name].shape else own[:, _seen(own, env)] for name, own in weights.items()})
    return network


def with_told(model: BaseAlgorithm, weights: Mapping[str, Any]) -> dict[str, Any]:
    """Weights of an agent by name for a model whose critic may be told more, with zeros for what it is told."""
    found = dict(weights)
    if (env := told_env(model)) is None:
        return found
    for name, wide in model.policy.state_dict().items():
        own = weights.get(name)
        if own is not None and own.ndim == 2 and wide.shape == (own.shape[0], own.shape[1] + env.told):
            found[name] = torch.zeros_like(wide)
            found[name][:, _seen(wide, env)] = own
    return found


def _seen(weights: Any, env: ToldVecEnv) -> list[int]:
    """Inputs of a layer with these weights (outputs, inputs) that are not told."""
    first = gym.spaces.flatdim(env.venv.observation_space)
    return [*range(first), *range(first + env.told, weights.shape[1])]
