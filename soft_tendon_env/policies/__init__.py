"""Policies turn observations into actions, with Stable-Baselines3's `predict`.

They are model-based controllers and trained agents.
"""

from soft_tendon_env.policies.agent import TrainingWarning, load_agent, save_agent
from soft_tendon_env.policies.controller_policy import (
    ControllerPolicy,
    make_policy,
    observation_options,
)
from soft_tendon_env.policies.estimators import ESTIMATORS, EstimatorEntry
from soft_tendon_env.policies.names import PolicyName, load_policy, policy_options
from soft_tendon_env.policies.protocol import Policy

__all__ = [
    "ESTIMATORS",
    "ControllerPolicy",
    "EstimatorEntry",
    "Policy",
    "PolicyName",
    "TrainingWarning",
    "load_agent",
    "load_policy",
]
__all__ += [
    "make_policy",
    "observation_options",
    "policy_options",
    "save_agent",
]
