"""Gymnasium environments of a tendon-driven soft arm.

They are `TendonRod-TipPose-v0`, `TendonRod-Shape-v0` and `TendonRod-Reach-v0`.
Every registered task has the classes `<name>Env` and `<name>VectorEnv` in environments.py.
"""

from soft_tendon_env.envs.environments import (
    ReachEnv,
    ReachVectorEnv,
    ShapeEnv,
    ShapeVectorEnv,
    TendonRodEnv,
    TendonRodVectorEnv,
    TipPoseEnv,
    TipPoseVectorEnv,
)
from soft_tendon_env.envs.options import Options, ResetOptions
from soft_tendon_env.envs.targets import TARGETS, Target
from soft_tendon_env.envs.tasks import TASKS, Task
from soft_tendon_env.registration import IDS

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
]
