"""State estimators by name, and by what stands before a controller's name: filtered:tracking is `tracking` with the Kalman filter.

To add one, add an entry to ESTIMATORS, or register one of your own with `register_estimator`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

from soft_tendon_env.control.kalman import ExtendedKalmanFilter, Uncertainty
from soft_tendon_env.control.kalman_measurement import Sensing
from soft_tendon_env.control.protocol import Estimator
from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.configuration import not_among
from soft_tendon_env.tools.types import Array

GREATEST_LATENCY = 0.08
"""[s] that an estimate of an unknown latency reaches."""
PARAMETERS: Mapping[str, str] = {
    "tip_twist": "tip_twist",
    "tendon_lengths": "tendon_length",
    "strain": "strain",
    "strain_rate": "strain_rate",
    "coordinates": "q",
    "rates": "q_dot",
}
"""Fields of a Measurement by the observation groups that tell them, besides the tip's pose."""


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


def _kalman_filter(model: Model, setting: Setting, greatest_latency: float | None = None) -> Estimator:
    """greatest_latency: [s] of commands whose latency is not known, None: it is."""
    latency = setting.latency
    if greatest_latency is not None:
        latency, greatest_latency = latency or greatest_latency / 4, max(greatest_latency, latency)
    sensing = Sensing(setting.observed, setting.sensors, setting.noise)
    known: dict[str, Any] = {"uncertainty": setting.uncertainty, "latency": latency, "greatest_latency": greatest_latency}
    return ExtendedKalmanFilter(model, setting.period, setting.tension, sensing, **known)


_adaptive = partial(_kalman_filter, greatest_latency=GREATEST_LATENCY)
ESTIMATORS: dict[str, EstimatorEntry] = {
    "kalman": EstimatorEntry("filtered:", _kalman_filter, filters=True),
    "adaptive": EstimatorEntry("adaptive:", _adaptive, GREATEST_LATENCY, filters=True),
}
"""State estimators by name: extended Kalman filter, and the same with unknown latency."""
Added = TypeVar("Added", bound=Make)


def estimator_entry(name: str) -> EstimatorEntry:
    """Entry of an estimator. Raises ValueError."""
    if name not in ESTIMATORS:
        raise ValueError(f"estimator is {name!r}: {not_among(name, ESTIMATORS)}")
    return ESTIMATORS[name]


def register_estimator(name: str) -> Callable[[Added], Added]:
    """Decorator of a class or function (model, Setting) that makes a state estimator, see control.protocol: policies of controllers with it
    are called "name:CONTROLLER". Raises ValueError for the names of the package's own."""

    def add(make: Added) -> Added:
        if name in ("kalman", "adaptive", "filtered"):
            raise ValueError(f"there is an estimator {name!r} already: choose another name")
        ESTIMATORS[name] = EstimatorEntry(f"{name}:", make)
        return make

    return add
