"""Hyperparameters of Stable-Baselines3's algorithms that a file can say, each with its range, which Stable-Baselines3 does not check.

An argument of an algorithm that is named here is one of its hyperparameters; what takes objects (noise, buffers, classes) is not.
"""

import functools
import importlib
import inspect
import os
import warnings
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import AfterValidator, Field, WrapValidator, create_model

from soft_tendon_env.policies.network import algorithm_class, registered_algorithms
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among
from soft_tendon_env.tools.types import NotNegative, Positive

MOST_ROWS = 100_000_000  # of a buffer, in steps of the environment; how many fit is a question of memory
MOST_UNITS = 16_384  # of a layer
Steps = Annotated[int, Field(ge=1, le=MOST_ROWS)]
Share = Annotated[float, Field(ge=0, le=1)]
PositiveShare = Annotated[float, Field(gt=0, le=1)]
LessThanOne = Annotated[float, Field(ge=0, lt=1)]
Units = Annotated[int, Field(ge=1, le=MOST_UNITS)]
Layers = tuple[Units, ...]
LogStd = Annotated[float, Field(ge=-20, le=2)]
"""Logarithm of the standard deviation of actions within [-1, 1], in the bounds that SAC itself keeps."""


def explain(words: str) -> WrapValidator:
    """Validator that says in these words what is allowed of a value of several types, in place of a line per type."""

    def validate(value: Any, handler: Any) -> Any:
        try:
            return handler(value)
        except ValueError as error:
            raise ValueError(words) from error

    return WrapValidator(validate)


def _coefficient(value: float | str) -> float | str:
    if isinstance(value, str):
        first, _, start = value.partition("_")
        if first != "auto" or (value != "auto" and not float(start) > 0.0):
            raise ValueError
    elif value < 0.0:
        raise ValueError
    return value


def _every_or_positive(value: int) -> int:
    if value != -1 and value < 1:
        raise ValueError("should be at least 1, or -1")
    return value


def _activation(name: str) -> str:
    if name not in activations():
        raise ValueError(f"should be the name of an activation function in torch.nn: {not_among(name, activations())}")
    return name


@functools.cache
def activations() -> tuple[str, ...]:
    """The activation functions of PyTorch that keep the size of what they are given, without arguments."""
    import torch

    found = []
    for name in torch.nn.modules.activation.__all__:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                kept = getattr(torch.nn, name)()(torch.ones(1, 2)).shape == (1, 2)
        except Exception:
            continue
        found += [name] * kept
    return tuple(found)


class Optimizer(Configuration):
    """Further arguments of Adam."""

    eps: Positive | None = None
    weight_decay: NotNegative | None = None
    betas: tuple[LessThanOne, LessThanOne] | None = None
    amsgrad: bool | None = None


AUTO = 'should be a number of at least 0, "auto", or "auto_" and a number to begin with'
COEFFICIENT = Annotated[float | str, AfterValidator(_coefficient), explain(AUTO)]
ALGORITHM: Mapping[str, Any] = {
    "angle_scale": Positive,
    "batch_size": Steps,
    "buffer_size": Steps,
    "clip_range": Positive,
    "clip_range_vf": Positive,
    "ent_coef": NotNegative,
    "far_weight": NotNegative,
    "gae_lambda": Share,
    "gamma": Share,
    "gradient_steps": Annotated[int, AfterValidator(_every_or_positive)],
    "hold": Annotated[int, Field(ge=1)],
    "horizon": Annotated[int, Field(ge=1)],
    "lead": Share,
    "learning_starts": Annotated[int, Field(ge=0)],
    "max_grad_norm": Positive,
    "n_epochs": Annotated[int, Field(ge=1)],
    "n_steps": Steps,
    "noise": NotNegative,
    "normalize_advantage": bool,
    "policy_delay": Annotated[int, Field(ge=1)],
    "position_scale": Positive,
    "rounds": Annotated[int, Field(ge=1)],
    "sde_sample_freq": Annotated[int, AfterValidator(_every_or_positive)],
    "settling_time": Positive,
    "smoothness": NotNegative,
    "stats_window_size": Steps,
    "target_entropy": Annotated[float | Literal["auto"], explain('should be a number or "auto"')],
    "target_kl": Positive,
    "target_update_interval": Annotated[int, Field(ge=1)],
    "tau": PositiveShare,
    "teacher": Literal["tracking", "predictive"],
    "top_quantiles_to_drop_per_net": Annotated[int, Field(ge=0)],
    "train_freq": Steps,
    "use_sde": bool,
    "use_sde_at_warmup": bool,
    "vf_coef": NotNegative,
    "without": tuple[str, ...],
}
"""Types of the arguments of algorithms, by name."""
POLICY: Mapping[str, Any] = {
    "activation_fn": Annotated[str, AfterValidator(_activation)],
    "batch_norm": bool,
    "batch_norm_eps": Positive,
    "batch_norm_momentum": PositiveShare,
    "clip_mean": NotNegative,
    "full_std": bool,
    "log_std_init": LogStd,
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    "optimizer_kwargs": Optimizer,
    "ortho_init": bool,
    "renorm_warmup_steps": Annotated[int, Field(ge=0)],
    "share_features_extractor": bool,
    "squash_output": bool,
    "use_expln": bool,
}
"""Types of the arguments of their policies, policy_kwargs, by name."""
TRAINED = ("PPO", "SAC", "TQC", "CrossQ")
"""Algorithms of Stable-Baselines3 and sb3-contrib whose hyperparameters have ranges here."""
APG, DAGGER = "APG", "DAgger"
MODULES: Mapping[str, str] = {APG: "soft_tendon_env.learning.analytic_policy_gradient", DAGGER: "soft_tendon_env.learning.imitation"}
"""Modules of the package's own algorithms, each a class with the interface of Stable-Baselines3's `BaseAlgorithm`, by its name."""


def trained_algorithms() -> tuple[str, ...]:
    """Names of the algorithms to train with: those of Stable-Baselines3, the package's own, and those that were registered."""
    return (*TRAINED, *MODULES, *registered_algorithms())


def training_class(algorithm: str) -> Any:
    """Class of an algorithm to train with, see `trained_algorithms`. Raises ModuleNotFoundError without Stable-Baselines3."""
    return getattr(importlib.import_module(MODULES[algorithm]), algorithm) if algorithm in MODULES else algorithm_class(algorithm)


def learns_from_replay(algorithm: str) -> bool:
    """Whether an algorithm is off-policy: it learns from a buffer of past transitions, and its second network values actions."""
    return "buffer_size" in inspect.signature(training_class(algorithm).__init__).parameters


@functools.cache
def hyperparameters_of(algorithm: str) -> type[Configuration]:
    """Class of the table of an algorithm's hyperparameters; all are None unless given."""
    kind = training_class(algorithm)
    off_policy = learns_from_replay(algorithm)
    critic = "qf" if off_policy else "vf"
    both = _table("Networks", dict.fromkeys(("pi", critic), Layers), required=True)
    words = f"should be the sizes of layers, 1 to {MOST_UNITS}, such as [128, 128], or {{ pi = [...], {critic} = [...] }}"
    of_policy = {"net_arch": Annotated[Layers | both, explain(words)], **_among(POLICY, kind.policy_aliases["MlpPolicy"])}
    own = _among(ALGORITHM, kind)
    if off_policy:
        own["ent_coef"] = COEFFICIENT
    return _table(algorithm, {**own, "policy_kwargs": _table("Policy", of_policy)})


def _among(types: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    """Types of the arguments that a class takes, by name."""
    arguments = inspect.signature(kind.__init__).parameters
    return {name: of_name for name, of_name in types.items() if name in arguments}


def _table(name: str, types: Mapping[str, Any], required: bool = False) -> type[Configuration]:
    fields: dict[str, Any] = {key: (kind, ...) if required else (kind | None, None) for key, kind in types.items()}
    return create_model(name, __base__=Configuration, **fields)


def problems_of(algorithm: str, given: Mapping[str, Any]) -> list[Problem]:
    """Problems of hyperparameters by themselves."""
    try:
        hyperparameters_of(algorithm)(**given)
    except ConfigurationError as error:
        return [problem_below(problem) for problem in error.problems]
    return []


def problem_below(problem: Problem) -> Problem:
    """Problem with its key as a training has it."""
    return Problem(("hyperparameters", *problem.key), problem.text)


class Size(NamedTuple):
    """Sizes of a training that hyperparameters have to fit."""

    arms: int
    steps: int  # of all arms together
    episode: int  # steps of one
    goals: bool  # whether observations have goals
    hindsight: bool


def misfits(algorithm: str, given: Mapping[str, Any], size: Size) -> list[Problem]:
    """Problems of hyperparameters, each right by itself, in a training."""
    arguments = inspect.signature(training_class(algorithm).__init__).parameters
    value = {name: given.get(name, argument.default) for name, argument in arguments.items()}
    policy = given.get("policy_kwargs") or {}
    found: list[Problem] = []

    def check(holds: bool, name: str, allowed: str) -> None:
        if not holds:
            key, given = (("policy_kwargs", name), policy[name]) if name in policy else ((name,), value[name])
            found.append(problem_below(Problem(key, f"is {given}: it should be {allowed}")))

    if value.get("normalize_advantage") and "batch_size" in value:
        check(value["n_steps"] * size.arms > 1, "n_steps", "at least 2 with a single arm, or normalize_advantage = false")
        check(value["batch_size"] > 1, "batch_size", "at least 2, or normalize_advantage = false")
    if "rounds" in value:
        check(value["rounds"] * size.arms <= size.steps, "rounds", f"at most {size.steps // size.arms}, a control period of all arms each")
        for name in ("horizon", "hold", "smoothness"):
            own = value["teacher"] == "predictive" or value[name] == arguments[name].default
            check(own, name, f"left out: the teacher {value['teacher']!r} has no {name}")
    if policy.get("squash_output"):
        check(bool(value.get("use_sde")), "squash_output", "false unless use_sde is true")
    if "buffer_size" in value:
        check(value["learning_starts"] < size.steps, "learning_starts", f"less than steps, {size.steps}, or nothing is learned")
        check(value["buffer_size"] >= size.arms, "buffer_size", f"at least one step of each arm, {size.arms}")
        check(not size.goals or value.get("n_steps", 1) == 1, "n_steps", "1 on a task with goals")
    if size.hindsight and "buffer_size" in value:
        first, whole = size.arms * (size.episode - 1), size.arms * size.episode
        check(value["learning_starts"] >= first, "learning_starts", f"at least {first}, for episodes to have ended")
        check(value["buffer_size"] >= whole, "buffer_size", f"at least an episode of each arm, {whole}")
    if "top_quantiles_to_drop_per_net" in value:
        quantiles = policy.get("n_quantiles", 25)
        check(value["top_quantiles_to_drop_per_net"] < quantiles, "top_quantiles_to_drop_per_net", f"less than n_quantiles, {quantiles}")
    return found


def buffer_bytes(algorithm: str, given: Mapping[str, Any], arms: int, steps: int, observation: int, action: int) -> int:
    """Memory [B] of what an algorithm learns from, for so many numbers of an observation and an action."""
    arguments = inspect.signature(training_class(algorithm).__init__).parameters
    if algorithm == DAGGER:
        return steps * (3 * observation + action) * 4  # as they come, as one array, and as features
    if "buffer_size" in arguments:
        return given.get("buffer_size", arguments["buffer_size"].default) * (2 * observation + action + 3) * 4
    return given.get("n_steps", arguments["n_steps"].default) * arms * (observation + action + 6) * 4


def memory() -> float:
    """Memory of the machine [B]; infinite where it is not known."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return float("inf")
