"""Policy network in NumPy: the mean action of a trained agent, without PyTorch."""

from contextlib import nullcontext
from typing import Any

import gymnasium as gym
import numpy as np

from soft_tendon_env.policies.layers import Actor
from soft_tendon_env.policies.protocol import LostState
from soft_tendon_env.tools.linear_algebra import one_thread
from soft_tendon_env.tools.types import Single

NONE = np.float32(0.0)  # constants in single precision, so that actions stay in it
HALF = np.float32(0.5)
ONE = np.float32(1.0)
MOST_ROWS = 256
"""Rows up to which products have one thread. Where two cores were shared with other work, several
threads took 3 to 16 times as long for 16 to 256 rows, and no longer for one."""


class PolicyNetwork:
    """Policy network in NumPy with Stable-Baselines3's `predict`, for one observation or many.

    Products of a few rows have one thread, see `tools.linear_algebra`.

    Attributes:
        actor: layers from observations to mean actions.
        observations: space of what it observes.
    """

    def __init__(self, actor: Actor, observations: gym.Space[Any], actions: gym.spaces.Box) -> None:
        self.actor = actor
        self.observations = observations
        least = actions.low.astype(np.float32)
        greatest = actions.high.astype(np.float32)
        self._bounds = (least, greatest)
        self._lost = LostState("what the policy remembers")

    @property
    def memory(self) -> int:
        """Size of what it remembers from one control period to the next."""
        return 0 if self.actor.gates is None else self.actor.gates.size

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
        if not self.memory:
            nothing = plain[:, :0]
            action, _ = self._act(plain, nothing)
            return (action if many else action[0]), state
        is_first = episode_start is not None and bool(np.asarray(episode_start).any())
        self._lost.notice(state is None and not is_first)
        memory = self._read_memory(state, len(plain))
        if is_first:
            begins = np.atleast_1d(episode_start).astype(bool)
            memory = np.where(begins[:, None], NONE, memory)
        action, memory = self._act(plain, memory)
        return (action if many else action[0]), memory

    def _act(self, plain: Single, memory: Single) -> tuple[Single, Single]:
        """Actions (rows, n_a) within the action space, and the next memory (rows, size)."""
        is_few = 1 < len(plain) <= MOST_ROWS
        with one_thread() if is_few else nullcontext():
            mean, memory = self.actor(plain, memory)
        return self._bounded(mean), memory

    def _read_memory(self, state: Any, rows: int) -> Single:
        """The memory (rows, size) of a state, zeros for None."""
        shape = (rows, self.memory)
        if state is None:
            return np.zeros(shape, np.float32)
        memory = np.asarray(state, np.float32)
        # a state of other rows would be broadcast without a word
        if memory.shape != shape:
            raise ValueError(
                f"state should be what predict gave for these rows, of shape {shape}, not"
                f" {memory.shape}"
            )
        return memory

    def _bounded(self, mean: Single) -> Single:
        """Actions (rows, n_a) within the action space."""
        mean = np.ascontiguousarray(mean)
        low, high = self._bounds
        if self.actor.squashes:
            share = HALF * (np.tanh(mean) + ONE)
            return low + share * (high - low)
        # for one row quicker than clip
        above = np.maximum(mean, low)
        return np.minimum(above, high)


def flatten(observation: Any, space: gym.Space[Any]) -> tuple[Single, bool]:
    """Entries (rows, n) of one observation or many, as float32, and whether they are many.

    Those of a Dict are in the order of its keys.

    Raises:
        ValueError: a shape is not the space's, or that of rows of it.
    """
    if not isinstance(space, gym.spaces.Dict):
        return _rows("observation", observation, space)
    parts = []
    many = False
    for key, part in space.spaces.items():
        name = f"observation[{key!r}]"
        rows, many = _rows(name, observation[key], part)
        parts.append(rows)
    return np.concatenate(parts, axis=1), many


def _rows(name: str, values: Any, space: gym.Space[Any]) -> tuple[Single, bool]:
    if isinstance(values, tuple):
        raise ValueError(f"{name} is a tuple: `reset` returns an observation and its info")
    shape = space.shape
    array = np.asarray(values, dtype=np.float32)
    is_one = array.shape == shape
    if is_one:
        return array.reshape(1, -1), False
    if array.shape[1:] != shape:
        raise ValueError(f"{name} has the shape {array.shape}: it should be {shape}, or rows of it")
    count = len(array)
    return array.reshape(count, -1), True
