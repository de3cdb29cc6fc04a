"""Layers of policy networks in NumPy: functions of rows of values in single precision."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from soft_tendon_env.policies.activations import ACTIVATIONS
from soft_tendon_env.tools.types import Array


class Linear(NamedTuple):
    """Affine layer."""

    weight: Array  # (outputs, inputs)
    bias: Array | None = None  # (outputs,)

    def __call__(self, values: Array) -> Array:
        product = np.dot(values, self.weight.T)  # for one row quicker than matmul
        return product if self.bias is None else product + self.bias


class Activation(NamedTuple):
    """Activation function by its name in torch.nn, see `activations`."""

    name: str

    def __call__(self, values: Array) -> Array:
        return ACTIVATIONS[self.name](values)


class Renormalisation(NamedTuple):
    """Batch renormalisation with running statistics: S. Ioffe, Batch renormalization, NeurIPS 2017,
    as CrossQ acts by it."""

    mean: Array  # (n,)
    deviation: Array  # (n,)
    scale: Array  # (n,)
    bias: Array  # (n,)

    def __call__(self, values: Array) -> Array:
        return self.scale * ((values - self.mean) / self.deviation) + self.bias


class Clip(NamedTuple):
    """Bound on the magnitude of values."""

    most: float

    def __call__(self, values: Array) -> Array:
        return np.clip(values, -self.most, self.most)


Layer = Linear | Activation | Renormalisation | Clip


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Layers one after the other."""

    layers: tuple[Layer, ...]

    def __call__(self, values: Array) -> Array:
        for layer in self.layers:
            values = layer(values)
        return values


@dataclass(frozen=True, eq=False)
class Gates:
    """Memory of an episode: a minimal gated unit, see `learning.recurrent`."""

    gate: Linear
    candidate: Linear

    @property
    def size(self) -> int:
        return len(self.gate.weight)

    def __call__(self, seen: Array, memory: Array) -> Array:
        """Next memory (rows, size), of what is seen (rows, n) and the memory."""
        share = expit(self.gate(np.concatenate([seen, memory], axis=1)))
        recalled = np.concatenate([seen, share * memory], axis=1)
        candidate = np.tanh(self.candidate(recalled))
        return memory + share * (candidate - memory)


@dataclass(frozen=True, eq=False)
class Gains:
    """Part of the action that vanishes where the arm rests at its target: latent values times a
    linear map of all entries but those of posture."""

    posture: int  # number of first entries that are left out
    way: Linear
    gain: Linear

    def __call__(self, latent: Array, away: Array) -> Array:
        return self.gain(latent * self.way(away))
