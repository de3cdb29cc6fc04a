"""State estimation from strain sensors along the arm: coordinates and rates by nonlinear least squares with a prior.

Sensor noise: standard deviations of white Gaussian noise, for the environments that add it and the estimators that know of it.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from soft_tendon_env.control.protocol import Estimate, Measurement
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.checks import checked_array, checked_number, checked_type
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array

AMPLITUDE, RATE, ACCELERATION = 5.0, 10.0, 300.0
"""Standard deviations of coordinates, their rates [1/s] and accelerations [1/s^2] before anything is measured, in `coordinate_scale`s."""
ITERATIONS = 20
HALVINGS = 10
NEGLIGIBLE = 1e-6
"""Expected fall of the cost, a sum of squares in standard deviations, up to which a correction is left out."""
ROUND_OFF = 1e-14
"""Part of all information up to which a combination of coordinates counts as not measured at all."""

Deviation = Annotated[float, Field(ge=0, le=1e6)]


class SensorNoise(Configuration):
    """Standard deviations of Gaussian noise on what is observed; rewards and errors are the true ones.

    `position` [m] and `rotation` [rad] of the tip, `length` of tendons [m], `curvature` (torsion and bending) [1/m] and `stretch`
    (stretch and shear) [-] of strain sensors, `curvature_rate` [1/(m s)] and `stretch_rate` [1/s] of their rates.
    """

    position: Deviation = 0.0
    rotation: Deviation = 0.0
    length: Deviation = 0.0
    curvature: Deviation = 0.0
    stretch: Deviation = 0.0
    curvature_rate: Deviation = 0.0
    stretch_rate: Deviation = 0.0

    def of_strains(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the strains at so many sensors."""
        return np.tile(np.repeat([self.curvature, self.stretch], 3), sensors)

    def of_strain_rates(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the rates of those strains."""
        return np.tile(np.repeat([self.curvature_rate, self.stretch_rate], 3), sensors)

    def at_least(self, least: "SensorNoise") -> "SensorNoise":
        """Noise with each deviation raised to that of `least` where it is smaller."""
        return SensorNoise(**{name: max(getattr(self, name), getattr(least, name)) for name in SensorNoise.model_fields})


class MeasurementNoise(SensorNoise):
    """Noise on everything that a state estimator can be told, which environments tell without noise for the most part.

    `angular` [rad/s] and `linear` [m/s] of the tip's twist, `coordinate`, in `Model.coordinate_scale`s, and `rate` [1/s] of coordinates.
    """

    angular: Deviation = 0.0
    linear: Deviation = 0.0
    coordinate: Deviation = 0.0
    rate: Deviation = 0.0


LEAST_NOISE = SensorNoise(curvature=1e-2, stretch=1e-4, curvature_rate=1e-1, stretch_rate=1e-3)
"""Noise of sensors that say nothing of theirs: it stands for what the model does not know of strains."""


class Prior(NamedTuple):
    """Prior of scaled coordinates, or of their rates: independent Gaussians."""

    mean: Array  # (n,)
    information: float  # 1 / deviation^2


class Predicted(NamedTuple):
    """Predicted strains of the sensors and their Jacobian at scaled coordinates."""

    z: Array  # (n,)
    strain: Array  # (6 s,)
    jacobian: Array  # (6 s, n)


class StrainEstimator:
    """Finds the coordinates whose strains come nearest to the measured ones, weighed against where the arm was expected.

    With y(q) the model's strains at the sensors, y_dot = H(q) q_dot, R the covariance of the noise and P that of the prior,

        q = argmin |y(q) - strain|^2_(R^-1) + |q - expected|^2_(P^-1),     q_dot = argmin |H q_dot - rate|^2_(R_dot^-1) + ...

    by Gauss-Newton. The prior is the product of two: where the last estimate leads under accelerations of the size ACCELERATION, and rest
    within AMPLITUDE and RATE. So combinations of coordinates that the sensors cannot tell apart, or not well, slowly forget what was
    believed of them and stay bounded. Coordinates are scaled by `Model.coordinate_scale`.

    Args:
        model: what is believed of the arm.
        sensors: arc lengths (s,) [m] of the strain sensors.
        period: [s] from one estimate to the next.
        noise: of the sensors, positive for strains and their rates.

    Raises TypeError, ValueError.
    """

    needs: tuple[str, ...] = ("strain", "strain_rate")
    uses: tuple[str, ...] = ("strain", "strain_rate")
    history = 0

    def __init__(self, model: Model, sensors: ArrayLike, period: float, noise: SensorNoise = LEAST_NOISE) -> None:
        self.model = checked_type("model", model, Model, "see build_model")
        self.sensors = checked_array("sensors", sensors, (None,))
        if not self.sensors.size:
            raise ValueError("sensors should name at least one arc length")
        if not (0.0 <= self.sensors.min() and self.sensors.max() <= model.length):
            allowed = f"between 0 and the rod's length, {model.length:g}"
            raise ValueError(f"sensors should lie {allowed}, not {self.sensors.min():g} to {self.sensors.max():g}")
        self.period = checked_number("period", period, np.finfo(float).tiny, "a positive number of seconds")
        for name in ("curvature", "stretch", "curvature_rate", "stretch_rate"):
            checked_number(f"noise.{name}", getattr(noise, name), np.finfo(float).tiny, "a positive number")
        self._scale = model.coordinate_scale()
        self._deviation, self._rate_deviation = noise.of_strains(self.sensors.size), noise.of_strain_rates(self.sensors.size)
        self._stress_free = model.strain_at(np.zeros_like(self._scale), self.sensors)[0].ravel()

    def estimate(self, measured: Measurement, last: Estimate | None) -> Estimate:
        """Estimated coordinates and rates, see control.protocol.Estimator.

        Raises ValueError or TypeError for arrays of other shapes or not finite, and nothing else: where measurements are absurd, what was
        expected stays.
        """
        shape = (self.sensors.size, 6)
        if measured.strain is None or measured.strain_rate is None:
            raise ValueError("strain and strain_rate should both be measured, not None")
        strain = checked_array("strain", measured.strain, shape).ravel() + self._stress_free
        rate = checked_array("strain_rate", measured.strain_rate, shape).ravel()
        with np.errstate(over="ignore", invalid="ignore"):
            coordinates, rates = self._priors(last)
            found = self._fitted(strain, coordinates)
            information, drive = _normal_equations(found.jacobian @ rates.mean, rate, found.jacobian, self._rate_deviation)
            change, _ = _correction(information, drive, rates.information)
        return Estimate(self._scale * found.z, self._scale * (rates.mean + change))

    def _priors(self, last: Estimate | None) -> tuple[Prior, Prior]:
        """Priors of the scaled coordinates and of their rates."""
        if last is None:
            rest = np.zeros_like(self._scale)
            return Prior(rest, AMPLITUDE**-2), Prior(rest, RATE**-2)
        z, z_dot, change = last.q / self._scale, last.q_dot / self._scale, ACCELERATION * self.period
        return _recalled(z + self.period * z_dot, change * self.period, AMPLITUDE), _recalled(z_dot, change, RATE)

    def _fitted(self, measured: Array, prior: Prior) -> Predicted:
        """Coordinates of least cost, by damped Gauss-Newton steps."""
        now = self._predicted(prior.mean) or self._predicted(np.zeros_like(prior.mean))
        assert now is not None, "the stress-free rod has a strain"
        for _ in range(ITERATIONS):
            information, drive = _normal_equations(now.strain, measured, now.jacobian, self._deviation)
            step, fall = _correction(information, drive + prior.information * (prior.mean - now.z), prior.information)
            if fall <= NEGLIGIBLE:
                break
            trials = (self._predicted(now.z + 0.5**k * step) for k in range(HALVINGS))
            cost = self._cost(now, measured, prior)
            better = next((trial for trial in trials if trial and self._cost(trial, measured, prior) < cost), None)
            if better is None:
                break
            now = better
        return now

    def _predicted(self, z: Array) -> Predicted | None:
        """Prediction at scaled coordinates; None where the model has no strain there."""
        q = self._scale * z
        if not np.isfinite(q).all():
            return None
        try:
            strain, jacobian = self.model.strain_at(q, self.sensors)
        except StrainLimitError:
            return None
        return Predicted(z, strain.ravel(), jacobian.reshape(strain.size, -1) * self._scale)

    def _cost(self, predicted: Predicted, measured: Array, prior: Prior) -> float:
        """The sum of squares, in standard deviations."""
        missed, moved = (measured - predicted.strain) / self._deviation, predicted.z - prior.mean
        return float(missed @ missed + prior.information * moved @ moved)


def _recalled(mean: Array, deviation: float, rest_deviation: float) -> Prior:
    """The product of Gaussians around the mean (n,) and around zero."""
    information, rest = deviation**-2, rest_deviation**-2
    return Prior(information / (information + rest) * mean, information + rest)


def _normal_equations(predicted: Array, measured: Array, jacobian: Array, deviation: Array) -> tuple[Array, Array]:
    """H^T R^-1 H (n, n) and H^T R^-1 (measured - predicted) (n,)."""
    weighted = jacobian / deviation[:, None]
    return weighted.T @ weighted, weighted.T @ ((measured - predicted) / deviation)


def _correction(information: Array, drive: Array, prior: float) -> tuple[Array, float]:
    """The correction (n,) that a drive (n,) asks for, and by how much the cost should fall; zero where they are beyond all numbers."""
    n = len(drive)
    total = information + (prior + ROUND_OFF * np.trace(information)) * np.eye(n)
    if not (np.isfinite(total).all() and np.isfinite(drive).all()):
        return np.zeros(n), 0.0
    step = np.linalg.solve(total, drive)
    fall = float(step @ drive)
    return (step, fall) if np.isfinite(fall) else (np.zeros(n), 0.0)
