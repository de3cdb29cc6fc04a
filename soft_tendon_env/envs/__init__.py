"""Gymnasium environments of a tendon-driven soft arm: `TendonRod-TipPose-v0`, `TendonRod-Shape-v0`,
`TendonRod-Reach-v0`.

Every registered task has the classes `<name>Env` and `<name>VectorEnv` in environments.py.
"""

from soft_tendon_env.envs.environments import (
    TendonRodEnv,
    TendonRodVectorEnv,
    environment_class,
    vector_environment_class,
)
from soft_tendon_env.envs.options import Options, ResetOptions
from soft_tendon_env.envs.targets import TARGETS, Target, register_target
from soft_tendon_env.envs.tasks import REACH, SHAPE, TASKS, TIP_POSE, Task, register_task
from soft_tendon_env.envs.tracking import register_reward_term
from soft_tendon_env.registration import IDS

TipPoseEnv, TipPoseVectorEnv = environment_class(TIP_POSE), vector_environment_class(TIP_POSE)
ShapeEnv, ShapeVectorEnv = environment_class(SHAPE), vector_environment_class(SHAPE)
ReachEnv, ReachVectorEnv = environment_class(REACH), vector_environment_class(REACH)

__all__ = [
    "IDS",
    "TARGETS",
    "TASKS",
    "Options",
    "ReachEnv",
    "ReachVectorEnv",
    "ResetOptions",
    "ShapeEnv",
    "ShapeVectorEnv",
    "Target",
    "Task",
    "TendonRodEnv",
    "TendonRodVectorEnv",
    "TipPoseEnv",
    "TipPoseVectorEnv",
    "environment_class",
    "register_reward_term",
    "register_target",
    "register_task",
    "vector_environment_class",
]
