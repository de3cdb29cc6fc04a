"""Every controller that comes with the package, by task and name. To add one, add its entry here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from soft_tendon_env.control.protocol import Controller
from soft_tendon_env.model import Model
from soft_tendon_env.scene import Array


@dataclass(frozen=True)
class Entry:
    """A controller by name.

    make: from a model, limits (n_a, 2) [N] and the control period [s]. looks_ahead: control periods at which it wants to see the target.
    """

    description: str
    make: Callable[[Model, Array, float], Controller]
    looks_ahead: int = 0


CONTROLLERS: Mapping[str, Mapping[str, Entry]] = {"TipPose": {}, "Shape": {}, "Reach": {}}
"""By the name of the task, then by its own."""
