"""Checks of the kernels that are registered for an effect."""

import warnings

from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import kernels_of


class TimeWarning(UserWarning):
    """An effect depends on time without limiting the length of integrator steps."""


def check_kernels(name: str, kind: type[Struct]) -> None:
    """Raises TypeError where no kernel is registered for parameters of this class; warns of one that reads the time, but lets steps be as
    long as they like."""
    kernels = kernels_of(kind)
    if not kernels:
        raise TypeError(f"the effect {name!r} has no kernel for its parameters: decorate one with @adds_wrench({kind.__name__})")
    read = {word for own in kernels.values() for word in getattr(own, "py_func", own).__code__.co_names}
    if "limit" not in kernels and "time" in read and "time" not in kind.names():
        text = "reads the time, but no kernel of it is decorated with @limits_step: steps may pass over its changes"
        warnings.warn(f"the effect with parameters {kind.__name__} {text}", TimeWarning, stacklevel=2)
