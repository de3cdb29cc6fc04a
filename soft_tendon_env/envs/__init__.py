"""Gymnasium environments of a tendon-driven soft arm: `TendonRod-TipPose-v0`, `TendonRod-Shape-v0`, `TendonRod-Reach-v0`."""

from soft_tendon_env.envs.divergence import Replay, replay_divergence
from soft_tendon_env.envs.evaluation import MODEL_ERRORS, evaluate, evaluate_rows
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.policy import ControllerPolicy, interface_of, make_policy, observation_options
from soft_tendon_env.envs.scores import EpisodeScore, Summary, summarise
from soft_tendon_env.envs.single import ReachEnv, ShapeEnv, TendonRodEnv, TipPoseEnv
from soft_tendon_env.envs.vector import ReachVectorEnv, ShapeVectorEnv, TendonRodVectorEnv, TipPoseVectorEnv
from soft_tendon_env.registration import IDS

EVALUATION_SEEDS = tuple(range(1_000_000, 1_000_020))
"""Seeds of `reset` for evaluation: the fixed list of targets on which agents and controllers are compared."""

__all__ = [
    "EVALUATION_SEEDS",
    "IDS",
    "MODEL_ERRORS",
    "ControllerPolicy",
    "EpisodeScore",
    "Options",
    "ReachEnv",
    "ReachVectorEnv",
    "Replay",
    "ShapeEnv",
    "ShapeVectorEnv",
    "Summary",
    "TendonRodEnv",
    "TendonRodVectorEnv",
    "TipPoseEnv",
    "TipPoseVectorEnv",
    "evaluate",
    "evaluate_rows",
    "interface_of",
    "make_policy",
    "observation_options",
    "replay_divergence",
    "summarise",
]
