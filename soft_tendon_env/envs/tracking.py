"""Tracking: the arm beside its target, the errors that are measured of it, their display units, and reward terms of a user's own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.kernels import ContactReading
from soft_tendon_env.envs.rewards import OWN_TERMS, TERMS, Term
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.types import Array


class Tracking:
    """The arm and its target now, rows first, without noise: what tracking errors and reward terms are functions of.

    Quantities that are not asked for are not computed.

    Attributes:
        error: (rows, 6) SE(3) logarithm from tip to target.
        distance, angle: (rows,) [m] and [rad] from tip to target.
        tip_pose, target_pose: (rows, 4, 4).
        target_twist: (rows, 6) body twist of the target, angular [rad/s] before linear [m/s].
        command: (rows, n_a) as applied, tensions [N] or what the scene's effects make tensions of.
        action_change: (rows, n_a) change of the action, in [-2, 2].
        contact: with what the arm comes upon, see contacts.py.
        reading: what is read of the arms, such as `tip_twist` (rows, 6), `tendon_length` (rows, n_a) [m], and at the option's `sensors`
            `strain` and `strain_rate` (rows, sensors, 6).
        q: (rows, n) as the scene's material would have for the same shape; target_q: (rows, n), of targets that are shapes.
        q_dot: (rows, n).
        backbone, target_backbone: (rows, stations, 3) [m], for tasks that compare shapes.
    """

    __slots__ = (
        "_arms",
        "_target",
        "error",
        "distance",
        "angle",
        "tip_pose",
        "target_pose",
        "command",
        "action_change",
        "contact",
        "reading",
        "q_dot",
    )

    def __init__(
        self, arms: Arms, target: TargetSamples, error: Array, off: Array, command: Array, action_change: Array, contact: ContactReading
    ) -> None:
        self._arms, self._target, self.error, self.distance, self.angle = arms, target, error, off[0], off[1]
        self.tip_pose, self.target_pose = arms.reading.tip_pose, target.tip_pose[:, 0]
        self.command, self.action_change, self.contact = command, action_change, contact
        self.reading, self.q_dot = arms.reading, arms.rows.q_dot

    @property
    def q(self) -> Array:
        return self._arms.shape

    @property
    def target_twist(self) -> Array:
        return self._target.tip_twist[:, 0]

    @property
    def target_q(self) -> Array:
        return self._target.q[:, 0]

    @property
    def backbone(self) -> Array:
        return self._arms.reading.backbone[..., :3, 3]

    @property
    def target_backbone(self) -> Array:
        return self._target.backbone[:, 0]


@dataclass(frozen=True)
class TrackingError:
    """A tracking error: `name` in `info`, the reward `term` that falls with it, and the `scale` of the error that halves that term.

    value: (rows,) from the arm and its target, in SI units. of_length: whether `scale` is a share of the rod's length.
    """

    name: str
    term: str
    description: str
    scale: float
    value: Callable[[Tracking], Array]
    of_length: bool = False

    @property
    def as_term(self) -> Term:
        """The reward term that falls with it: 1/2 at `scale`."""
        return Term(self.description, self.scale, self.name, self.of_length)


def norm(vectors: Array) -> Array:
    """Euclidean norms (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, -1)))


POSITION = TrackingError("position_error", "position", "tip position error [m]", 0.05, lambda t: t.distance, of_length=True)
ANGLE = TrackingError("angle_error", "angle", "angle between the tip's and the target's frame [rad]", 0.5, lambda t: t.angle)
BACKBONE = TrackingError(
    "backbone_error",
    "backbone",
    "root mean square distance between backbone and target [m]",
    0.05,
    lambda t: np.sqrt(np.mean(norm(t.target_backbone - t.backbone) ** 2, axis=1)),
    of_length=True,
)
COORDINATES = TrackingError(
    "coordinate_error", "coordinates", "norm of the coordinates' error, newton for tensions", 10.0, lambda t: norm(t.target_q - t.q)
)
PENETRATION = TrackingError(
    "penetration", "penetration", "how deep the arm is in obstacles [m]", 0.001, lambda t: t.contact.penetration, of_length=True
)
CONTACT_FORCE = TrackingError("contact_force", "contact_force", "sum of the sizes of all contact forces [N]", 1.0, lambda t: t.contact.load)
CONTACT_ERRORS = (PENETRATION, CONTACT_FORCE)
"""Errors that every task has besides its own where the arm may come upon something, such as obstacles."""


def register_reward_term(function: Callable[[Tracking], Array]) -> Callable[[Tracking], Array]:
    """Function decorator: make a reward term available to every task and to the option `reward`, by the function's name.

    It takes a Tracking and returns values (rows,) between 0 and 1, 1 the best, so that no episode gains by ending early; the first line of
    its docstring describes it. Registering a function of the same module and name again replaces it, as in a notebook. Raises ValueError
    for a name that is taken, TypeError for what is no function with a name.
    """
    name = getattr(function, "__name__", "")
    if not callable(function) or not name.isidentifier():
        raise TypeError(f"a reward term should be a function with a name, not {shown(function)}")
    taken = {error.term for error in (POSITION, ANGLE, BACKBONE, COORDINATES, *CONTACT_ERRORS)} | TERMS.keys()
    present = getattr(OWN_TERMS.get(name), "of", function)
    if name in taken or (present.__module__, present.__qualname__) != (function.__module__, function.__qualname__):
        raise ValueError(f"the reward term {name!r} is taken: choose another name")
    OWN_TERMS[name] = Term((function.__doc__ or name).strip().partition("\n")[0], 0.0, function)
    return function


class ErrorUnit(NamedTuple):
    """Label and unit symbol of an error in plots and pictures, and the factor from SI units to that unit."""

    label: str
    symbol: str  # empty where the error's unit depends on the scene
    factor: float

    @property
    def heading(self) -> str:
        """Label without the word "error", and its unit: the heading of a table's column."""
        return self._replace(label=self.label.removesuffix(" error")).titled

    @property
    def titled(self) -> str:
        """Label with its unit, as on the axis of a plot."""
        return f"{self.label} [{self.symbol}]" if self.symbol else self.label

    def text(self, value: float) -> str:
        """Text of a value given in SI units: three significant digits and the display unit."""
        return f"{self.factor * value:.3g} {self.symbol}".rstrip()


SYMBOLS = {
    "position_error": ("mm", 1e3),
    "backbone_error": ("mm", 1e3),
    "angle_error": ("deg", 57.29577951308232),
    "penetration": ("mm", 1e3),
    "contact_force": ("N", 1.0),
}


def error_unit(name: str) -> ErrorUnit:
    """Display unit of an error by its name, such as "position_error"; a name that is not known keeps SI units."""
    return ErrorUnit(name.replace("_", " "), *SYMBOLS.get(name, ("", 1.0)))
