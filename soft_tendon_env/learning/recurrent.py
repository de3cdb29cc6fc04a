"""Recurrent policy network of Stable-Baselines3, by a gated unit.

Its state goes from one control period to the next.
"""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor, MlpExtractor
from torch import Tensor

from soft_tendon_env.differentiable.gated_unit import next_memory, with_fine_entries
from soft_tendon_env.policies.architecture import check_sizes
from soft_tendon_env.policies.protocol import LostState

SLOW = -1.0  # bias of the gates at first: about a quarter of the memory is new in a control period


class RecurrentPolicy(ActorCriticPolicy):
    """Policy of PPO whose layers see what it observes and what it remembers of the episode.

    The memory is that of a minimal gated unit, see `next_memory`, zero where an episode begins.

    Args:
        memory: its size; 0: there is none.
        fine: factor of small entries, as those of errors of a millimetre, which layers see besides
            as tanh(fine x); 0: they do not.
        posture: number of the first entries, which say how the arm is bent and commanded. The
            others vanish where it rests at its target, and are multiplied by gains, a part of the
            action that vanishes too; 0: there are no gains.
        others: see ActorCriticPolicy.

    Raises:
        ValueError: sizes cannot be.
    """

    def __init__(
        self,
        observation_space: gym.Space[Any],
        action_space: gym.Space[Any],
        lr_schedule: Any,
        net_arch: Any = None,
        activation_fn: type[torch.nn.Module] = torch.nn.Tanh,
        memory: int = 0,
        fine: float = 0.0,
        posture: int = 0,
    ) -> None:
        self.memory = memory
        self.fine = fine
        self.posture = posture
        self._lost = LostState("what the policy remembers")
        is_dict = isinstance(observation_space, gym.spaces.Dict)
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            net_arch,
            activation_fn,
            features_extractor_class=CombinedExtractor if is_dict else FlattenExtractor,
        )

    def _build_mlp_extractor(self) -> None:
        check_sizes(self.memory, self.posture, self.features_dim)
        if self.fine:
            times = 2
        else:
            times = 1
        inputs = self.features_dim * times + self.memory
        if self.memory:
            self.gate = torch.nn.Linear(inputs, self.memory)
            self.candidate = torch.nn.Linear(inputs, self.memory)
            torch.nn.init.constant_(self.gate.bias, SLOW)
        self.mlp_extractor = MlpExtractor(inputs, self.net_arch, self.activation_fn, self.device)
        if self.posture:
            away = (self.features_dim - self.posture) * times
            latent = self.mlp_extractor.latent_dim_pi
            actions = get_action_dim(self.action_space)
            self.way = torch.nn.Linear(away, latent, bias=False)
            self.gain = torch.nn.Linear(latent, actions, bias=False)

    def act(self, observation: Any, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Mean actions (rows, n_a) and the next memory.

        Args:
            observation: rows of it.
            memory: (rows, size).
        """
        plain: Any = self.extract_features(observation, self.pi_features_extractor)
        seen = with_fine_entries(plain, self.fine)
        if self.memory:
            memory = next_memory(self.gate, self.candidate, seen, memory)
        features = torch.cat([seen, memory], dim=1)
        latent = self.mlp_extractor.forward_actor(features)
        mean = self.action_net(latent)
        if self.posture:
            posture = plain[:, self.posture :]
            away = with_fine_entries(posture, self.fine)
            towards = self.way(away)
            gains = self.gain(latent * towards)
            mean = mean + gains
        return mean, memory

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        nothing = torch.zeros(_rows(observation), self.memory)
        mean, _ = self.act(observation, nothing)
        return mean

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray[Any, Any], Any]:
        """Mean actions for one observation or many, and the memory (rows, size) to give back.

        Raises:
            ValueError: the state has another shape.
        """
        is_first = bool(np.any(episode_start))
        is_lost = state is None and not is_first
        self._lost.notice(bool(self.memory) and is_lost)
        seen, many = self.obs_to_tensor(observation)
        memory = self._read_memory(state, _rows(seen))
        if episode_start is not None:
            begins = np.atleast_1d(episode_start).astype(bool)
            goes_on = torch.as_tensor(~begins)
            memory = memory * goes_on[:, None]
        with torch.no_grad():
            mean, memory = self.act(seen, memory)
        bounds: Any = self.action_space
        action = np.clip(mean.numpy(), bounds.low, bounds.high)
        if not many:
            action = action[0]
        return action, memory.numpy()

    def _read_memory(self, state: Any, rows: int) -> Tensor:
        """The memory (rows, size) of a state, zeros for None."""
        shape = (rows, self.memory)
        if state is None:
            memory = torch.zeros(shape)
        else:
            memory = torch.as_tensor(state)
        if memory.shape != shape:
            raise ValueError(
                f"state should be what predict gave for these rows, of shape {shape}, not"
                f" {tuple(memory.shape)}"
            )
        return memory


def _rows(observation: Any) -> int:
    """Number of rows of an observation."""
    if isinstance(observation, dict):
        return len(next(iter(observation.values())))
    return len(observation)
