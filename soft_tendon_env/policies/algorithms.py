"""Algorithms that train agents, by name, and the kind of policy network that each of them trains.

One is a class of Stable-Baselines3 under `@register("algorithm", "name")`, in a user's own file as
`examples/own_algorithm.py`; what other packages have is registered by a call.
"""

from typing import Any, Literal, NamedTuple

from soft_tendon_env.tools.configuration import not_registered, shown
from soft_tendon_env.tools.registry import Registry, register

Kind = Literal["PPO", "SAC", "TQC", "CrossQ", "APG", "RecurrentPPO"]
"""Kind of a policy network: the algorithm that is best known for it."""
POLICY_CLASSES: dict[str, Kind] = {
    "stable_baselines3.common.policies.ActorCriticPolicy": "PPO",
    "stable_baselines3.sac.policies.SACPolicy": "SAC",
    "sb3_contrib.tqc.policies.TQCPolicy": "TQC",
    "sb3_contrib.crossq.policies.CrossQPolicy": "CrossQ",
    "sb3_contrib.common.recurrent.policies.RecurrentActorCriticPolicy": "RecurrentPPO",
}
"""Kinds of networks by the class of Stable-Baselines3's policies."""
PLAIN_POLICIES = ("MlpPolicy", "MlpLstmPolicy")
"""Names that algorithms give their policies of flat observations, the one without memory first."""
GOAL_POLICIES = ("MultiInputPolicy", "MultiInputLstmPolicy")
"""Names of policies of goal-conditioned observations, in the same order."""


class Algorithm(NamedTuple):
    """Algorithm to train with."""

    source: Any  # its class, or the name of the module that has a class of the algorithm's name
    network: Kind  # of the policy networks that it trains


def _checked_algorithm(name: str, algorithm: Any, *, network: Kind | None = None) -> Algorithm:
    """Entry of an algorithm.

    Args:
        name: of the algorithm.
        algorithm: a subclass of Stable-Baselines3's `BaseAlgorithm`, or the name of its module.
        network: kind of its policy networks, which a name of a module needs.

    Returns:
        The entry.

    Raises:
        TypeError: it is no algorithm.
        ValueError: its policies are of a class that cannot act by NumPy.
    """
    if isinstance(algorithm, str) and network is not None:
        return Algorithm(algorithm, network)
    lacking = [key for key in ("policy_aliases", "learn") if not hasattr(algorithm, key)]
    if not isinstance(algorithm, type) or lacking:
        raise TypeError(
            f"the algorithm {name!r} should be a subclass of Stable-Baselines3's BaseAlgorithm, not"
            f" {shown(algorithm)}"
        )
    learner: Any = algorithm
    policy = learner.policy_aliases[policy_name(learner, has_goals=False)]
    class_name = f"{policy.__module__}.{policy.__qualname__}"
    if class_name not in POLICY_CLASSES:
        classes = ", ".join(known.rpartition(".")[2] for known in POLICY_CLASSES)
        raise ValueError(
            f"policies of {name} are of the class {class_name}, which cannot act here: it should be"
            f" one of {classes}. Give an object with `predict` instead, as module:name"
        )
    return Algorithm(algorithm, POLICY_CLASSES[class_name])


ALGORITHMS: Registry[Algorithm] = Registry("algorithm", _checked_algorithm)
"""Algorithms to train with, by name."""

register("algorithm", "PPO", "stable_baselines3", network="PPO")
register("algorithm", "SAC", "stable_baselines3", network="SAC")
register("algorithm", "TQC", "sb3_contrib", network="TQC")
register("algorithm", "CrossQ", "sb3_contrib", network="CrossQ")
register("algorithm", "APG", "soft_tendon_env.learning.analytic_policy_gradient", network="APG")
register("algorithm", "DAgger", "soft_tendon_env.learning.imitation", network="PPO")


def policy_name(algorithm: Any, has_goals: bool) -> str:
    """Name by which an algorithm's class has its policy of plain arrays, or of those with goals.

    Args:
        algorithm: class of Stable-Baselines3.
        has_goals: whether observations are those of goal-conditioned tasks.

    Returns:
        A key of its `policy_aliases`.

    Raises:
        ValueError: it has no such policy.
    """
    names = GOAL_POLICIES if has_goals else PLAIN_POLICIES
    for name in names:
        if name in algorithm.policy_aliases:
            return name
    raise ValueError(
        f"{algorithm.__name__} has the policies {', '.join(algorithm.policy_aliases)}: one of"
        f" {', '.join(names)} is needed"
    )


def network_kind(algorithm: str) -> Kind:
    """Kind of the policy networks of a registered algorithm.

    Args:
        algorithm: name in ALGORITHMS.

    Returns:
        What `network.new_network` builds networks by.

    Raises:
        ValueError: the algorithm is not registered.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm is {algorithm!r}: {not_registered(algorithm, ALGORITHMS)}")
    return ALGORITHMS[algorithm].network
