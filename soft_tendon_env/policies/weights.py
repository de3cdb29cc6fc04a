"""Weights of policy networks: arrays by the names of Stable-Baselines3's tensors.

They are in single precision, in an .npz file that is read without unpickling.

What a training needs besides is not among them: critics, exploration, optimisers.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from soft_tendon_env.policies.architecture import ON_POLICY, Architecture, check_sizes
from soft_tendon_env.policies.layers import (
    Activation,
    Actor,
    Clip,
    Feedforward,
    Gains,
    Gates,
    Layer,
    Linear,
    Lstm,
    LstmLayer,
    Renormalisation,
)
from soft_tendon_env.policies.network import PolicyNetwork
from soft_tendon_env.tools.files import read_arrays
from soft_tendon_env.tools.types import Single

WEIGHTS = "weights.npz"
LEARNING_ALONE = (
    "critic.",
    "critic_target.",
    "lstm_critic.",
    "value_net.",
    "mlp_extractor.value_net.",
    "log_std",
    "actor.log_std",
)
"""Beginnings of the names of tensors that a mean action does not depend on."""
COUNTER = ".steps"  # end of the names of counters of batch renormalisation, which trainings read


def acting_arrays(state: Mapping[str, Any]) -> dict[str, Single]:
    """Arrays (float32) of a state dictionary of PyTorch that actions depend on, by their names."""
    arrays = {}
    for name, tensor in state.items():
        if not name.startswith(LEARNING_ALONE) and not name.endswith(COUNTER):
            on_cpu = tensor.detach().cpu()
            arrays[name] = on_cpu.numpy().astype(np.float32)
    return arrays


def read_weights(path: Path) -> dict[str, Single]:
    """Arrays by name of an .npz file, without unpickling.

    Raises ValueError, OSError.
    """
    arrays = read_arrays(path, "weights alone")
    for name, array in arrays.items():
        if array.dtype != np.float32:
            raise ValueError(f"{path}: {name} is of type {array.dtype}: it should be float32")
        if not np.isfinite(array).all():
            raise ValueError(f"{path} has weights that are not finite, in {name}")
    return arrays


def build_network(
    architecture: Architecture,
    arrays: Mapping[str, Single],
    observations: gym.Space[Any],
    actions: gym.Space[Any],
) -> PolicyNetwork:
    """Policy network of named arrays, which acts as that of Stable-Baselines3 with them.

    Args:
        architecture: see `architecture.read_architecture`.
        arrays: float32 by the names of Stable-Baselines3's tensors.
        observations: Box, or Dict of them.
        actions: Box of one dimension.

    Returns:
        The network, whose arrays are those that were given.

    Raises:
        ValueError: an array is missing, is of another shape, or belongs to no layer, which the
            message names with the shape expected; or a space is no Box.
    """
    parts = {"": observations}
    if isinstance(observations, gym.spaces.Dict):
        parts = dict(observations.spaces)
    sizes = [math.prod(_box(space).shape) for space in parts.values()]
    inputs = sum(sizes)
    bounds = _box(actions)
    loader = _Loader(architecture, arrays, inputs, bounds.shape[0])
    actor = Actor(
        gates=loader.gates(),
        body=loader.body(),
        head=loader.head(),
        gains=loader.gains(),
        squashes=architecture.squashes,
        fine=architecture.fine,
    )
    loader.check_all_taken()
    return PolicyNetwork(actor, observations, bounds)


def _box(space: gym.Space[Any]) -> gym.spaces.Box:
    if not isinstance(space, gym.spaces.Box):
        raise ValueError(f"the environment has the space {space}: it should be a Box")
    return space


class _Loader:
    """Layers of an architecture out of arrays, each of which is taken once.

    Methods raise ValueError where an array is missing or has another shape.
    """

    def __init__(
        self, architecture: Architecture, arrays: Mapping[str, Single], inputs: int, outputs: int
    ) -> None:
        check_sizes(architecture.memory, architecture.posture, inputs)
        self._architecture = architecture
        self._left = dict(arrays)
        self._outputs = outputs
        copies = 2 if architecture.fine else 1  # entries, and their fine copies
        self._seen = copies * inputs + architecture.memory
        self._away = copies * (inputs - architecture.posture)
        self._told = architecture.lstm_size or self._seen  # to the hidden layers
        self._latent = architecture.hidden[-1] if architecture.hidden else self._told
        self._is_on_policy = architecture.kind in ON_POLICY

    def gates(self) -> Gates | Lstm | None:
        """The memory; None where there is none."""
        if self._architecture.lstm_size:
            return self._lstm()
        size = self._architecture.memory
        if not size:
            return None
        gate = self._linear("gate", self._seen, size)
        return Gates(gate, self._linear("candidate", self._seen, size))

    def _lstm(self) -> Lstm:
        """The LSTM, by PyTorch's names."""
        size = self._architecture.lstm_size
        layers = []
        inputs = self._seen
        for i in range(self._architecture.lstm_layers):
            name = "lstm_actor"
            of_input = Linear(
                self._take(f"{name}.weight_ih_l{i}", 4 * size, inputs),
                self._take(f"{name}.bias_ih_l{i}", 4 * size),
            )
            of_hidden = Linear(
                self._take(f"{name}.weight_hh_l{i}", 4 * size, size),
                self._take(f"{name}.bias_hh_l{i}", 4 * size),
            )
            layers.append(LstmLayer(of_input, of_hidden))
            inputs = size
        return Lstm(tuple(layers))

    def body(self) -> Feedforward:
        """Hidden layers, with batch renormalisation before each and after the last."""
        name = "mlp_extractor.policy_net" if self._is_on_policy else "actor.latent_pi"
        activation = Activation(self._architecture.activation)
        renormalises = self._architecture.renorm_epsilon is not None
        layers: list[Layer] = []
        inputs = self._told
        for outputs in self._architecture.hidden:
            # names of tensors have the place of the layer among all layers
            if renormalises:
                place = f"{name}.{len(layers)}"
                layers.append(self._renormalisation(place, inputs))
            place = f"{name}.{len(layers)}"
            layers.append(self._linear(place, inputs, outputs))
            layers.append(activation)
            inputs = outputs
        if layers and renormalises:
            place = f"{name}.{len(layers)}"
            layers.append(self._renormalisation(place, inputs))
        return Feedforward(tuple(layers))

    def head(self) -> Feedforward:
        """From the latent values to the mean action."""
        bound = self._architecture.clip_mean
        if self._is_on_policy:
            name = "action_net"
        elif bound is None:
            name = "actor.mu"
        else:
            # Stable-Baselines3 wraps this layer with the bound, which changes its name
            name = "actor.mu.0"
        mean = self._linear(name, self._latent, self._outputs)
        if bound is None:
            return Feedforward((mean,))
        return Feedforward((mean, Clip(bound)))

    def gains(self) -> Gains | None:
        posture = self._architecture.posture
        if not posture:
            return None
        way = self._take("way.weight", self._latent, self._away)
        gain = self._take("gain.weight", self._outputs, self._latent)
        return Gains(posture, Linear(way), Linear(gain))

    def check_all_taken(self) -> None:
        if self._left:
            names = ", ".join(self._left)
            raise ValueError(f"{names} should not be there: no layer of this network has them")

    def _take(self, name: str, *shape: int) -> Single:
        if name not in self._left:
            raise ValueError(f"{name} is missing, which should be of shape {shape}")
        array = self._left.pop(name)
        if array.shape != shape:
            raise ValueError(f"{name} is of shape {array.shape}: it should be {shape}")
        return array

    def _linear(self, name: str, inputs: int, outputs: int) -> Linear:
        weight = self._take(f"{name}.weight", outputs, inputs)
        return Linear(weight, self._take(f"{name}.bias", outputs))

    def _renormalisation(self, name: str, size: int) -> Renormalisation:
        epsilon = self._architecture.renorm_epsilon
        variance = self._take(f"{name}.ra_var", size)
        if (variance < 0.0).any():
            raise ValueError(f"{name}.ra_var has negative variances")
        return Renormalisation(
            mean=self._take(f"{name}.ra_mean", size),
            deviation=np.sqrt(variance + np.float32(epsilon)),
            scale=self._take(f"{name}.scale", size),
            bias=self._take(f"{name}.bias", size),
        )
