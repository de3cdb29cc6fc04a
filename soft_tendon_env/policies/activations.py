"""Activation functions of policy networks in NumPy, by the names of their torch.nn classes.

Their parameters are those that the classes have by default.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.special import erf, expit

from soft_tendon_env.tools.types import Single

# Klambauer et al., Self-normalizing neural networks, NeurIPS 2017, equation 14
SELU_ALPHA = np.float32(1.6732632423543772)
SELU_SCALE = np.float32(1.0507009873554805)
LEAKY_SLOPE = np.float32(0.01)  # of torch.nn.LeakyReLU
ZERO = np.float32(0.0)  # quicker in sums and comparisons than numbers of Python
ONE = np.float32(1.0)
SQRT_HALF = np.float32(np.sqrt(0.5))


def _elu(values: Single) -> Single:
    return np.maximum(values, _exp_below(values))


def _exp_below(values: Single) -> Single:
    """exp(x) - 1 below 0, which is above x, and 0 elsewhere."""
    # exp is five times quicker than expm1 here, and as exact to 1e-7 absolutely
    below: Single = np.exp(np.minimum(values, ZERO))
    below -= ONE
    return below


def _gelu(values: Single) -> Single:
    share = 1.0 + erf(SQRT_HALF * values)
    half: Single = np.float32(0.5) * values
    return half * share


def _selu(values: Single) -> Single:
    above = np.maximum(values, ZERO)
    below = SELU_ALPHA * _exp_below(values)
    return SELU_SCALE * (above + below)


def _softplus(values: Single) -> Single:
    return np.logaddexp(values, np.float32(0.0))


def _softsign(values: Single) -> Single:
    size: Single = np.add(np.abs(values), np.float32(1.0))
    return values / size


ACTIVATIONS: Mapping[str, Callable[[Single], Single]] = {
    "ELU": _elu,
    "GELU": _gelu,
    "Hardtanh": lambda values: np.clip(values, -1.0, 1.0),
    "Identity": lambda values: values,
    "LeakyReLU": lambda values: np.where(values > 0.0, values, LEAKY_SLOPE * values),
    "Mish": lambda values: values * np.tanh(_softplus(values)),
    "ReLU": lambda values: np.maximum(values, 0.0),
    "ReLU6": lambda values: np.clip(values, 0.0, 6.0),
    "SELU": _selu,
    "SiLU": lambda values: values * expit(values),
    "Sigmoid": expit,
    "Softplus": _softplus,
    "Softsign": _softsign,
    "Tanh": np.tanh,
}
"""Activation functions of float32 arrays, which they leave in single precision."""


def activation_name(name: object) -> str:
    """The name, if it is one of ACTIVATIONS.

    Raises ValueError that lists them.
    """
    if not (isinstance(name, str) and name in ACTIVATIONS):
        raise ValueError(
            f"activation_fn is {name!r}: it should be the name of an activation function in"
            f" torch.nn, one of {', '.join(ACTIVATIONS)}"
        )
    return name
