"""Policy network of Stable-Baselines3 that can remember, by a gated unit whose state goes from one
control period to the next."""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor, MlpExtractor

from soft_tendon_env.policies.architecture import check_sizes
from soft_tendon_env.policies.protocol import LostState

SLOW = -1.0  # bias of the gates at first: about a quarter of the memory is new in a control period


class RecurrentPolicy(ActorCriticPolicy):
    """Policy of PPO whose layers see what it observes and what it remembers of the episode.

    The memory is that of a minimal gated unit (G.-B. Zhou et al., Int. J. Automation and Computing
    13, 2016), zero where an episode begins. memory: its size, 0: none. fine: factor of small
    entries, as those of errors of a millimetre, which layers see besides as tanh(fine x); 0: they
    do not. posture: number of the first entries, which say how the arm is bent and commanded; the
    others vanish where it rests at its target, and are multiplied by gains, a part of the action
    that vanishes too; 0: there are no gains. Other arguments are those of ActorCriticPolicy. Raises
    ValueError for sizes that cannot be.
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
        self.memory, self.fine, self.posture, self._lost = (
            memory,
            fine,
            posture,
            LostState("what the policy remembers"),
        )
        features = (
            CombinedExtractor
            if isinstance(observation_space, gym.spaces.Dict)
            else FlattenExtractor
        )
        spaces = observation_space, action_space
        super().__init__(
            *spaces, lr_schedule, net_arch, activation_fn, features_extractor_class=features
        )

    def _build_mlp_extractor(self) -> None:
        check_sizes(self.memory, self.posture, self.features_dim)
        both = self.features_dim * (2 if self.fine else 1) + self.memory
        if self.memory:
            self.gate, self.candidate = (
                torch.nn.Linear(both, self.memory),
                torch.nn.Linear(both, self.memory),
            )
            torch.nn.init.constant_(self.gate.bias, SLOW)
        self.mlp_extractor = MlpExtractor(both, self.net_arch, self.activation_fn, self.device)
        if self.posture:
            away = (self.features_dim - self.posture) * (2 if self.fine else 1)
            self.way = torch.nn.Linear(away, self.mlp_extractor.latent_dim_pi, bias=False)
            self.gain = torch.nn.Linear(
                self.mlp_extractor.latent_dim_pi, get_action_dim(self.action_space), bias=False
            )

    def act(self, observation: Any, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean actions (rows, n_a) and the next memory, of observations and the memory (rows,
        size)."""
        plain: Any = self.extract_features(observation, self.pi_features_extractor)
        seen = self._finer(plain)
        if self.memory:
            share = torch.sigmoid(self.gate(torch.cat([seen, memory], dim=1)))
            new = torch.tanh(self.candidate(torch.cat([seen, share * memory], dim=1)))
            memory = memory + share * (new - memory)
        latent = self.mlp_extractor.forward_actor(torch.cat([seen, memory], dim=1))
        if self.posture:
            return (
                self.action_net(latent)
                + self.gain(latent * self.way(self._finer(plain[:, self.posture :]))),
                memory,
            )
        return self.action_net(latent), memory

    def _finer(self, values: torch.Tensor) -> torch.Tensor:
        return torch.cat([values, torch.tanh(self.fine * values)], dim=1) if self.fine else values

    def _predict(self, observation: Any, deterministic: bool = False) -> torch.Tensor:
        return self.act(observation, torch.zeros(_rows(observation), self.memory))[0]

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray[Any, Any], Any]:
        """Mean actions for one observation or many, and the memory (rows, size) to give back.
        Raises ValueError for another memory."""
        self._lost.notice(bool(self.memory) and state is None and not np.any(episode_start))
        seen, many = self.obs_to_tensor(observation)
        shape = _rows(seen), self.memory
        memory = torch.zeros(shape) if state is None else torch.as_tensor(state)
        if memory.shape != shape:
            raise ValueError(
                f"state should be what predict gave for these rows, of shape {shape}, not"
                f" {tuple(memory.shape)}"
            )
        if episode_start is not None:
            memory = memory * torch.as_tensor(~np.atleast_1d(episode_start).astype(bool))[:, None]
        with torch.no_grad():
            mean, memory = self.act(seen, memory)
        action = np.clip(mean.numpy(), self.action_space.low, self.action_space.high)  # type: ignore[attr-defined]
        return action if many else action[0], memory.numpy()


def _rows(observation: Any) -> int:
    return len(next(iter(observation.values())) if isinstance(observation, dict) else observation)
