"""State estimators by name, and by what stands before a controller's name.

filtered:tracking is `tracking` with the Kalman filter.

To add one, add an entry to ESTIMATORS: ESTIMATORS["lengths"] = EstimatorEntry("lengths:",
LengthObserver).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from soft_tendon_env.control.kalman import ExtendedKalmanFilter, Setting
from soft_tendon_env.control.protocol import Estimator
from soft_tendon_env.model.model import Model

GREATEST_LATENCY = 0.08  # [s] that an estimate of an unknown latency reaches
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
    make: Callable[[Model, Setting], Estimator]
    greatest_latency: float = 0.0  # [s] of commands that it estimates by itself; 0: it does not
    filters: bool = False  # whether it is a Kalman filter: entries of its Uncertainty can be tuned


def _adaptive_filter(model: Model, setting: Setting) -> Estimator:
    first = setting.latency or GREATEST_LATENCY / 4
    return ExtendedKalmanFilter(
        model, setting._replace(latency=first), max(GREATEST_LATENCY, first)
    )


ESTIMATORS: dict[str, EstimatorEntry] = {
    "kalman": EstimatorEntry("filtered:", ExtendedKalmanFilter, filters=True),
    "adaptive": EstimatorEntry("adaptive:", _adaptive_filter, GREATEST_LATENCY, filters=True),
}
"""State estimators by name: extended Kalman filter, and the same with unknown latency."""
