"""Tracking: the arm beside its target, the errors that are measured of it, their display units, and reward terms of a user's own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.envs.kernels import ContactReading
from soft_tendon_env.envs.rewards import OWN_TERMS, TERMS, Term
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.tools.types import Array


class Tracking(NamedTuple):
    """The arm and its target now, rows first, without noise: what tracking errors and reward terms are functions of."""

    arms: Arms
    reading: Reading  # of the arms, such as `tip_twist` (rows, 6), `tendon_length` (rows, n_a) [m], and `strain` at the sensors
    error: Array  # (rows, 6) SE(3) logarithm from tip to target
    distance: Array  # (rows,) [m] from tip to target
    angle: Array  # (rows,) [rad], likewise
    target: TargetSamples  # (rows, 1 + previews, ..) now and at each preview time, its backbone (rows, 1 + previews, stations, 3) [m]
    command: Array  # (rows, n_a) as applied, tensions [N] or what the scene's effects make tensions of
    action_change: Array  # (rows, n_a) change of the action, in [-2, 2]
    contact: ContactReading  # with what the arm comes upon

    @property
    def tip_pose(self) -> Array:
        """Poses of the tips (rows, 4, 4)."""
        return self.reading.tip_pose

    @property
    def target_pose(self) -> Array:
        """Target poses (rows, 4, 4)."""
        return self.target.tip_pose[:, 0]

    @property
    def q(self) -> Array:
        """Coordinates (rows, n) that the scene's material would have for the same shape."""
        return self.arms.shape


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
        return Term(self.name, self.scale, self.of_length)


def norm(vectors: Array) -> Array:
    """Euclidean norms (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, -1)))


def _backbone_distance(t: Tracking) -> Array:
    return np.asarray(np.sqrt(np.mean(norm(t.target.backbone[:, 0] - t.reading.backbone[..., :3, 3]) ** 2, axis=1)))


POSITION = TrackingError("position_error", "position", "tip position error [m]", 0.05, lambda t: t.distance, of_length=True)
ANGLE = TrackingError("angle_error", "angle", "angle between the tip's and the target's frame [rad]", 0.5, lambda t: t.angle)
_ROOT_MEAN_SQUARE = "root mean square distance between backbone and target [m]"
BACKBONE = TrackingError("backbone_error", "backbone", _ROOT_MEAN_SQUARE, 0.05, _backbone_distance, of_length=True)
COORDINATES = TrackingError(
    "coordinate_error", "coordinates", "norm of the coordinates' error, newton for tensions", 10.0, lambda t: norm(t.target.q[:, 0] - t.q)
)
PENETRATION = TrackingError(
    "penetration", "penetration", "how deep the arm is in obstacles [m]", 0.001, lambda t: t.contact.penetration, of_length=True
)
CONTACT_FORCE = TrackingError("contact_force", "contact_force", "sum of the sizes of all contact forces [N]", 1.0, lambda t: t.contact.load)
CONTACT_ERRORS = (PENETRATION, CONTACT_FORCE)
"""Errors that every task has besides its own where the arm may come upon something, such as obstacles."""


def register_reward_term(function: Callable[[Tracking], Array]) -> Callable[[Tracking], Array]:
    """Function decorator: make a reward term available to every task and to the option `reward`, by the function's name.

    It takes a Tracking and returns values (rows,) between 0 and 1, 1 the best, so that no episode gains by ending early. Registering a
    function of the same module and name again replaces it, as in a notebook. Raises ValueError for a name that is taken.
    """
    name = function.__name__
    taken = {error.term for error in (POSITION, ANGLE, BACKBONE, COORDINATES, *CONTACT_ERRORS)} | TERMS.keys()
    present = getattr(OWN_TERMS.get(name), "of", function)
    if name in taken or (present.__module__, present.__qualname__) != (function.__module__, function.__qualname__):
        raise ValueError(f"the reward term {name!r} is taken: choose another name")
    OWN_TERMS[name] = Term(function)
    return function


class ErrorUnit(NamedTuple):
    """Label and unit symbol of an error in plots and pictures, and the factor from SI units to that unit."""

    label: str
    symbol: str = ""  # empty where the error's unit depends on the scene
    factor: float = 1.0

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
    **dict.fromkeys(("position_error", "backbone_error", "penetration"), ("mm", 1e3)),
    "angle_error": ("deg", 57.29577951308232),
    "contact_force": ("N", 1.0),
}


def error_unit(name: str) -> ErrorUnit:
    """Display unit of an error by its name, such as "position_error"; a name that is not known keeps SI units."""
    return ErrorUnit(name.replace("_", " "), *SYMBOLS.get(name, ()))
