"""Simulated coordinates of recorded motions, which begin at rest under their first command.

A command is held until the next sample; before the first one the first command was held.
"""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.plant import Plant
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.sampling import moved
from soft_tendon_env.identification.statics import NoHoldError
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import NoEquilibriumError, Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.state import State
from soft_tendon_env.model.statics import commanded_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

STILL = 0.005
"""Share of the rod's length within which markers may be at rest: noise."""


class Motions:
    """Simulations of motions, for any plant."""

    def __init__(self, motions: Sequence[Recording]) -> None:
        self.motions = motions

    def coordinates(self, plant: Plant) -> list[Array]:
        """Coordinates (n,) at every sample of all motions. Raises NoHoldError."""
        return [q for motion in self.motions for q in self._motion(plant, motion)]

    def _motion(self, plant: Plant, motion: Recording) -> Array:
        command = plant.command(motion.command)
        duration = motion.period * (len(command) - 1)
        try:
            start = _at_rest(plant.model, command[0])
            return simulate(plant.model, command[:-1], duration, motion.period, start).q
        except (SimulationDiverged, NoEquilibriumError, StrainLimitError) as error:
            text = f"{motion.where}: motion {motion.name!r} cannot be simulated: {error}. {rest_text(motion, plant.model.length)}"
            raise NoHoldError(text) from error


def with_steps(scene: Scene, motions: Sequence[Recording]) -> Scene:
    """The scene with integrator steps of at most the samples' period, in each of which a command may arrive."""
    period = min((own.period for own in motions if own.period), default=np.inf)
    return scene.replace({"integrator.step": period}) if period < scene.integrator.step else scene


def begins_at_rest(motion: Recording, length: float) -> bool:
    """Whether markers of a motion stay under its first command, which is held from rest on, on a rod of a length [m]."""
    return moved(*motion.positions[:2]) <= STILL * length


def rest_text(motion: Recording, length: float) -> str:
    """How still a motion is, as sentences that say what to look at."""
    first = 1e3 * moved(*motion.positions[:2])
    text = f"It should begin at rest under its first command: in the first period markers move {first:.2g} mm, at rest up to"
    return f"{text} {1e3 * STILL * length:.2g} mm. Samples are {motion.period:.3g} s apart, if the unit of time is right."


def _at_rest(model: Model, command: Array) -> State:
    """State at rest under a command (n_a,). Raises NoEquilibriumError."""
    simulation = Simulation(model)
    if model.command_unit == "N":
        return simulation.reset_at_rest(command)
    found, tension = commanded_equilibrium(model, command)
    if not found.converged:
        raise NoEquilibriumError(model.scene.name, tension, found.reason)
    return simulation.reset(found.q, tension=tension)
