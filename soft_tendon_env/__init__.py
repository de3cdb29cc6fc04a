"""Tendon-driven soft arms: statics-based reduced dynamics of a Cosserat rod.

Public names stand here, once each; see README.md for a first example.
"""

from soft_tendon_env.configuration import ConfigurationError
from soft_tendon_env.inverse_statics import InverseEquilibrium, tension_for_tip_pose, tension_for_tip_position
from soft_tendon_env.model import Energy, Model, StrainLimitError, Terms, build_model
from soft_tendon_env.registration import register_environments
from soft_tendon_env.scene import Scene
from soft_tendon_env.scene_file import load_scene, save_scene, scene_names
from soft_tendon_env.simulation import Simulation, SimulationDiverged, State, StepReport, Trajectory, simulate
from soft_tendon_env.statics import Equilibrium, static_equilibrium, static_stiffness

register_environments()

__all__ = [
    "ConfigurationError",
    "Energy",
    "Equilibrium",
    "InverseEquilibrium",
    "Model",
    "Scene",
    "Simulation",
    "SimulationDiverged",
    "State",
    "StepReport",
    "StrainLimitError",
    "Terms",
    "Trajectory",
    "build_model",
    "load_scene",
    "save_scene",
    "scene_names",
    "simulate",
    "static_equilibrium",
    "static_stiffness",
    "tension_for_tip_pose",
    "tension_for_tip_position",
]
