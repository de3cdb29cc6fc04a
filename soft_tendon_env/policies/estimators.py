"""State estimators by name, and by what stands before a controller's name.

filtered:tracking is `tracking` with the Kalman filter.

One is a class or function under `@register("estimator", "lengths")`, here or in a user's own file
as `examples/own_estimator.py`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from soft_tendon_env.control.command_filter import Timing
from soft_tendon_env.control.kalman import ExtendedKalmanFilter
from soft_tendon_env.control.protocol import Estimator
from soft_tendon_env.control.uncertainty import GREATEST_LAG, GREATEST_LATENCY, Setting
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.registry import Registry, register

NO_TIMING = Timing(0.0, 0.0)
PARAMETERS: Mapping[str, str] = {
    "tip_twist": "tip_twist",
    "tendon_lengths": "tendon_length",
    "strain": "strain",
    "strain_rate": "strain_rate",
    "coordinates": "q",
    "rates": "q_dot",
}
"""Fields of Measurement, or of ControllerInput, by the observation groups that tell them, besides
the tip's pose."""


@dataclass(frozen=True)
class EstimatorEntry:
    """State estimator of ESTIMATORS."""

    prefix: str  # what stands before a controller's name in the name of its policy, "filtered:"
    make: Callable[[Model, Setting], Estimator]  # makes it for an arm and its sensors
    # greatest latency and lag [s] of commands that it estimates by itself; 0: it does not
    greatest_timing: Timing = NO_TIMING
    filters: bool = False  # whether it is a Kalman filter: entries of its Uncertainty can be tuned


def _checked_estimator(
    name: str,
    make: Any,
    *,
    prefix: str = "",
    greatest_timing: Timing = NO_TIMING,
    filters: bool = False,
) -> EstimatorEntry:
    """Entry of a state estimator, see EstimatorEntry.

    Args:
        name: of the estimator.
        make: a class or function of a model and a Setting that makes it.
        prefix: before the names of controllers, by default the name with a colon.
        greatest_timing: latency and lag [s] of commands that it estimates; 0: it does not.
        filters: whether it is a Kalman filter.

    Returns:
        The entry.

    Raises:
        TypeError: `make` makes no estimator.
        ValueError: the prefix is no word with a colon, or that of another estimator.
    """
    prefix = prefix or f"{name}:"
    if not callable(make):
        raise TypeError(f"the estimator {name!r} should be a class or function, not {shown(make)}")
    if isinstance(make, type) and not hasattr(make, "estimate"):
        raise TypeError(
            f"the estimator {name!r}, {make.__qualname__}, lacks a method estimate(measured, last)"
        )
    word = prefix[:-1]
    if not word.isidentifier() or not prefix.endswith(":"):
        raise ValueError(
            f"the estimator {name!r} has prefix = {prefix!r}: it should be a word and a colon"
        )
    for other, entry in ESTIMATORS.items():
        if entry.prefix == prefix and other != name:
            raise ValueError(
                f"the prefix {prefix!r} is that of the estimator {other!r}: choose another"
            )
    return EstimatorEntry(prefix, make, greatest_timing, filters)


ESTIMATORS: Registry[EstimatorEntry] = Registry("estimator", _checked_estimator)
"""State estimators by name."""

register(
    "estimator",
    "kalman",
    ExtendedKalmanFilter,
    prefix="filtered:",
    greatest_timing=Timing(GREATEST_LATENCY, GREATEST_LAG),
    filters=True,
)
