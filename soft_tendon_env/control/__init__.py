"""Model-based controllers and state estimators: protocol.py has their interfaces, catalogue.py all of them by name."""

from soft_tendon_env.control.catalogue import CONTROLLERS, Entry, entry_of
from soft_tendon_env.control.kalman import ExtendedKalmanFilter, Sensing, Uncertainty
from soft_tendon_env.control.protocol import (
    Controller,
    ControllerInput,
    ControllerOutput,
    Estimate,
    Estimator,
    InputError,
    Measurement,
    Reference,
)
from soft_tendon_env.control.sensor_noise import SensorNoise

__all__ = ["CONTROLLERS", "Controller", "ControllerInput", "ControllerOutput", "Entry", "Estimate", "Estimator", "ExtendedKalmanFilter"]
__all__ += ["InputError", "Measurement", "Reference", "Sensing", "SensorNoise", "Uncertainty", "entry_of"]
