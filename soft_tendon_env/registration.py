"""Registration of the environments with Gymnasium: an id per task, whose classes are imported when one is made."""

from gymnasium.envs.registration import register, registry

MAX_EPISODE_STEPS = 500
"""Length of an episode: 10 s at the default control period."""

SHIPPED = ("Reach", "Shape", "TipPose")
"""Names of the tasks that ship, of envs/tasks.py, which is imported when one is made."""

IDS: dict[str, str] = {}
"""Ids by the names of their tasks."""


def register_environment(task: str, max_episode_steps: int = MAX_EPISODE_STEPS) -> None:
    """Registers the id of a task with Gymnasium; again is harmless."""
    id = IDS[task] = f"TendonRod-{task}-v0"
    if id not in registry or registry[id].max_episode_steps != max_episode_steps:
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
