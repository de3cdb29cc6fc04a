"""Model-based controllers and state estimators.

protocol.py has their interfaces, catalogue.py all of them by name.
"""

from soft_tendon_env.control.avoidance import Avoidance
from soft_tendon_env.control.catalogue import CONTROLLERS, Entry, controllers_of
from soft_tendon_env.control.diagnosis import Diagnosis, Quantity
from soft_tendon_env.control.kalman import ExtendedKalmanFilter
from soft_tendon_env.control.objectives import (
    LinearError,
    Objective,
    Posture,
    Shape,
    TipDirection,
    TipPose,
    TipPosition,
)
from soft_tendon_env.control.own_cost import Effort, Smoothness
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
    "Avoidance",
    "Controller",
    "ControllerInput",
    "ControllerOutput",
    "Diagnosis",
    "Effort",
    "Entry",
    "Estimate",
    "ExtendedKalmanFilter",
    "InputError",
    "LinearError",
    "Measurement",
    "Objective",
    "Posture",
]
__all__ += [
    "Quantity",
    "Reference",
    "Setting",
    "Shape",
    "Smoothness",
    "TipDirection",
    "TipPose",
    "TipPosition",
    "Uncertainty",
    "controllers_of",
]
