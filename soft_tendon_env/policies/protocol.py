"""Policy interface: Stable-Baselines3's `predict`, which controllers, trained agents and their sums all have."""

from typing import Any, Protocol


class Policy(Protocol):
    """Stable-Baselines3's interface: what was remembered goes in with the observation, and comes out with the action."""

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """The action for an observation, and what to give back as `state` with the next one."""
