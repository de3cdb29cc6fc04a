"""Model-based controllers and state estimators.

protocol.py has their interfaces, catalogue.py all of them by name.
"""

from soft_tendon_env.control.catalogue import CONTROLLERS, Entry, controllers_of
from soft_tendon_env.control.kalman import ExtendedKalmanFilter
from soft_tendon_env.control.protocol import (
    Controller,
    ControllerInput,
    ControllerOutput,
    Estimate,
    InputError,
    Measurement,
    Reference,
)
from soft_tendon_env.control.uncertainty import Setting, Uncertainty

__all__ = [
    "CONTROLLERS",
    "Controller",
    "ControllerInput",
    "ControllerOutput",
    "Entry",
    "Estimate",
    "ExtendedKalmanFilter",
    "InputError",
]
__all__ += ["Measurement", "Reference", "Setting", "Uncertainty", "controllers_of"]
