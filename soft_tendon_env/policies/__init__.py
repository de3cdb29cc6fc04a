"""Policies: what turns observations into actions, model-based controllers and learned agents alike, with Stable-Baselines3's `predict`."""

from soft_tendon_env.policies.controller_policy import ControllerPolicy, interface_of, make_policy, observation_options

__all__ = ["ControllerPolicy", "interface_of", "make_policy", "observation_options"]
