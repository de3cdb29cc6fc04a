"""Policies of one's own as entrants: the environment that they are made with, and the checks of their actions.

They run in the process that plays them. The environment that they get shares nothing with the one in which they are judged.
"""

import warnings
from typing import Any

import gymnasium as gym

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_files import ARM, INTERFACE
from soft_tendon_env.policies.protocol import Policy
from soft_tendon_env.scene.passive_fields import FieldsWarning
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.messages import UserError

MAY_SET = (*INTERFACE, "contact_sections")
"""Options that a policy may set: what it observes, and how its actions are read."""


def own_environment(env: Any, scene: Scene | None = None) -> Any:
    """Environment with the spaces, control period and limits of another, single or vector, that shares nothing with it.

    Its arm is the one that everybody knows, the scene or that of the environment, without what `randomize` draws but noise; its targets are
    the task's usual ones.
    """
    episodes = episodes_of(env)
    options = {name: getattr(episodes.options, name) for name in (*ARM, *MAY_SET, "threshold")}
    options["randomize"] = {"noise": episodes.options.randomize.noise}
    if scene is not None:
        options |= {"scene": scene, "fidelity": "scene"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FieldsWarning)  # said of the other environment already
        if isinstance(env, gym.Env):
            return gym.make(IDS[episodes.task.name], **options)
        return gym.make_vec(IDS[episodes.task.name], num_envs=episodes.size, threads=1, **options)


class EntrantError(UserError, ValueError):
    """A policy of one's own did what an entrant should not."""

    def __str__(self) -> str:
        return "policy is {!r}, {}".format(*self.args)


class OwnPolicy:
    """A policy of one's own, by its name, as an entrant: its errors name it, and its actions are copied and checked."""

    def __init__(self, name: str, policy: Policy, env: Any) -> None:
        """env: that it acts in, of which nothing is kept."""
        episodes = episodes_of(env)
        self._shape = (episodes.model.tendon_count,) if isinstance(env, gym.Env) else (episodes.size, episodes.model.tendon_count)
        self.name, self._policy = name, policy

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """Raises EntrantError for what is no action, and what the policy raises."""
        try:
            found = self._policy.predict(observation, state, episode_start, deterministic=deterministic)
        except Exception as error:
            error.add_note(f"It was raised in the policy {self.name}.")
            raise
        if not (isinstance(found, tuple) and len(found) == 2):
            raise EntrantError(self.name, f"whose predict should return an action and a state, not {type(found).__name__}")
        try:
            return checked_array("action", found[0], self._shape), found[1]
        except (TypeError, ValueError) as error:
            raise EntrantError(self.name, f"whose {error}") from error
