"""Policy networks of Stable-Baselines3 from their architecture and weights, without unpickling.

Weights come from `torch.load(weights_only=True)`. What a network is like comes from plain values: of an agent's config.json, or of the
JSON in a .zip file of Stable-Baselines3, whose pickled parts are never looked at.
"""

import importlib
import inspect
import io
import re
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import gymnasium as gym

from soft_tendon_env.tools.files import archive, parse_json, read_bytes
from soft_tendon_env.tools.messages import first_line

WEIGHTS = "weights.pt"
ALGORITHMS = {
    **dict.fromkeys(("A2C", "DDPG", "PPO", "SAC", "TD3"), "stable_baselines3"),
    **dict.fromkeys(("ARS", "CrossQ", "RecurrentPPO", "TQC", "TRPO"), "sb3_contrib"),
}
OF_PACKAGE = {"APG": "PPO", "DAgger": "PPO"}
"""Algorithms of this package (learning.hyperparameters.MODULES), and the one of Stable-Baselines3 whose policy networks they train."""
OWN_POLICIES = {"ars": "ARS", "crossq": "CrossQ", "sac": "SAC", "td3": "TD3", "tqc": "TQC"}  # DDPG is a TD3
SETTINGS = {"clip_range": "PPO", "cg_max_steps": "TRPO", "gae_lambda": "A2C"}  # tell apart those that share their policies
OF_TRAINING = ("optimizer_class", "optimizer_kwargs")  # arguments of policies that no longer matter
ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")
_REGISTERED: dict[str, type] = {}
Algorithm = TypeVar("Algorithm", bound=type)


def register_algorithm(algorithm: Algorithm) -> Algorithm:
    """Class decorator: train with an algorithm of your own, a subclass of Stable-Baselines3's `BaseAlgorithm`, by its class's name.

    Its hyperparameters are those arguments that `learning.hyperparameters` knows; agents of it load where it is registered. Raises
    ValueError for a name that another algorithm has.
    """
    name = algorithm.__name__
    if name in ALGORITHMS or name in OF_PACKAGE or name in _REGISTERED and _REGISTERED[name].__qualname__ != algorithm.__qualname__:
        raise ValueError(f"there is an algorithm {name} already: give the class another name")
    _REGISTERED[name] = algorithm
    return algorithm


def registered_algorithms() -> tuple[str, ...]:
    """Names of algorithms from outside of the package, sorted."""
    return tuple(sorted(_REGISTERED))


def algorithm_names() -> tuple[str, ...]:
    """Names of all algorithms whose agents can be loaded, sorted."""
    return tuple(sorted([*ALGORITHMS, *OF_PACKAGE, *_REGISTERED]))


class Architecture(NamedTuple):
    """algorithm: its name. policy: arguments of its policy, with plain values; `activation_fn` is a name in torch.nn."""

    algorithm: str
    policy: dict[str, Any]


def algorithm_class(algorithm: str) -> Any:
    """Class of an algorithm: registered, or in Stable-Baselines3. Raises ModuleNotFoundError."""
    if algorithm in _REGISTERED:
        return _REGISTERED[algorithm]
    try:
        return getattr(importlib.import_module(ALGORITHMS[algorithm]), algorithm)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f'{algorithm} needs Stable-Baselines3: pip install "soft_tendon_env[agents]"') from error


def make_network(architecture: Architecture, weights: Mapping[str, Any], observations: gym.Space[Any], actions: gym.Space[Any]) -> Any:
    """A policy network of Stable-Baselines3. Raises ValueError where the weights are not of these spaces or this architecture."""
    given = {key: value for key, value in architecture.policy.items() if key not in OF_TRAINING}
    network = new_network(Architecture(architecture.algorithm, given), observations, actions)
    with _refused(architecture.algorithm):
        network.load_state_dict(weights)
    return network


def new_network(architecture: Architecture, observations: gym.Space[Any], actions: gym.Space[Any]) -> Any:
    """A policy network of Stable-Baselines3 that has learned nothing. Raises ValueError where there is none of this architecture."""
    algorithm, given = architecture.algorithm, policy_arguments(architecture.policy)
    aliases = algorithm_class(OF_PACKAGE.get(algorithm, algorithm)).policy_aliases
    name = "MultiInput" if isinstance(observations, gym.spaces.Dict) else "Mlp"
    name += "LstmPolicy" if algorithm == "RecurrentPPO" else "Policy"
    if name not in aliases:
        raise ValueError(f"{algorithm} has no policy for observations {observations}")
    known = inspect.signature(aliases[name].__init__).parameters
    schedule = {"lr_schedule": lambda _: 0.0} if "lr_schedule" in known else {}
    if unknown := given.keys() - known.keys():
        raise ValueError(f"policies of {algorithm} have no argument {', '.join(sorted(unknown))}")
    with _refused(algorithm):
        return aliases[name](observations, actions, **schedule, **given)


def policy_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a policy of plain ones: `activation_fn` is the class of that name in torch.nn. Raises ValueError."""
    import torch

    found = dict(given)
    if "activation_fn" in found:
        kind = getattr(torch.nn, str(found["activation_fn"]), None)
        if not (isinstance(kind, type) and issubclass(kind, torch.nn.Module)):
            raise ValueError(f"activation_fn is {found['activation_fn']!r}: it should be the name of an activation function in torch.nn")
        found["activation_fn"] = kind
    return found


@contextmanager
def _refused(algorithm: str) -> Iterator[None]:
    """Errors of PyTorch and Stable-Baselines3 about a network as a ValueError."""
    try:
        yield
    except (AssertionError, AttributeError, MemoryError, RuntimeError, TypeError, ValueError, KeyError) as error:
        text = " ".join(str(error).split())[:200]
        raise ValueError(f"the weights are not of a {algorithm} policy for this environment: {text}") from error


def read_weights(path: Path, content: bytes | None = None) -> dict[str, Any]:
    """Tensors by name, with PyTorch's loader that builds nothing else, in a file or in this part of its content. Raises ValueError."""
    import torch

    try:
        source = io.BytesIO(read_bytes(path) if content is None else content)
        if zipfile.is_zipfile(source):
            archive(source.getvalue()).close()
        source.seek(0)
        weights = torch.load(source, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever it meets in a damaged file
        raise ValueError(f"{path} holds no weights alone, or was cut or damaged: {first_line(error)}") from error
    if not isinstance(weights, dict) or not all(isinstance(key, str) and isinstance(value, torch.Tensor) for key, value in weights.items()):
        raise ValueError(f"{path} should hold tensors by name, as `save_weights` writes them, not {type(weights).__name__}")
    if bad := [name for name, tensor in weights.items() if not bool(torch.isfinite(tensor).all())]:
        raise ValueError(f"{path}: {bad[0]} has weights that are not finite")
    return weights


def save_weights(path: Path, network: Any) -> None:
    """Write the tensors of a policy network by name. Raises OSError, RuntimeError."""
    import torch

    torch.save(dict(network.state_dict()), path)


def read_zip(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The plain settings and the weights in a .zip file of Stable-Baselines3. Raises ValueError."""
    try:
        with archive(read_bytes(path)) as file:
            settings, weights = parse_json(file.read("data")), file.read("policy.pth")
        settings["policy_class"]["__module__"].split(".")
    except Exception as error:  # zipfile raises whatever it meets in a damaged file
        raise ValueError(f"{path} is no agent of Stable-Baselines3, or was cut or damaged: {first_line(error)}") from error
    return settings, read_weights(path, weights)


def algorithm_in(settings: Mapping[str, Any]) -> str | None:
    """The algorithm whose settings a .zip file has; None where they do not say."""
    module = settings["policy_class"]["__module__"].split(".")
    found = [OWN_POLICIES[part] for part in module if part in OWN_POLICIES] + [SETTINGS[key] for key in SETTINGS if key in settings]
    return "RecurrentPPO" if found and "recurrent" in module else next(iter(found), None)


def architecture_in(settings: Mapping[str, Any], algorithm: str, path: Path) -> Architecture:
    """Architecture by the settings in a .zip file. Raises ValueError where it is made of classes of its author's."""
    given = settings.get("policy_kwargs") or {}
    policy = {key: value for key, value in given.items() if not key.startswith(":") and key not in OF_TRAINING}
    if isinstance(activation := policy.get("activation_fn"), str) and (match := ACTIVATION.fullmatch(activation)):
        policy["activation_fn"] = match[1]
    for key, value in policy.items():
        if isinstance(value, str) and key != "activation_fn":
            text = "it cannot be known without running what is in the file"
            raise ValueError(f"{path}: policy_kwargs.{key} is {value[:80]}: {text}")
    if settings.get("use_sde"):
        policy["use_sde"] = True
    return Architecture(algorithm, policy)
