"""Policy interface: Stable-Baselines3's `predict`, which controllers, trained agents and their sums all have."""

from collections.abc import Callable
from typing import Any, Protocol


class Policy(Protocol):
    """Stable-Baselines3's interface: what was remembered goes in with the observation, and comes out with the action."""

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """The action for an observation, and what to give back as `state` with the next one."""


class FunctionPolicy:
    """A policy without memory: actions (rows, n_a) as a function of observations (rows, size)."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        return self._function(observation), state
