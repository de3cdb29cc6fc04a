"""Residual reinforcement learning: an agent whose actions are added to those of a model-based controller, which it sees.

The sum is what acts: action = controller's + share x agent's, within [-1, 1]; the controller is told the tensions that it asks for.
"""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from soft_tendon_env.policies.controller_policy import RowMemory, interface_of, make_policy
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.tools.configuration import Configuration


class ResidualSettings(Configuration):
    """controller: its name in the catalogue; share: of the range of actions that the agent can add at most."""

    controller: str
    share: float = Field(default=0.1, gt=0.0, le=2.0)


class Seen(NamedTuple):
    """Observation of the agent, and the controller's part of the action."""

    observation: Any
    action: NDArray[np.float32]  # (rows, n_a) or (n_a,)
    memory: tuple[RowMemory, ...]


class Residual:
    """The controller of an environment, for agents that add to its actions.

    Raises ValueError, TypeError as `make_policy` does, and where actions are increments, of which the controller would take back what was
    added, or displacements.
    """

    def __init__(self, settings: ResidualSettings, env: Any) -> None:
        interface = interface_of(env)
        self._share, self._actions = settings.share, interface.actions
        if self._actions.increment is not None:
            raise ValueError("residual needs the option action = 'tension': with increments the controller takes back what was added")
        if not interface.model.scene.effects.command_tension:
            raise ValueError("residual needs a scene whose commands are tensions, not displacements as with tendon_elasticity")
        self._controller = make_policy(settings.controller, env)

    def observation_space(self, space: gym.Space[Any]) -> gym.Space[Any]:
        """Space of observations with the controller's action at their end."""
        if isinstance(space, gym.spaces.Dict):
            return gym.spaces.Dict({**space.spaces, "observation": self.observation_space(space["observation"])})
        assert isinstance(space, gym.spaces.Box), "observations of this package are Box or Dict"
        more = np.ones(self._actions.least.size, dtype=np.float32)
        return gym.spaces.Box(np.concatenate([space.low, -more]), np.concatenate([space.high, more]), dtype=np.float32)

    def see(self, observation: Any, memory: tuple[RowMemory, ...] | None, episode_start: NDArray[np.bool_] | None) -> Seen:
        """Ask the controller."""
        action, memory = self._controller.predict(observation, memory, episode_start)
        return Seen(_with_action(observation, action), action, memory)

    def act(self, seen: Seen, action: NDArray[Any]) -> tuple[NDArray[np.float32], tuple[RowMemory, ...]]:
        """The sum of both actions, and the memory with the tensions that it asks for."""
        total = np.clip(seen.action + np.float32(self._share) * action, -1.0, 1.0).astype(np.float32)
        tensions = self._actions.command(np.atleast_2d(total).astype(np.float64), self._actions.least)
        asked = zip(seen.memory, tensions, strict=True)
        return total, tuple(memory.instead(tension) for memory, tension in asked)


def _with_action(observation: Any, action: NDArray[np.float32]) -> Any:
    if isinstance(observation, dict):
        return {**observation, "observation": _with_action(observation["observation"], action)}
    return np.concatenate([observation, action], axis=-1)


class ResidualPolicy:
    """The controller and the agent as one policy."""

    def __init__(self, residual: Residual, agent: Policy) -> None:
        self._residual, self._agent = residual, agent

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True) -> tuple[Any, Any]:
        memory, inner = (None, None) if state is None else state
        seen = self._residual.see(observation, memory, episode_start)
        action, inner = self._agent.predict(seen.observation, inner, episode_start, deterministic)
        total, memory = self._residual.act(seen, action)
        return total, (memory, inner)
