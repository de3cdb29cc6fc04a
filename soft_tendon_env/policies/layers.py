"""Layers of policy networks in NumPy: functions of rows of values in single precision."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from soft_tendon_env.policies.activations import ACTIVATIONS
from soft_tendon_env.tools.types import Single


class Linear(NamedTuple):
    """Affine layer."""

    weight: Single  # (outputs, inputs)
    bias: Single | None = None  # (outputs,)

    def __call__(self, values: Single) -> Single:
        # quicker than matmul for one row, and with the weights first for twenty in half of the time
        product: Single = np.dot(self.weight, values.T).T
        if self.bias is not None:
            product += self.bias
        return product


class Activation(NamedTuple):
    """Activation function by its name in torch.nn, see `activations`."""

    name: str

    def __call__(self, values: Single) -> Single:
        return ACTIVATIONS[self.name](values)


class Renormalisation(NamedTuple):
    """Batch renormalisation with running statistics, as CrossQ acts by it.

    S. Ioffe, Batch renormalization, NeurIPS 2017.
    """

    mean: Single  # (n,)
    deviation: Single  # (n,)
    scale: Single  # (n,)
    bias: Single  # (n,)

    def __call__(self, values: Single) -> Single:
        normal = (values - self.mean) / self.deviation
        return self.scale * normal + self.bias


class Clip(NamedTuple):
    """Bound on the magnitude of values."""

    most: float

    def __call__(self, values: Single) -> Single:
        return np.clip(values, -self.most, self.most)


Layer = Linear | Activation | Renormalisation | Clip


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Layers one after the other."""

    layers: tuple[Layer, ...]

    def __call__(self, values: Single) -> Single:
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

    def __call__(self, seen: Single, memory: Single) -> tuple[Single, Single]:
        """Values (rows, n + size) for the layers, with the next memory, and that (rows, size).

        Args:
            seen: (rows, n).
            memory: (rows, size).
        """
        inputs = np.concatenate([seen, memory], axis=1)
        recalled = inputs[:, seen.shape[1] :]  # a view: writing to it changes the inputs
        share = expit(self.gate(inputs))
        recalled *= share
        candidate: Single = np.tanh(self.candidate(inputs))
        # in place: a new array takes as long as a product of these sizes
        candidate -= memory
        candidate *= share
        candidate += memory
        # the action follows what is remembered now, this period's observation included
        recalled[:] = candidate
        return inputs, candidate


class LstmLayer(NamedTuple):
    """Layer of an LSTM, with PyTorch's order of gates: input, forget, cell, output."""

    of_input: Linear  # (4 size, inputs)
    of_hidden: Linear  # (4 size, size)

    def __call__(self, values: Single, hidden: Single, cell: Single) -> tuple[Single, Single]:
        """Next hidden and cell state, (rows, size) each.

        S. Hochreiter and J. Schmidhuber, Neural Computation 9 (8), 1997, with forget gates.
        """
        sums = self.of_input(values) + self.of_hidden(hidden)
        enters, stays, candidate, leaves = np.split(sums, 4, axis=1)
        kept = expit(stays) * cell
        taken = expit(enters) * np.tanh(candidate)
        next_cell = kept + taken
        next_hidden = expit(leaves) * np.tanh(next_cell)
        return next_hidden, next_cell


@dataclass(frozen=True, eq=False)
class Lstm:
    """Memory of an episode: a long short-term memory, whose last hidden state alone goes on."""

    layers: tuple[LstmLayer, ...]

    @property
    def size(self) -> int:
        return 2 * len(self.layers) * self._state_size

    @property
    def _state_size(self) -> int:
        """Size of the hidden state of a layer, and of its cell state."""
        return self.layers[0].of_hidden.weight.shape[1]

    def __call__(self, seen: Single, memory: Single) -> tuple[Single, Single]:
        """Hidden state (rows, size of a layer) of the last layer, and the next memory.

        Args:
            seen: (rows, n).
            memory: (rows, size), the hidden and the cell state of each layer in turn.
        """
        states = np.split(memory, 2 * len(self.layers), axis=1)
        values = seen
        following = []
        hidden_states = states[::2]
        cells = states[1::2]
        for layer, hidden, cell in zip(self.layers, hidden_states, cells, strict=True):
            hidden, cell = layer(values, hidden, cell)
            following += [hidden, cell]
            values = hidden
        return values, np.concatenate(following, axis=1)


@dataclass(frozen=True, eq=False)
class Gains:
    """Part of the action that vanishes where the arm rests at its target.

    It is latent values times a linear map of all entries but those of posture.
    """

    posture: int  # number of first entries that are left out
    way: Linear
    gain: Linear

    def __call__(self, latent: Single, away: Single) -> Single:
        return self.gain(latent * self.way(away))


@dataclass(frozen=True, eq=False)
class Actor:
    """Layers of a policy network, from observations to mean actions.

    Attributes:
        body: layers up to the latent values.
        head: layers from there to the mean action.
        squashes: actions are tanh of the mean, scaled to the bounds of the action space.
        gates: the memory; None: there is none.
        gains: gains by the way to the target; None: there are none.
        fine: factor of small entries that layers see besides as tanh(fine x); 0: they do not.
    """

    body: Feedforward
    head: Feedforward
    squashes: bool = False
    gates: Gates | Lstm | None = None
    gains: Gains | None = None
    fine: float = 0.0

    def __call__(self, plain: Single, memory: Single) -> tuple[Single, Single]:
        """Mean actions (rows, n_a) before bounds and squashing, and the next memory.

        Args:
            plain: entries of observations (rows, n).
            memory: (rows, size).
        """
        scales = [plain]
        if self.fine:
            magnified = np.float32(self.fine) * plain
            scales.append(np.tanh(magnified))
        seen = np.concatenate(scales, axis=1)
        if self.gates is not None:
            seen, memory = self.gates(seen, memory)
        latent = self.body(seen)
        mean = self.head(latent)
        if self.gains is not None:
            parts = [values[:, self.gains.posture :] for values in scales]
            away = np.concatenate(parts, axis=1)
            mean += self.gains(latent, away)
        return mean, memory
