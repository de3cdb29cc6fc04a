"""Sensor noise: standard deviations of white Gaussian noise, for the environments that add it and the estimators that know of it."""

from typing import Annotated

import numpy as np
from pydantic import Field

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array

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
