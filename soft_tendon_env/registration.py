"""Registration of the environments with Gymnasium: one id per task.

The classes of a task are imported when an environment is made.
"""

from gymnasium.envs.registration import register, registry

MAX_EPISODE_STEPS = 500
"""Length of an episode: 10 s at the default control period."""

SHIPPED = ("Reach", "Shape", "TipPose")
"""Names of the tasks that ship, of envs/tasks.py, which is imported when one is made."""

IDS: dict[str, str] = {}
"""Gymnasium's ids by the names of their tasks."""


def id_of(task: str) -> str:
    """Gymnasium's id of a task."""
    return f"TendonRod-{task}-v0"


def register_environment(task: str, max_episode_steps: int = MAX_EPISODE_STEPS) -> None:
    """Registers the id of a task with Gymnasium; again is harmless."""
    id = id_of(task)
    IDS[task] = id
    if id in registry and registry[id].max_episode_steps == max_episode_steps:
        return
    registry.pop(id, None)
    register(
        id,
        entry_point=f"soft_tendon_env.envs.environments:{task}Env",
        vector_entry_point=f"soft_tendon_env.envs.environments:{task}VectorEnv",
        max_episode_steps=max_episode_steps,
    )


def register_environments() -> None:
    """Registers the ids of the tasks that ship."""
    for task in SHIPPED:
        register_environment(task)
