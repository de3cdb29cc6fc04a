"""Simulated coordinates of recordings: equilibria of still holds, and motions, which begin at rest under their first command.

Equilibria are sought by Newton's method from the last ones that were found for their recordings, so that a fit re-solves each in a few
iterations; only the first ones are followed from the unloaded arm. A command is held until the next sample.
"""

from collections.abc import Sequence

import numpy as np

from soft_tendon_env.identification.plant import Plant
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation, SimulationDiverged, simulate
from soft_tendon_env.model.statics import commanded_equilibrium, static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.types import Array

STILL = 0.005
"""Share of the rod's length within which markers may be at rest: noise."""


class NoHoldError(ValueError):
    """Raised where the arm has no equilibrium for a hold, or its motion cannot be simulated."""


class Simulated:
    """Simulations of recordings, for any plant."""

    def __init__(self, recordings: Sequence[Recording]) -> None:
        self._recordings = recordings
        self._rests: list[Array | None] = [None] * len(recordings)

    def coordinates(self, plant: Plant) -> list[Array]:
        """Coordinates (n,) at every sample of all recordings. Raises NoHoldError."""
        return [q for i, own in enumerate(self._recordings) for q in self._simulated(plant, own, i)]

    def _simulated(self, plant: Plant, own: Recording, i: int) -> list[Array]:
        command, model = plant.command(own.command), plant.model
        try:
            q, tension = _at_rest(model, command[0], self._rests[i], bool(own.period))
            self._rests[i] = q
            if not own.period:
                return [q]
            start = Simulation(model).reset(q, tension=tension)
            return list(simulate(model, command[:-1], own.period * (len(command) - 1), own.period, start).q)
        except (SimulationDiverged, _NotHeld, StrainLimitError) as error:
            if own.period:
                text = f"motion {own.name!r} cannot be simulated: {error}. {rest_text(own, model.length)}"
            else:
                text = f"hold {own.name!r} has no equilibrium: {error}"
            raise NoHoldError(f"{own.where}: {text}") from error


class _NotHeld(Exception):
    """Raised where a command holds the arm nowhere."""


def _at_rest(model: Model, command: Array, guess: Array | None, settle: bool) -> tuple[Array, Array]:
    """Coordinates (n,) at rest under a command (n_a,), and the tensions (n_a,) [N]. Raises _NotHeld, StrainLimitError."""
    if model.command_unit == "N":
        found, tension = static_equilibrium(model, command, guess, settle=settle), command
    else:
        found, tension = commanded_equilibrium(model, command)
    if not found.converged:
        raise _NotHeld(found.reason)
    return found.q, tension


def with_steps(scene: Scene, motions: Sequence[Recording]) -> Scene:
    """The scene with integrator steps of at most the samples' period, in each of which a command may arrive."""
    period = min((own.period for own in motions if own.period), default=np.inf)
    return scene.replace({"integrator.step": period}) if period < scene.integrator.step else scene


def begins_at_rest(motion: Recording, length: float) -> bool:
    """Whether markers of a motion stay under its first command, which is held from rest on, on a rod of a length [m]."""
    return _moved(motion) <= STILL * length


def rest_text(motion: Recording, length: float) -> str:
    """How still a motion is, as sentences that say what to look at."""
    text = f"It should begin at rest under its first command: in the first period markers move {1e3 * _moved(motion):.2g} mm, at rest up to"
    return f"{text} {1e3 * STILL * length:.2g} mm. Samples are {motion.period:.3g} s apart, if the unit of time is right."


def _moved(motion: Recording) -> float:
    """Greatest distance [m] by which markers that are seen move in the first period."""
    return float(np.nan_to_num(np.linalg.norm(motion.positions[1] - motion.positions[0], axis=-1)).max())
