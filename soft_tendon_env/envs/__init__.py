"""Gymnasium environments of a tendon-driven soft arm: `TendonRod-TipPose-v0`, `TendonRod-Shape-v0`, `TendonRod-Reach-v0`."""

from soft_tendon_env.envs.divergence import Replay, replay_divergence
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.single import ReachEnv, ShapeEnv, TendonRodEnv, TipPoseEnv
from soft_tendon_env.envs.vector import ReachVectorEnv, ShapeVectorEnv, TendonRodVectorEnv, TipPoseVectorEnv
from soft_tendon_env.tools.registration import IDS

__all__ = [
    "IDS",
    "Options",
    "ReachEnv",
    "ReachVectorEnv",
    "Replay",
    "ShapeEnv",
    "ShapeVectorEnv",
    "TendonRodEnv",
    "TendonRodVectorEnv",
    "TipPoseEnv",
    "TipPoseVectorEnv",
    "replay_divergence",
]
