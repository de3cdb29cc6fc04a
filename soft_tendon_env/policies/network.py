"""Policy networks of Stable-Baselines3, from files of weights without unpickling."""

import importlib
import inspect
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym

from soft_tendon_env.tools.messages import first_line

WEIGHTS = "weights.pt"
ALGORITHMS: dict[str, Any] = {
    "PPO": "stable_baselines3",
    "SAC": "stable_baselines3",
    "TQC": "sb3_contrib",
    "CrossQ": "sb3_contrib",
}
"""Algorithms of other packages to train with, by name: the module that has it, or the class that
was registered."""
OF_PACKAGE = {"APG": "PPO", "DAgger": "PPO"}
"""Algorithms of this package (learning.hyperparameters.MODULES), and the one of Stable-Baselines3
whose policy networks they train."""
RECURRENT = ("APG",)  # algorithms whose policies are those of recurrent.py
OF_TRAINING = ("optimizer_class", "optimizer_kwargs")  # arguments of policies that no longer matter
Algorithm = TypeVar("Algorithm", bound=type)


def register_algorithm(algorithm: Algorithm) -> Algorithm:
    """Class decorator: train with an algorithm of your own, a subclass of Stable-Baselines3's
    `BaseAlgorithm`, by its class's name."""
    ALGORITHMS[algorithm.__name__] = algorithm
    return algorithm


def algorithm_class(algorithm: str) -> Any:
    """Class of an algorithm: registered, or in Stable-Baselines3. Raises ModuleNotFoundError."""
    found = ALGORITHMS[algorithm]
    try:
        return (
            getattr(importlib.import_module(found), algorithm) if isinstance(found, str) else found
        )
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'{algorithm} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"'
        ) from error


def new_network(
    algorithm: str,
    arguments: Mapping[str, Any],
    observations: gym.Space[Any],
    actions: gym.Space[Any],
) -> Any:
    """A policy network that has learned nothing. arguments: of the policy, see `policy_arguments`.
    Raises ValueError for others."""
    if algorithm in RECURRENT:
        kind = importlib.import_module("soft_tendon_env.policies.recurrent").RecurrentPolicy
    else:
        aliases = algorithm_class(OF_PACKAGE.get(algorithm, algorithm)).policy_aliases
        kind = aliases[
            "MultiInputPolicy" if isinstance(observations, gym.spaces.Dict) else "MlpPolicy"
        ]
    given = policy_arguments(
        {key: value for key, value in arguments.items() if key not in OF_TRAINING}
    )
    known = inspect.signature(kind.__init__).parameters
    if unknown := given.keys() - known.keys():
        raise ValueError(f"policies of {algorithm} have no argument {', '.join(sorted(unknown))}")
    return kind(
        observations,
        actions,
        **({"lr_schedule": lambda _: 0.0} if "lr_schedule" in known else {}),
        **given,
    )


def policy_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a policy of plain ones: `activation_fn` is the class of that name in torch.nn.
    Raises ValueError."""
    import torch

    found = dict(given)
    if "activation_fn" in found:
        kind = getattr(torch.nn, str(found["activation_fn"]), None)
        if not (isinstance(kind, type) and issubclass(kind, torch.nn.Module)):
            raise ValueError(
                f"activation_fn is {found['activation_fn']!r}: it should be the name of an"
                " activation function in torch.nn"
            )
        found["activation_fn"] = kind
    return found


def read_weights(path: Path) -> dict[str, Any]:
    """Tensors by name, with PyTorch's loader that builds nothing else. Raises ValueError."""
    import torch

    try:
        weights = torch.load(io.BytesIO(path.read_bytes()), map_location="cpu", weights_only=True)
        finite = all(bool(torch.isfinite(tensor).all()) for tensor in weights.values())
    except Exception as error:  # whatever it meets in a damaged file
        raise ValueError(
            f"{path} holds no weights alone, or was cut or damaged: {first_line(error)}"
        ) from error
    if not finite:
        raise ValueError(f"{path} has weights that are not finite")
    return dict(weights)
