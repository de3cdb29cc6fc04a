"""Residual reinforcement learning: an agent whose actions are added to those of another policy, which it sees.

The sum is what acts: action = the other's + share x the agent's, within [-1, 1]. The other policy is any that has a name: a controller,
with a state estimator or without, or a trained agent. A controller or a state estimator is told the tensions that the sum asks for.
"""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_files import ResidualSettings
from soft_tendon_env.policies.controller_policy import ControllerPolicy
from soft_tendon_env.policies.estimated_agent import EstimatingAgent
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.scene import Scene


class Seen(NamedTuple):
    """Observation of the agent, and the other policy's part of the action."""

    observation: Any
    action: NDArray[np.float32]  # (rows, n_a) or (n_a,)
    memory: Any


class Residual:
    """The policy of an environment to whose actions agents add.

    Args:
        env: that it acts in, with all that it observes, see `policy_options`.
        scene: of the arm that a controller or a state estimator believes in, less the effects that `settings` leave out, at another
            fidelity where the policy's name says one; by default the environment's.

    An agent may be added to on an arm with other effects than it was trained with. Raises ValueError, OSError, ModuleNotFoundError as
    `load_policy` does, for effects that the arm has not, and for a controller where actions are increments, of which it takes back what
    was added, or displacements.
    """

    def __init__(self, settings: ResidualSettings, env: Any, scene: Scene | None = None) -> None:
        episodes = episodes_of(env)
        self._share, self._size = settings.share, episodes.actions.least.size
        believed = episodes.model.scene if scene is None else scene
        there = believed.effects.chosen()
        if lacking := [name for name in settings.without if name not in there]:
            raise ValueError(f"residual.without has {lacking[0]!r}, which the arm has not: {', '.join(there) or 'it has no effects'}")
        believed = believed.replace({f"effects.{name}": None for name in settings.without})
        self._policy: Policy = settings.named(episodes.task.name).load(env, believed, other_effects=True)
        if isinstance(self._policy, ControllerPolicy):
            if episodes.actions.increment is not None:
                text = "with increments the controller takes back what was added"
                raise ValueError(f"residual on {settings.policy} needs the option action = 'tension': {text}")
            if not episodes.model.scene.effects.command_tension:
                text = "needs a scene whose commands are tensions, not displacements as with tendon_elasticity"
                raise ValueError(f"residual on {settings.policy} {text}")

    def observation_space(self, space: gym.Space[Any]) -> gym.Space[Any]:
        """Space of observations with the other policy's action at their end."""
        if isinstance(space, gym.spaces.Dict):
            return gym.spaces.Dict({**space.spaces, "observation": self.observation_space(space["observation"])})
        assert isinstance(space, gym.spaces.Box), "observations of this package are Box or Dict"
        more = np.ones(self._size, dtype=np.float32)
        return gym.spaces.Box(np.concatenate([space.low, -more]), np.concatenate([space.high, more]), dtype=np.float32)

    def see(self, observation: Any, memory: Any, episode_start: NDArray[np.bool_] | None) -> Seen:
        """Ask the other policy."""
        action, memory = self._policy.predict(observation, memory, episode_start)
        return Seen(_with_action(observation, action), action, memory)

    def act(self, seen: Seen, action: NDArray[Any]) -> tuple[NDArray[np.float32], Any]:
        """The sum of both actions, and the memory of what it asks for."""
        total = np.clip(seen.action + np.float32(self._share) * action, -1.0, 1.0).astype(np.float32)
        memory = self._policy.instead(seen.memory, total) if isinstance(self._policy, ControllerPolicy | EstimatingAgent) else seen.memory
        return total, memory


def row_of(memory: Any, row: int) -> Any:
    """A row's part of the memory of a policy: arrays and tuples have rows, named tuples have parts."""
    if hasattr(memory, "_fields"):
        return type(memory)(*(row_of(part, row) for part in memory))
    return None if memory is None else memory[row : row + 1]


def _with_action(observation: Any, action: NDArray[np.float32]) -> Any:
    if isinstance(observation, dict):
        return {**observation, "observation": _with_action(observation["observation"], action)}
    return np.concatenate([observation, action], axis=-1)


class ResidualMemory(NamedTuple):
    """State of a ResidualPolicy from one call of `predict` to the next."""

    policy: Any
    agent: Any


class ResidualPolicy:
    """The other policy and the agent as one policy."""

    def __init__(self, residual: Residual, agent: Policy) -> None:
        self._residual, self._agent = residual, agent

    def predict(
        self, observation: Any, state: ResidualMemory | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, ResidualMemory]:
        """The sum of both actions, and the state to give back; see ControllerPolicy.predict."""
        memory, inner = (None, None) if state is None else state
        seen = self._residual.see(observation, memory, episode_start)
        action, inner = self._agent.predict(seen.observation, inner, episode_start, deterministic)
        total, memory = self._residual.act(seen, action)
        return total, ResidualMemory(memory, inner)
