"""Algorithms that train agents, by name, and the kind of policy network that each of them trains.

To add one of your own, see `register_algorithm`.
"""

from typing import Any, Literal, TypeVar

ALGORITHMS: dict[str, Any] = {
    "PPO": "stable_baselines3",
    "SAC": "stable_baselines3",
    "TQC": "sb3_contrib",
    "CrossQ": "sb3_contrib",
}
"""Algorithms of other packages to train with, by name: the module that has it, or the class that
was registered."""
Kind = Literal["PPO", "SAC", "TQC", "CrossQ", "APG"]
"""Kind of a policy network: the algorithm that is best known for it."""
OF_PACKAGE: dict[str, Kind] = {"APG": "APG", "DAgger": "PPO"}
"""Algorithms of this package (learning.hyperparameters.MODULES), and the kind of network that they
train."""
POLICY_CLASSES: dict[str, Kind] = {
    "stable_baselines3.common.policies.ActorCriticPolicy": "PPO",
    "stable_baselines3.sac.policies.SACPolicy": "SAC",
    "sb3_contrib.tqc.policies.TQCPolicy": "TQC",
    "sb3_contrib.crossq.policies.CrossQPolicy": "CrossQ",
}
"""Kinds of networks by the class of Stable-Baselines3's policies."""
Algorithm = TypeVar("Algorithm", bound=type)


def register_algorithm(algorithm: Algorithm) -> Algorithm:
    """Makes an algorithm available to trainings by its class's name: a class decorator.

    Args:
        algorithm: a subclass of Stable-Baselines3's `BaseAlgorithm`.

    Returns:
        The class itself.
    """
    ALGORITHMS[algorithm.__name__] = algorithm
    return algorithm


def network_kind(algorithm: str) -> Kind:
    """Kind of the policy networks of a known algorithm.

    Args:
        algorithm: name in ALGORITHMS or OF_PACKAGE.

    Returns:
        What `network.new_network` builds networks by.

    Raises:
        ValueError: a registered algorithm has policies of a class that is not in POLICY_CLASSES.
    """
    if algorithm in OF_PACKAGE:
        return OF_PACKAGE[algorithm]
    registered = ALGORITHMS[algorithm]
    if isinstance(registered, str):
        return algorithm  # type: ignore[return-value]  # the names of ALGORITHMS are kinds
    policy = registered.policy_aliases["MlpPolicy"]
    class_name = f"{policy.__module__}.{policy.__qualname__}"
    if class_name not in POLICY_CLASSES:
        classes = ", ".join(name.rpartition(".")[2] for name in POLICY_CLASSES)
        raise ValueError(
            f"policies of {algorithm} are of the class {class_name}, which cannot act here: it"
            f" should be one of {classes}. Give an object with `predict` instead, as module:name"
        )
    return POLICY_CLASSES[class_name]
