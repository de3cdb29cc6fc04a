"""Registration of the environments with Gymnasium: an id per task, whose classes are imported when one is made.

The version in an id is raised where the same actions bring other returns. An earlier one is the same environment with the defaults it had.
"""

from collections.abc import Mapping
from typing import Any

from gymnasium.envs.registration import register, registry

MAX_EPISODE_STEPS = 500
"""Length of an episode: 10 s at the default control period."""

SHIPPED = ("Reach", "Shape", "TipPose")
"""Names of the tasks that ship, of envs/tasks.py, which is imported when one is made."""

EARLIER: Mapping[str, tuple[dict[str, Any], ...]] = {
    "Reach": ({"action": "tension"},),
    "Shape": ({"action": "tension", "reward": {"backbone": 1.0, "effort": 0.05, "smoothness": 0.05}},),
    "TipPose": ({"action": "tension", "reward": {"position": 1.0, "angle": 0.5, "effort": 0.05, "smoothness": 0.05}},),
}
"""Options that make the versions 0, 1, ... of a task before the present one."""

IDS: dict[str, str] = {}
"""Ids of the present version by the names of their tasks."""


def ids_of(task: str) -> list[str]:
    """Gymnasium's ids of a task, the present one last."""
    return [f"TendonRod-{task}-v{version}" for version in range(len(EARLIER.get(task, ())) + 1)]


def register_environment(task: str, max_episode_steps: int = MAX_EPISODE_STEPS) -> None:
    """Registers the ids of a task with Gymnasium; again is harmless."""
    IDS[task] = ids_of(task)[-1]
    for id, options in zip(ids_of(task), (*EARLIER.get(task, ()), {}), strict=True):
        if id not in registry or registry[id].max_episode_steps != max_episode_steps:
            registry.pop(id, None)
            register(
                id,
                entry_point=f"soft_tendon_env.envs.environments:{task}Env",
                vector_entry_point=f"soft_tendon_env.envs.environments:{task}VectorEnv",
                max_episode_steps=max_episode_steps,
                kwargs=options,
            )


def register_environments() -> None:
    """Registers the ids of the tasks that ship."""
    for task in SHIPPED:
        register_environment(task)
