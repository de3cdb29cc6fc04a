"""The ids."""

from gymnasium.envs.registration import register, registry

MAX_EPISODE_STEPS = 500
"""10 s at the default control period."""

IDS = {task: f"TendonRod-{task}-v0" for task in ("TipPose", "Shape", "Reach")}
"""The ids by their tasks' names."""


def register_environments() -> None:
    """Make the ids known to Gymnasium; again is harmless."""
    for task, id in IDS.items():
        if id not in registry:
            register(
                id,
                entry_point=f"soft_tendon_env.envs.single:{task}Env",
                vector_entry_point=f"soft_tendon_env.envs.vector:{task}VectorEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
            )
