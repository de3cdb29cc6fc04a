"""Policy network in NumPy: the mean action of a trained agent, without PyTorch."""

from typing import Any

import gymnasium as gym
import numpy as np

from soft_tendon_env.policies.layers import Feedforward, Gains, Gates
from soft_tendon_env.policies.protocol import LostState
from soft_tendon_env.tools.types import Array


class PolicyNetwork:
    """Policy network in NumPy with Stable-Baselines3's `predict`, for one observation or many.

    Attributes:
        body: layers up to the latent values.
        head: layers from there to the mean action.
        gates: the memory, None: there is none.
        gains: gains by the way to the target, None: there are none.
        fine: factor of small entries that layers see besides as tanh(fine x); 0: they do not.
        squashes: actions are tanh of the mean, scaled to the bounds of the action space.
    """

    def __init__(
        self,
        observations: gym.Space[Any],
        actions: gym.spaces.Box,
        body: Feedforward,
        head: Feedforward,
        squashes: bool = False,
        gates: Gates | None = None,
        gains: Gains | None = None,
        fine: float = 0.0,
    ) -> None:
        self.observations = observations
        self.actions = actions
        self.body = body
        self.head = head
        self.squashes = squashes
        self.gates = gates
        self.gains = gains
        self.fine = fine
        self._lost = LostState("what the policy remembers")

    @property
    def memory(self) -> int:
        """Size of what it remembers from one control period to the next."""
        return 0 if self.gates is None else self.gates.size

    def act(self, plain: Array, memory: Array) -> tuple[Array, Array]:
        """Mean actions (rows, n_a) before bounds and squashing, and the next memory, of entries of
        observations (rows, n) and the memory (rows, size)."""
        seen = self._finer(plain)
        if self.gates is not None:
            memory = self.gates(seen, memory)
            seen = np.concatenate([seen, memory], axis=1)
        latent = self.body(seen)
        mean = self.head(latent)
        if self.gains is not None:
            away = self._finer(plain[:, self.gains.posture :])
            mean = mean + self.gains(latent, away)
        return mean, memory

    def _finer(self, values: Array) -> Array:
        if not self.fine:
            return values
        return np.concatenate([values, np.tanh(np.float32(self.fine) * values)], axis=1)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Mean actions of one observation or many, and the memory to give back.

        Args:
            observation: of the space that the network was built for, or rows of them.
            state: memory (rows, size) that the last call gave; None: an episode begins.
            episode_start: (rows,) where an episode begins, whose memory is zero.
            deterministic: is taken as True: the noise of a training is no part of an agent.

        Returns:
            Actions (n_a,) or (rows, n_a) within the action space, and the next memory; the state as
            it is where the network has no memory.

        Raises:
            ValueError: an observation or a state has another shape.
        """
        plain, many = flatten(observation, self.observations)
        if self.gates is None:
            return self._bounded(self.act(plain, plain[:, :0])[0], many), state
        self._lost.notice(state is None and not np.any(episode_start))
        shape = (len(plain), self.memory)
        memory = np.zeros(shape, np.float32) if state is None else np.asarray(state, np.float32)
        if memory.shape != shape:
            raise ValueError(
                f"state should be what predict gave for these rows, of shape {shape}, not"
                f" {memory.shape}"
            )
        if episode_start is not None:
            begins = np.atleast_1d(episode_start).astype(bool)
            memory = np.where(begins[:, None], np.float32(0.0), memory)
        mean, memory = self.act(plain, memory)
        return self._bounded(mean, many), memory

    def _bounded(self, mean: Array, many: bool) -> Array:
        low, high = self.actions.low, self.actions.high
        if self.squashes:
            action = low + 0.5 * (np.tanh(mean) + 1.0) * (high - low)
        else:
            action = np.minimum(np.maximum(mean, low), high)  # quicker than clip for one row
        return action if many else action[0]


def flatten(observation: Any, space: gym.Space[Any]) -> tuple[Array, bool]:
    """Entries (rows, n) of one observation or many of a Box or a Dict of them, in the order of
    keys, as float32, and whether they are many.

    Raises:
        ValueError: a shape is not the space's, or that of rows of it.
    """
    if not isinstance(space, gym.spaces.Dict):
        return _rows("observation", observation, space)
    parts = []
    many = False
    for key, part in space.spaces.items():
        rows, many = _rows(f"observation[{key!r}]", observation[key], part)
        parts.append(rows)
    return np.concatenate(parts, axis=1), many


def _rows(name: str, values: Any, space: gym.Space[Any]) -> tuple[Array, bool]:
    if isinstance(values, tuple):
        raise ValueError(f"{name} is a tuple: `reset` returns an observation and its info")
    array = np.asarray(values, dtype=np.float32)
    shape = space.shape
    if array.shape == shape:
        return array.reshape(1, -1), False
    if array.shape[1:] != shape:
        raise ValueError(f"{name} has the shape {array.shape}: it should be {shape}, or rows of it")
    return array.reshape(len(array), -1), True
