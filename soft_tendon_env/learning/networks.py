"""Policy networks in PyTorch that have learned nothing, of plain arguments."""

import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import torch

from soft_tendon_env.learning.hyperparameters import training_class
from soft_tendon_env.policies.activations import activation_name
from soft_tendon_env.policies.algorithms import policy_name

OPTIMISER = ("optimizer_class", "optimizer_kwargs")  # arguments of policies that learn elsewhere


def policy_arguments(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a policy out of plain ones.

    Args:
        arguments: as in a configuration's `policy_kwargs`.

    Returns:
        The same, `activation_fn` as the class of that name in torch.nn.

    Raises:
        ValueError: agents cannot act by that activation function.
    """
    made = dict(arguments)
    if "activation_fn" in made:
        name = activation_name(made["activation_fn"])
        made["activation_fn"] = getattr(torch.nn, name)
    return made


def new_network(
    algorithm: str,
    arguments: Mapping[str, Any],
    observations: gym.Space[Any],
    actions: gym.Space[Any],
) -> Any:
    """Policy network of an algorithm in PyTorch that has learned nothing.

    Args:
        algorithm: its name, see `hyperparameters.training_class`.
        arguments: plain ones, see `policy_arguments`.
        observations: space of what it observes.
        actions: space of its actions.

    Returns:
        Policy of Stable-Baselines3.

    Raises:
        ValueError: an argument is unknown, or has a value that cannot be.
        ModuleNotFoundError: Stable-Baselines3 is not installed.
    """
    is_dict = isinstance(observations, gym.spaces.Dict)
    kind = training_class(algorithm)
    policy = kind.policy_aliases[policy_name(kind, is_dict)]
    made = policy_arguments(arguments)
    for name in OPTIMISER:
        made.pop(name, None)
    known = inspect.signature(policy.__init__).parameters
    unknown = made.keys() - known.keys()
    if unknown:
        unknown_names = ", ".join(sorted(unknown))
        raise ValueError(f"policies of {algorithm} have no argument {unknown_names}")
    return policy(observations, actions, lr_schedule=lambda _: 0.0, **made)
