"""The environment that users' policies are made with: it shares nothing with the one in which they are judged."""

import warnings
from typing import Any

import gymnasium as gym

from soft_tendon_env.envs import IDS
from soft_tendon_env.envs.episodes import episodes_of
from soft_tendon_env.policies.agent_files import ARM, INTERFACE
from soft_tendon_env.scene.passive_fields import FieldsWarning
from soft_tendon_env.scene.scene import Scene


def policy_environment(env: Any, scene: Scene | None = None) -> Any:
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
