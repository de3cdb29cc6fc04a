"""Model-based controllers and state estimators: protocol.py has their interfaces, catalogue.py all of them by name."""

from soft_tendon_env.control.catalogue import CONTROLLERS, Entry, register_controller
from soft_tendon_env.control.estimation import StrainEstimator, StrainNoise
from soft_tendon_env.control.kalman import ExtendedKalmanFilter, SensorNoise, Uncertainty
from soft_tendon_env.control.protocol import Controller, Decision, Estimate, Estimator, InputError, Measurement, Reference, Situation

__all__ = [
    "CONTROLLERS",
    "Controller",
    "Decision",
    "Entry",
    "Estimate",
    "Estimator",
    "ExtendedKalmanFilter",
    "InputError",
    "Measurement",
    "SensorNoise",
    "Situation",
    "StrainEstimator",
    "StrainNoise",
    "Uncertainty",
    "register_controller",
    "Reference",
]
