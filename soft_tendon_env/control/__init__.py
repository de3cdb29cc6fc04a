"""Controllers that know a model: see protocol.py, and catalogue.py for all of them."""

from soft_tendon_env.control.catalogue import CONTROLLERS, Entry
from soft_tendon_env.control.estimation import StrainEstimator, StrainNoise
from soft_tendon_env.control.protocol import Controller, Decision, Estimate, Estimator, Situation, Target

__all__ = [
    "CONTROLLERS",
    "Controller",
    "Decision",
    "Entry",
    "Estimate",
    "Estimator",
    "Situation",
    "StrainEstimator",
    "StrainNoise",
    "Target",
]
