"""State estimators by name, and by what stands before a controller's name: filtered:tracking is `tracking` with the Kalman filter.

To add one, add an entry to ESTIMATORS: ESTIMATORS["lengths"] = EstimatorEntry("lengths:", LengthObserver).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from soft_tendon_env.control.kalman import ExtendedKalmanFilter, Sensing, Uncertainty
from soft_tendon_env.control.protocol import Estimator
from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

GREATEST_LATENCY = 0.08  # [s] that an estimate of an unknown latency reaches
PARAMETERS: Mapping[str, str] = {
    "tip_twist": "tip_twist",
    "tendon_lengths": "tendon_length",
    "strain": "strain",
    "strain_rate": "strain_rate",
    "coordinates": "q",
    "rates": "q_dot",
}
"""Fields of Measurement, or of ControllerInput, by the observation groups that tell them, besides the tip's pose."""


class Setting(NamedTuple):
    """Observation and actuators that an estimator works with, besides the model that it believes in."""

    period: float  # [s] of control
    tension: Array  # (n_a,) [N] at reset
    sensors: Array  # (s,) [m] arc lengths of strain sensors
    noise: SensorNoise
    observed: tuple[str, ...]  # fields of Measurement that are there, besides the tip's pose
    latency: float  # [s] of commands, as far as it is known
    uncertainty: Uncertainty


Make = Callable[[Model, Setting], Estimator]


@dataclass(frozen=True)
class EstimatorEntry:
    """State estimator of ESTIMATORS."""

    prefix: str  # what stands before a controller's name in the name of its policy, "filtered:"
    make: Make
    greatest_latency: float = 0.0  # [s] of commands that it estimates by itself; 0: it does not
    filters: bool = False  # whether it is a Kalman filter: entries of its Uncertainty can be tuned


def _kalman_filter(model: Model, own: Setting, latency: float | None = None, greatest: float | None = None) -> Estimator:
    sensing, latency = Sensing(own.observed, own.sensors, own.noise), own.latency if latency is None else latency
    return ExtendedKalmanFilter(model, own.period, own.tension, sensing, own.uncertainty, latency, greatest)


def _adaptive_filter(model: Model, own: Setting) -> Estimator:
    first = own.latency or GREATEST_LATENCY / 4
    return _kalman_filter(model, own, first, max(GREATEST_LATENCY, first))


ESTIMATORS: dict[str, EstimatorEntry] = {
    "kalman": EstimatorEntry("filtered:", _kalman_filter, filters=True),
    "adaptive": EstimatorEntry("adaptive:", _adaptive_filter, GREATEST_LATENCY, filters=True),
}
"""State estimators by name: extended Kalman filter, and the same with unknown latency."""
