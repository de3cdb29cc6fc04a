"""Sensor noise: standard deviations of white Gaussian noise, for the environments that add it and the estimators that know of it."""

from typing import Annotated

import numpy as np
from pydantic import Field

from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.types import Array

Deviation = Annotated[float, Field(ge=0, le=1e6)]


class SensorNoise(Configuration):
    """Standard deviations of Gaussian noise on what is observed; rewards and errors are the true ones."""

    position: Deviation = 0.0  # [m] of the tip
    rotation: Deviation = 0.0  # [rad] of the tip
    length: Deviation = 0.0  # [m] of tendons
    curvature: Deviation = 0.0  # [1/m] torsion and bending at strain sensors
    stretch: Deviation = 0.0  # [-] stretch and shear there
    curvature_rate: Deviation = 0.0  # [1/(m s)]
    stretch_rate: Deviation = 0.0  # [1/s]

    def of_strains(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the strains at so many sensors."""
        return np.tile(np.repeat([self.curvature, self.stretch], 3), sensors)

    def of_strain_rates(self, sensors: int) -> Array:
        """Deviations (6 sensors,) of the rates of those strains."""
        return np.tile(np.repeat([self.curvature_rate, self.stretch_rate], 3), sensors)
