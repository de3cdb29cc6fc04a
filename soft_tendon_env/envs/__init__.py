"""Gymnasium environments of a tendon-driven soft arm.

They are `TendonRod-TipPose-v0`, `TendonRod-Shape-v0` and `TendonRod-Reach-v0`.
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

TipPoseEnv = environment_class(TIP_POSE)
TipPoseVectorEnv = vector_environment_class(TIP_POSE)
ShapeEnv = environment_class(SHAPE)
ShapeVectorEnv = vector_environment_class(SHAPE)
ReachEnv = environment_class(REACH)
ReachVectorEnv = vector_environment_class(REACH)

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
