"""Policies of one's own as entrants: the environment that they are made with, and the checks of their actions.

They run in the process that plays them. The environment that they get shares nothing with the one in which they are judged.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
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


def own_environment(env: Any, scene: Scene | None = None) -> Any:
    """Environment with the spaces, control period and limits of another, single or vector, that shares nothing with it.

    Its arm is the one that everybody knows, the scene or that of the environment, without what `randomize` draws but noise; its targets are
    the task's usual ones.
    """
    episodes = episodes_of(env)
    options = {name: getattr(episodes.options, name) for name in (*ARM, *INTERFACE, "threshold")}
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


@contextmanager
def named(policy: str) -> Iterator[None]:
    """Adds the name of a policy of one's own to the notes of what it raises. Raises EntrantError where it ends the program."""
    try:
        yield
    except SystemExit as error:
        raise EntrantError(f"policy is {policy!r}, which ends the program") from error
    except Exception as error:
        error.add_note(f"It was raised in the policy {policy}.")
        raise


class OwnPolicy:
    """A policy of one's own, by its name, as an entrant: its errors name it, and its actions are copied and checked."""

    def __init__(self, name: str, policy: Policy, env: Any) -> None:
        """env: that it acts in, of which nothing is kept."""
        episodes = episodes_of(env)
        rows = () if isinstance(env, gym.Env) else (episodes.size,)
        self.name, self._policy, self._shape = name, policy, (*rows, episodes.model.tendon_count)

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> tuple[Any, Any]:
        """Raises EntrantError for what is no action, and what the policy raises."""
        with named(self.name):
            found: Any = self._policy.predict(observation, state, episode_start, deterministic=deterministic)
        if not (isinstance(found, tuple) and len(found) == 2):
            text = f"whose predict should return an action and a state, not {type(found).__name__}"
            raise EntrantError(f"policy is {self.name!r}, {text}")
        try:
            return checked_array("action", found[0], self._shape), found[1]
        except (TypeError, ValueError) as error:
            raise EntrantError(f"policy is {self.name!r}, whose {error}") from error
