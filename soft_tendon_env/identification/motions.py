"""Simulated coordinates of recorded motions, which begin at rest under their first command.

A command is held until the next sample; before the first one the first command was held.
"""

from collections.abc import Sequence

from soft_tendon_env.identification.plant import Plant
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.statics import NoHoldError
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import NoEquilibriumError, Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.state import State
from soft_tendon_env.model.statics import commanded_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.types import Array


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
            raise NoHoldError(f"{motion.where}: motion {motion.name!r} cannot be simulated: {error}") from error


def _at_rest(model: Model, command: Array) -> State:
    """State at rest under a command (n_a,). Raises NoEquilibriumError."""
    simulation = Simulation(model)
    if model.command_unit == "N":
        return simulation.reset_at_rest(command)
    found, tension = commanded_equilibrium(model, command)
    if not found.converged:
        raise NoEquilibriumError(model.scene.name, tension, found.reason)
    return simulation.reset(found.q, tension=tension)
