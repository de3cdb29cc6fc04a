"""Policy networks of agents in PyTorch, which traces them: the same layers as in NumPy."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import torch
from torch import Tensor

from soft_tendon_env.differentiable.gated_unit import next_memory, with_fine_entries
from soft_tendon_env.policies.layers import (
    Activation,
    Clip,
    Feedforward,
    Layer,
    Linear,
    Lstm,
    Renormalisation,
)
from soft_tendon_env.policies.network import PolicyNetwork


class TensorNetwork(torch.nn.Module):
    """Policy network in PyTorch that acts as one in NumPy, by the formulas of its methods.

    Raises ValueError for one with an LSTM.
    """

    def __init__(self, network: PolicyNetwork) -> None:
        super().__init__()
        actor = network.actor
        self.memory = network.memory
        self._squashes = actor.squashes
        self._fine = actor.fine
        self._keys: list[str] = []
        if isinstance(network.observations, gym.spaces.Dict):
            self._keys = [*network.observations.spaces]
        self.body = tensor_layers(actor.body)
        self.head = tensor_layers(actor.head)
        if isinstance(actor.gates, Lstm):
            raise ValueError(
                "policy has an LSTM, which ONNX files do not have here: export another"
            )
        if actor.gates is not None:
            self.gate = tensor_layer(actor.gates.gate)
            self.candidate = tensor_layer(actor.gates.candidate)
        self._posture: int | None = None
        if actor.gains is not None:
            self._posture = actor.gains.posture
            self.way = tensor_layer(actor.gains.way)
            self.gain = tensor_layer(actor.gains.gain)

    def forward(
        self, observation: Tensor | Mapping[str, Tensor], memory: Tensor | None
    ) -> tuple[Tensor, Tensor | None]:
        """Actions (rows, n_a) before the bounds of the action space, and the next memory.

        Args:
            observation: rows (rows, n), or a table of them.
            memory: (rows, size), None where there is none.
        """
        plain = self._flatten(observation)
        seen = with_fine_entries(plain, self._fine)
        if memory is not None:
            # the action follows what is remembered now, this period's observation included
            memory = next_memory(self.gate, self.candidate, seen, memory)
            seen = torch.cat([seen, memory], dim=1)
        latent = self.body(seen)
        mean = self.head(latent)
        if self._posture is not None:
            posture = plain[:, self._posture :]
            away = with_fine_entries(posture, self._fine)
            towards = self.way(away)
            gains = self.gain(latent * towards)
            mean = mean + gains
        if self._squashes:
            mean = torch.tanh(mean)
        return mean, memory

    def _flatten(self, observation: Tensor | Mapping[str, Tensor]) -> Tensor:
        """Entries (rows, n) of an observation, those of a table in the order of its keys."""
        if not isinstance(observation, Mapping):
            return observation
        parts = [observation[key] for key in self._keys]
        return torch.cat(parts, dim=1)


class TensorRenormalisation(torch.nn.Module):
    """Batch renormalisation with running statistics, see `policies.layers.Renormalisation`."""

    def __init__(self, layer: Renormalisation) -> None:
        super().__init__()
        self.mean = torch.as_tensor(layer.mean)
        self.deviation = torch.as_tensor(layer.deviation)
        self.scale = torch.as_tensor(layer.scale)
        self.bias = torch.as_tensor(layer.bias)

    def forward(self, values: Tensor) -> Tensor:
        normalised = (values - self.mean) / self.deviation
        return self.scale * normalised + self.bias


def tensor_layers(layers: Feedforward) -> torch.nn.Sequential:
    """Layers one after the other in PyTorch."""
    tensor_layers = (tensor_layer(layer) for layer in layers.layers)
    return torch.nn.Sequential(*tensor_layers)


def tensor_layer(layer: Layer) -> torch.nn.Module:
    """A layer in PyTorch."""
    if isinstance(layer, Activation):
        activation: Any = getattr(torch.nn, layer.name)
        made: torch.nn.Module = activation()
        return made
    if isinstance(layer, Clip):
        return torch.nn.Hardtanh(-layer.most, layer.most)
    if isinstance(layer, Renormalisation):
        return TensorRenormalisation(layer)
    return _tensor_linear(layer)


def _tensor_linear(layer: Linear) -> torch.nn.Linear:
    has_bias = layer.bias is not None
    outputs, inputs = layer.weight.shape
    made = torch.nn.Linear(inputs, outputs, bias=has_bias)
    with torch.no_grad():
        weight = torch.as_tensor(layer.weight)
        made.weight.copy_(weight)
        if layer.bias is not None:
            bias = torch.as_tensor(layer.bias)
            made.bias.copy_(bias)
    return made
