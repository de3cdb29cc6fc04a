"""Architecture of a policy network, as the arguments of Stable-Baselines3's policies say it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from soft_tendon_env.policies.activations import activation_name
from soft_tendon_env.policies.algorithms import Kind

ON_POLICY: tuple[Kind, ...] = ("PPO", "APG", "RecurrentPPO")
"""Kinds of networks whose actors are those of PPO."""
OFF_POLICY = ("net_arch", "activation_fn", "use_sde", "clip_mean")
ACTING: Mapping[str, tuple[str, ...]] = {
    "PPO": ("net_arch", "activation_fn", "use_sde", "squash_output"),
    "SAC": OFF_POLICY,
    "TQC": OFF_POLICY,
    "CrossQ": (*OFF_POLICY, "batch_norm", "batch_norm_eps"),
    "APG": ("net_arch", "activation_fn", "memory", "fine", "posture"),
    "RecurrentPPO": (
        "net_arch",
        "activation_fn",
        "use_sde",
        "squash_output",
        "lstm_hidden_size",
        "n_lstm_layers",
        "lstm_kwargs",
    ),
}
"""Arguments of policies that mean actions depend on, by the kind of network."""
OF_TRAINING = frozenset(
    [
        "log_std_init",
        "use_expln",
        "full_std",
        "ortho_init",
        "normalize_images",
        "share_features_extractor",
        "features_extractor_kwargs",
        "n_critics",
        "n_quantiles",
        "batch_norm_momentum",
        "renorm_warmup_steps",
        "optimizer_class",
        "optimizer_kwargs",
        "shared_lstm",
        "enable_critic_lstm",
    ]
)
"""Arguments of policies that matter in a training alone."""
EXTRACTOR = "features_extractor_class"  # argument of policies that is a class of the user's
HIDDEN: Mapping[str, tuple[int, ...]] = {
    "PPO": (64, 64),
    "APG": (64, 64),
    "RecurrentPPO": (64, 64),
    "SAC": (256, 256),
    "TQC": (256, 256),
    "CrossQ": (256, 256),
}
"""Units of hidden layers where `net_arch` does not say them."""
LSTM_SIZE = 256  # default size of the hidden state of an LSTM
CLIP_MEAN = 2.0  # default bound of the mean action under state-dependent exploration
RENORM_EPSILON = 0.001  # default of what batch renormalisation adds to variances


@dataclass(frozen=True)
class Architecture:
    """Architecture of a policy network: its layers, and how its actions are bounded.

    Attributes:
        kind: of the network, see `algorithms.network_kind`.
        hidden: units of the hidden layers.
        activation: name of the activation function, see `activations`.
        squashes: actions are tanh of the mean, scaled to the bounds of the action space.
        clip_mean: bound of the mean before that; None: there is none.
        renorm_epsilon: what batch renormalisation adds to variances; None: there is none.
        memory: size of the memory of a gated unit.
        lstm_size: size of the hidden state of an LSTM before the layers; 0: there is none.
        lstm_layers: number of its layers.
        fine: factor of small entries that layers see besides as tanh(fine x); 0: they do not.
        posture: number of first entries that gains leave out; 0: there are no gains.
    """

    kind: Kind
    hidden: tuple[int, ...]
    activation: str
    squashes: bool
    clip_mean: float | None = None
    renorm_epsilon: float | None = None
    memory: int = 0
    lstm_size: int = 0
    lstm_layers: int = 1
    fine: float = 0.0
    posture: int = 0


def read_architecture(kind: Kind, arguments: Mapping[str, Any]) -> Architecture:
    """Architecture by the arguments of a policy, as in `policy_kwargs` of a configuration.

    Args:
        kind: of the network, see `algorithms.network_kind`.
        arguments: plain values by their names.

    Returns:
        The architecture, with Stable-Baselines3's defaults for what is not said.

    Raises:
        ValueError: an argument is unknown, or cannot be expressed in NumPy.
    """
    if kind != "APG" and arguments.get(EXTRACTOR) is not None:
        raise ValueError(
            f"{EXTRACTOR} is {arguments[EXTRACTOR]!r}: layers of one's own cannot act here, give"
            " an object with `predict`, as module:name"
        )
    known = {*ACTING[kind], *OF_TRAINING, EXTRACTOR}
    unknown = sorted(arguments.keys() - known)
    if unknown:
        raise ValueError(f"policies of {kind} have no argument {', '.join(unknown)}")
    hidden = hidden_units(kind, arguments.get("net_arch"))
    is_on_policy = kind in ON_POLICY
    usual = "Tanh" if is_on_policy else "ReLU"
    activation = activation_name(arguments.get("activation_fn", usual))
    explores_by_state = bool(arguments.get("use_sde", False))
    if is_on_policy:
        # exploration by state changes no mean here, but without it nothing is squashed
        squashes = bool(arguments.get("squash_output", False))
        if squashes and not explores_by_state:
            raise ValueError("squash_output is true, which needs use_sde = true")
        memory = arguments.get("memory", 0)
        fine = float(arguments.get("fine", 0.0))
        posture = arguments.get("posture", 0)
        lstm_size, lstm_layers = _lstm_sizes(kind, arguments)
        return Architecture(
            kind,
            hidden,
            activation,
            squashes,
            memory=memory,
            lstm_size=lstm_size,
            lstm_layers=lstm_layers,
            fine=fine,
            posture=posture,
        )
    # actors of off-policy algorithms always squash, and bound the mean where they explore by state
    clip_mean = float(arguments.get("clip_mean", CLIP_MEAN))
    epsilon = None
    if kind == "CrossQ" and arguments.get("batch_norm", True):
        epsilon = float(arguments.get("batch_norm_eps", RENORM_EPSILON))
    is_clipped = explores_by_state and clip_mean > 0.0
    return Architecture(
        kind,
        hidden,
        activation,
        squashes=True,
        clip_mean=clip_mean if is_clipped else None,
        renorm_epsilon=epsilon,
    )


def _lstm_sizes(kind: Kind, arguments: Mapping[str, Any]) -> tuple[int, int]:
    """Size of the hidden state of an LSTM and number of its layers; (0, 1): there is none.

    Raises ValueError.
    """
    if kind != "RecurrentPPO":
        return 0, 1
    if arguments.get("lstm_kwargs"):
        raise ValueError(
            f"lstm_kwargs is {arguments['lstm_kwargs']!r}: an LSTM other than PyTorch's usual one"
            " cannot act here"
        )
    size = arguments.get("lstm_hidden_size", LSTM_SIZE)
    layers = arguments.get("n_lstm_layers", 1)
    are_counts = type(size) is int and type(layers) is int
    if not (are_counts and size > 0 and layers > 0):
        raise ValueError(
            f"lstm_hidden_size is {size!r} and n_lstm_layers {layers!r}: they should be whole"
            " numbers above 0"
        )
    return size, layers


def hidden_units(kind: Kind, net_arch: Any) -> tuple[int, ...]:
    """Units of the hidden layers of a policy, by its argument `net_arch`.

    Raises ValueError.
    """
    if net_arch is None:
        return HIDDEN[kind]
    units = net_arch.get("pi", ()) if isinstance(net_arch, Mapping) else net_arch
    is_list = isinstance(units, Sequence) and not isinstance(units, str)
    are_units = is_list and all(type(size) is int and size > 0 for size in units)
    if not are_units:
        raise ValueError(
            f"net_arch is {net_arch!r}: it should be the units of hidden layers, [64, 64], or a"
            ' table with those of the policy as "pi"'
        )
    return tuple(units)


def check_sizes(memory: int, posture: int, features: int) -> None:
    """Raises ValueError for sizes of a gated policy that cannot be, at so many features."""
    if not (memory >= 0 and 0 <= posture < features):
        raise ValueError(
            f"memory is {memory} and posture {posture}: they should be at least 0, and posture less"
            f" than the size of an observation, {features}"
        )
