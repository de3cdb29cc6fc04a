"""Gradients of rollouts in PyTorch, for policies and commands.

They learn by the derivative of the simulation itself. Needs the extra `gradients`.
"""

try:
    import torch  # noqa: F401
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        'gradients need PyTorch: pip install "soft_tendon_env[gradients]"'
    ) from error

from soft_tendon_env.differentiable.accuracy import (
    GradientAccuracy,
    GradientWarning,
    gradient_accuracy,
)
from soft_tendon_env.differentiable.actuation import inward_clip
from soft_tendon_env.differentiable.period import ArmTensors, arm_tensors, control_period
from soft_tendon_env.differentiable.poses import pose_logarithm
from soft_tendon_env.differentiable.rewards import TensorReward
from soft_tendon_env.differentiable.rollout import Trajectories, rollout

__all__ = [
    "ArmTensors",
    "GradientAccuracy",
    "GradientWarning",
    "TensorReward",
    "Trajectories",
    "arm_tensors",
    "control_period",
    "gradient_accuracy",
    "inward_clip",
    "pose_logarithm",
    "rollout",
]
