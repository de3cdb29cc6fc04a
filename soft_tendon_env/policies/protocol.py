"""Policy interface: Stable-Baselines3's `predict`, which controllers and trained agents have."""

import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

STATELESS_CALLS = 10
"""Calls of `predict` in a row without state after which a warning says so: whoever asks for first actions alone hardly makes as many."""


class Policy(Protocol):
    """Stable-Baselines3's interface: what was remembered goes in with the observation, and comes out with the action."""

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """The action for an observation, and what to give back as `state` with the next one."""


class FunctionPolicy:
    """A policy without memory: actions (rows, n_a) as a function of observations (rows, size), or of a dictionary of such."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        parts = observation if isinstance(observation, dict) else {"": observation}
        rows = {key: np.atleast_2d(part) for key, part in parts.items()}
        actions = self._function(rows if parts is observation else rows[""])
        return (actions[0] if np.ndim(next(iter(parts.values()))) == 1 else actions), state


class LostState:
    """Warns, once, where calls of `predict` neither give the state back nor say that an episode starts. owner: what forgets everything."""

    def __init__(self, owner: str) -> None:
        self._owner, self._calls = owner, 0  # in a row

    def notice(self, lost: bool) -> None:
        """A call. Warns with UserWarning after `STATELESS_CALLS` in a row without state."""
        self._calls = self._calls + 1 if lost else 0
        if self._calls == STATELESS_CALLS:  # once: the count goes on
            text = f"predict was called {STATELESS_CALLS} times in a row without the state of {self._owner}, which forgets everything"
            warnings.warn(f"{text}: give it back, action, state = policy.predict(observation, state)", stacklevel=3)
