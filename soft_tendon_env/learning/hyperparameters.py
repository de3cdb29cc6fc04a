"""Hyperparameters that a configuration can say: arguments of the algorithm and of its policy, by
their names.

Their values are left to the algorithm, which refuses what it cannot be made of, but for some that
it would take: RANGES.
"""

import importlib
import inspect
import math
from collections.abc import Mapping
from typing import Any

from soft_tendon_env.policies.algorithms import ALGORITHMS
from soft_tendon_env.tools.configuration import Problem, not_among, shown

APG, DAGGER = "APG", "DAgger"
MODULES: Mapping[str, str] = {
    APG: "soft_tendon_env.learning.analytic_policy_gradient",
    DAGGER: "soft_tendon_env.learning.imitation",
}
"""Modules of the package's own algorithms by their names, each a `BaseAlgorithm` with its settings
as `settings_class`."""
NOT_IN_FILES = frozenset(
    "self policy env learning_rate seed device verbose tensorboard_log settings _init_setup_model"
    " observation_space action_space lr_schedule normalize_images rollout_buffer_class"
    " rollout_buffer_kwargs replay_buffer_class replay_buffer_kwargs action_noise cost"
    " optimize_memory_usage features_extractor_class features_extractor_kwargs"
    " optimizer_class".split()
)
"""Arguments of algorithms and policies that a training gives, or that are objects, which no file
can say."""
RANGES: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("gamma", "gae_lambda", "tau", "lead"), (0.0, 1.0)),
    **dict.fromkeys(
        (
            "clip_range",
            "max_grad_norm",
            "max_row_gradient",
            "position_scale",
            "angle_scale",
            "settling_time",
        ),
        (1e-9, math.inf),
    ),
    **dict.fromkeys(("vf_coef", "far_weight", "smoothness", "noise"), (0.0, math.inf)),
    **dict.fromkeys(("n_steps", "n_epochs", "batch_size", "rounds"), (1, math.inf)),
}
"""Least and greatest of numbers beyond which algorithms would train without a word, to no good."""


def training_class(algorithm: str) -> Any:
    """Class of an algorithm of ALGORITHMS or MODULES to train with. Raises ModuleNotFoundError
    without Stable-Baselines3."""
    if algorithm in MODULES:
        return getattr(importlib.import_module(MODULES[algorithm]), algorithm)
    registered = ALGORITHMS[algorithm]
    if not isinstance(registered, str):
        return registered
    try:
        module = importlib.import_module(registered)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'{algorithm} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"'
        ) from error
    return getattr(module, algorithm)


def hyperparameter_problems(algorithm: str, given: Mapping[str, Any]) -> list[Problem]:
    """Problems with hyperparameters that are no arguments of the algorithm, or of its policy, or
    out of RANGES."""
    kind, policy, found = training_class(algorithm), given.get("policy_kwargs", {}), list[Problem]()
    if not isinstance(policy, Mapping):
        return [
            Problem(
                ("hyperparameters", "policy_kwargs"), f"is {shown(policy)}: it should be a table"
            )
        ]
    for key, table, of in (
        ((), given, kind),
        (("policy_kwargs",), policy, kind.policy_aliases["MlpPolicy"]),
    ):
        valid = _names(of)
        for name in table.keys() - {*valid}:
            text = f"is an unknown key (given {shown(table[name])}): {not_among(name, valid)}"
            found.append(Problem(("hyperparameters", *key, name), text))
    for name in RANGES.keys() & given.keys():
        (least, greatest), value = RANGES[name], given[name]
        if isinstance(value, bool) or not (
            isinstance(value, int | float) and least <= value <= greatest
        ):
            allowed = (
                f"at least {least:g}" if greatest == math.inf else f"from {least:g} to {greatest:g}"
            )
            found.append(
                Problem(
                    ("hyperparameters", name), f"is {shown(value)}: it should be a number {allowed}"
                )
            )
    return found


def _names(kind: Any) -> list[str]:
    """Names of the arguments of an algorithm or a policy that a file can say, those of an
    algorithm's settings among them."""
    settings = getattr(kind, "settings_class", None)
    of = [
        *inspect.signature(kind.__init__).parameters.values(),
        *(inspect.signature(settings).parameters.values() if settings else ()),
    ]
    return [
        argument.name
        for argument in of
        if argument.kind is not argument.VAR_KEYWORD and argument.name not in NOT_IN_FILES
    ]
