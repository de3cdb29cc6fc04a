"""Policy interface: Stable-Baselines3's `predict`, which controllers and trained agents have."""

import warnings
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

Memory = TypeVar("Memory")

STATELESS_CALLS = 10
"""Calls of `predict` in a row without state after which a warning says so: whoever asks for first
actions alone hardly makes as many."""


class Policy(Protocol):
    """Policy with the interface of Stable-Baselines3.

    Observation and state go in, action and the next state come out.
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Computes the action for an observation.

        Args:
            observation: of the environment, or rows of them.
            state: what the last call returned, None at the beginning of episodes.
            episode_start: (rows,) bool, rows whose episodes begin; None: no row.
            deterministic: whether to act without exploration.

        Returns:
            The action, and the state to pass with the next observation.
        """


class LostState:
    """Warns, once, where calls of `predict` neither give a state back nor say that episodes start.

    owner: what forgets everything.
    """

    def __init__(self, owner: str) -> None:
        self._owner = owner
        self._calls = 0  # in a row

    def notice(self, lost: bool) -> None:
        self._calls = self._calls + 1 if lost else 0
        if self._calls == STATELESS_CALLS:  # once: the count goes on
            text = (
                f"predict was called {STATELESS_CALLS} times in a row without the state of"
                f" {self._owner}, which forgets everything"
            )
            warnings.warn(
                f"{text}: give it back, action, state = policy.predict(observation, state)",
                stacklevel=3,
            )


def memories_of(
    rows: int, state: Sequence[Memory] | None, episode_start: Any
) -> list[Memory | None]:
    """Memories of rows, None of those whose episode begins.

    Args:
        rows: how many.
        state: of all rows from the last call of `predict`, None at the beginning of episodes.
        episode_start: (rows,) bool; None: no row begins.
    """
    memories: list[Memory | None] = [None] * rows if state is None else list(state)
    if episode_start is None:
        return memories
    starts = np.atleast_1d(episode_start)
    return [None if begins else memory for begins, memory in zip(starts, memories, strict=True)]
