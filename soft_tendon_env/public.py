"""Public names of the package, once each: what `from soft_tendon_env import NAME` finds."""

from soft_tendon_env.accuracy.fidelity import build_model
from soft_tendon_env.model.inverse_statics import (
    InverseEquilibrium,
    tension_for_tip_pose,
    tension_for_tip_position,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import (
    Linearization,
    NoEquilibriumError,
    Simulation,
    SimulationDiverged,
    StepReport,
    Trajectory,
    simulate,
)
from soft_tendon_env.model.state import State
from soft_tendon_env.model.statics import Equilibrium, commanded_equilibrium, static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.model.terms import Energy, Terms
from soft_tendon_env.scene.file import load_scene, save_scene, scene_names
from soft_tendon_env.scene.parameters import Parameter, scene_parameters
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.registry import register

__all__ = [
    "ConfigurationError",
    "Energy",
    "Equilibrium",
    "InverseEquilibrium",
    "Linearization",
    "Model",
    "NoEquilibriumError",
    "Parameter",
    "Scene",
    "Simulation",
    "SimulationDiverged",
    "State",
    "StepReport",
    "StrainLimitError",
    "Terms",
    "Trajectory",
    "build_model",
    "commanded_equilibrium",
    "load_scene",
    "register",
    "save_scene",
    "scene_names",
    "scene_parameters",
    "simulate",
    "static_equilibrium",
    "tension_for_tip_pose",
    "tension_for_tip_position",
]
