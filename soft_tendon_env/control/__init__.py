"""Model-based controllers and state estimators: protocol.py has their interfaces, catalogue.py all of them by name."""

from soft_tendon_env.control.catalogue import CONTROLLERS, Entry, register_controller
from soft_tendon_env.control.kalman import ExtendedKalmanFilter, Uncertainty
from soft_tendon_env.control.kalman_measurement import MeasurementNoise, Sensing
from soft_tendon_env.control.protocol import Controller, Decision, Estimate, Estimator, InputError, Measurement, Reference, Situation
from soft_tendon_env.control.sensor_noise import SensorNoise

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
    "MeasurementNoise",
    "Sensing",
    "SensorNoise",
    "Situation",
    "Uncertainty",
    "Reference",
    "register_controller",
]
