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
