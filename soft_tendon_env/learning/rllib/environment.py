"""The arms of one of RLlib's runners: rows of the vector environment, with seeds that no other runner has."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv, VectorWrapper

from soft_tendon_env.envs import IDS


class RunnerEnv(VectorWrapper):
    """The environment of a runner. Infos stay within: RLlib would make a dictionary per row of them at every step, and uses none.

    Args:
        env: its rows.
        seed: of the first of them.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], seed: int) -> None:
        super().__init__(env)
        self._first_seed = seed

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """New episodes. RLlib's seeds are one apart from runner to runner: most arms would be there twice, so that any becomes ours."""
        return self.env.reset(seed=None if seed is None else self._first_seed, options=options)[0], {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        return *self.env.step(actions)[:4], {}


def make_runner_env(context: Mapping[str, Any]) -> RunnerEnv:
    """The environment of a runner, of what `rllib_settings` says of it, `num_envs` of its rows and RLlib's `worker_index`."""
    rows, index = context.get("num_envs", 1), max(getattr(context, "worker_index", 0) - 1, 0)
    size: dict[str, Any] = {"num_envs": rows, "max_episode_steps": context["episode_steps"], "threads": context["threads"]}
    env = gym.make_vec(IDS[context["task"]], vectorization_mode="vector_entry_point", **size, **context["options"])
    return RunnerEnv(env, context["seed"] + rows * index)
