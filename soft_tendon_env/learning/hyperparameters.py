"""Hyperparameters of a configuration: arguments of the algorithm and of its policy.

They go by their names.

Their values are left to the algorithm, which refuses what it cannot be made of, but for some that
it would take: RANGES.
"""

import importlib
import inspect
import math
from collections.abc import Mapping
from typing import Any

from soft_tendon_env.policies.algorithms import ALGORITHMS, policy_name
from soft_tendon_env.tools.configuration import Problem, not_among, shown

# names of the package's own algorithms
APG = "APG"
DAGGER = "DAgger"
NOT_IN_FILES = frozenset(
    [
        "self",
        "policy",
        "env",
        "learning_rate",
        "seed",
        "device",
        "verbose",
        "tensorboard_log",
        "settings",
        "_init_setup_model",
        "observation_space",
        "action_space",
        "lr_schedule",
        "normalize_images",
        "rollout_buffer_class",
        "rollout_buffer_kwargs",
        "replay_buffer_class",
        "replay_buffer_kwargs",
        "action_noise",
        "optimize_memory_usage",
        "features_extractor_class",
        "features_extractor_kwargs",
        "optimizer_class",
    ]
)
"""Arguments of algorithms and policies that a training gives, or that are objects, which no file
can say."""
Range = tuple[float, float]
IN_UNIT: Range = (0.0, 1.0)
POSITIVE: Range = (1e-9, math.inf)
NOT_NEGATIVE: Range = (0.0, math.inf)
AT_LEAST_ONE: Range = (1, math.inf)
RANGES: Mapping[str, Range] = {
    "gamma": IN_UNIT,
    "gae_lambda": IN_UNIT,
    "tau": IN_UNIT,
    "lead": IN_UNIT,
    "clip_range": POSITIVE,
    "max_grad_norm": POSITIVE,
    "max_row_gradient": POSITIVE,
    "position_scale": POSITIVE,
    "angle_scale": POSITIVE,
    "settling_time": POSITIVE,
    "vf_coef": NOT_NEGATIVE,
    "far_weight": NOT_NEGATIVE,
    "smoothness": NOT_NEGATIVE,
    "averaged_updates": NOT_NEGATIVE,
    "noise": NOT_NEGATIVE,
    "n_steps": AT_LEAST_ONE,
    "n_epochs": AT_LEAST_ONE,
    "batch_size": AT_LEAST_ONE,
    "rounds": AT_LEAST_ONE,
}
"""Least and greatest of numbers beyond which algorithms would train without a word, to no good."""
UNREAD: Mapping[str, tuple[str, ...]] = {
    "reward": ("position_scale", "angle_scale", "far_weight"),
}
"""Hyperparameters of APG that a cost does not read, by its name: those of the errors alone."""


def training_class(algorithm: str) -> Any:
    """Class of an algorithm of ALGORITHMS to train with.

    Raises ModuleNotFoundError without Stable-Baselines3.
    """
    source = ALGORITHMS[algorithm].source
    if not isinstance(source, str):
        return source
    try:
        module = importlib.import_module(source)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'{algorithm} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"'
        ) from error
    return getattr(module, algorithm)


def unread_names(algorithm: str, given: Mapping[str, Any]) -> tuple[str, ...]:
    """Names of hyperparameters that an algorithm with these does not read, by its `cost`."""
    cost = given.get("cost")
    if algorithm != APG or not isinstance(cost, str):
        return ()
    return UNREAD.get(cost, ())


def hyperparameter_problems(algorithm: str, given: Mapping[str, Any]) -> list[Problem]:
    """Problems with hyperparameters, by key.

    They are no arguments of the algorithm, or of its policy, or out of RANGES, or its cost does not
    read them.
    """
    kind = training_class(algorithm)
    policy = given.get("policy_kwargs", {})
    key = ("hyperparameters", "policy_kwargs")
    if not isinstance(policy, Mapping):
        return [Problem(key, f"is {shown(policy)}: it should be a table")]
    policy_kind = kind.policy_aliases[policy_name(kind, has_goals=False)]
    problems = _unknown_keys(("hyperparameters",), given, kind)
    problems += _unknown_keys(key, policy, policy_kind)
    for name in RANGES.keys() & given.keys():
        value = given[name]
        least, greatest = RANGES[name]
        is_numeric = isinstance(value, int | float)
        is_number = is_numeric and not isinstance(value, bool)
        if is_number and least <= value <= greatest:
            continue
        allowed = f"from {least:g} to {greatest:g}"
        if greatest == math.inf:
            allowed = f"at least {least:g}"
        text = f"is {shown(value)}: it should be a number {allowed}"
        problems.append(Problem(("hyperparameters", name), text))
    problems += _unread(algorithm, given)
    return problems


def _unread(algorithm: str, given: Mapping[str, Any]) -> list[Problem]:
    """Problems with hyperparameters that would change nothing, for the cost does not read them."""
    problems = []
    for name in unread_names(algorithm, given):
        if name not in given:
            continue
        value = shown(given[name])
        cost = shown(given["cost"])
        text = (
            f"is {value}: it should be left out with cost = {cost}, which does not read it;"
            " cost = 'errors' does"
        )
        problems.append(Problem(("hyperparameters", name), text))
    return problems


def _unknown_keys(key: tuple[str, ...], table: Mapping[str, Any], kind: Any) -> list[Problem]:
    """Problems with keys of a table that are no arguments of an algorithm or a policy."""
    valid = _names(kind)
    problems = []
    for name in table.keys() - {*valid}:
        value = shown(table[name])
        hint = not_among(name, valid)
        text = f"is an unknown key (given {value}): {hint}"
        whole_key = (*key, name)
        problems.append(Problem(whole_key, text))
    return problems


def _names(kind: Any) -> list[str]:
    """Names of the arguments of an algorithm or a policy that a file can say.

    Those of an algorithm's settings are among them.
    """
    signature = inspect.signature(kind.__init__)
    arguments = [*signature.parameters.values()]
    settings = getattr(kind, "settings_class", None)
    if settings is not None:
        arguments += inspect.signature(settings).parameters.values()
    names = []
    for argument in arguments:
        is_named = argument.kind is not argument.VAR_KEYWORD
        if is_named and argument.name not in NOT_IN_FILES:
            names.append(argument.name)
    return names
