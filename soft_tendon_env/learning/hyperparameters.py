"""Hyperparameters that a configuration can say: arguments of the algorithm and of its policy, by their names.

Their values are left to the algorithm, which refuses what it cannot be made of.
"""

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from soft_tendon_env.policies.network import algorithm_class, registered_algorithms
from soft_tendon_env.tools.configuration import Key, Problem, not_among, shown

TRAINED = ("PPO", "SAC", "TQC", "CrossQ")
"""Algorithms of Stable-Baselines3 and sb3-contrib to train with."""
APG, DAGGER = "APG", "DAgger"
MODULES: Mapping[str, str] = {APG: "soft_tendon_env.learning.analytic_policy_gradient", DAGGER: "soft_tendon_env.learning.imitation"}
"""Modules of the package's own algorithms, each a class with the interface of Stable-Baselines3's `BaseAlgorithm`, by its name."""
BY_TRAINING = ("self", "policy", "env", "learning_rate", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model")
BY_ALGORITHM = ("self", "observation_space", "action_space", "lr_schedule", "use_sde", "normalize_images")
"""Arguments that a training gives to algorithms, and these to their policies."""
BUFFERS = ("rollout_buffer_class", "rollout_buffer_kwargs", "replay_buffer_class", "replay_buffer_kwargs", "optimize_memory_usage")
OBJECTS = (*BUFFERS, "action_noise", "cost", "features_extractor_class", "features_extractor_kwargs", "optimizer_class")
"""Arguments that are objects, which no file can say."""


def trained_algorithms() -> tuple[str, ...]:
    """Names of the algorithms to train with: those of Stable-Baselines3, the package's own, and those that were registered."""
    return (*TRAINED, *MODULES, *registered_algorithms())


def training_class(algorithm: str) -> Any:
    """Class of an algorithm to train with, see `trained_algorithms`. Raises ModuleNotFoundError without Stable-Baselines3."""
    return getattr(importlib.import_module(MODULES[algorithm]), algorithm) if algorithm in MODULES else algorithm_class(algorithm)


def learns_from_replay(algorithm: str) -> bool:
    """Whether an algorithm is off-policy: it learns from a buffer of past transitions."""
    return "buffer_size" in inspect.signature(training_class(algorithm).__init__).parameters


def unknown_hyperparameters(algorithm: str, given: Mapping[str, Any]) -> list[Problem]:
    """Problems with hyperparameters that are no arguments of the algorithm, or of its policy."""
    kind, policy = training_class(algorithm), given.get("policy_kwargs", {})
    if not isinstance(policy, Mapping):
        return [Problem(("hyperparameters", "policy_kwargs"), f"is {shown(policy)}: it should be a table")]
    found = _unknown(given, kind, BY_TRAINING, ("hyperparameters",))
    return found + _unknown(policy, kind.policy_aliases["MlpPolicy"], BY_ALGORITHM, ("hyperparameters", "policy_kwargs"))


def _unknown(given: Mapping[str, Any], kind: Any, by_others: tuple[str, ...], key: Key) -> list[Problem]:
    arguments = inspect.signature(kind.__init__).parameters.values()
    names = [argument.name for argument in arguments if argument.kind is not argument.VAR_KEYWORD]
    valid = [name for name in names if name not in by_others and name not in OBJECTS]
    unknown = {name: value for name, value in given.items() if name not in valid}
    return [Problem((*key, name), f"is an unknown key (given {shown(value)}): {not_among(name, valid)}") for name, value in unknown.items()]
