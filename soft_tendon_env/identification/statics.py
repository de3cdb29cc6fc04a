"""Simulated coordinates of still holds: static equilibria that are followed along the data.

An equilibrium begins with Newton's method from the last one that was found for its hold, so that a fit re-solves each of them in a few
iterations; only the first ones are followed from the unloaded arm.
"""

from collections.abc import Sequence

from soft_tendon_env.identification.plant import Plant
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import commanded_equilibrium, static_equilibrium
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.tools.types import Array


class NoHoldError(ValueError):
    """Raised where the arm has no equilibrium for a hold, or its motion cannot be simulated."""


class Statics:
    """Equilibria of holds, for any plant."""

    def __init__(self, holds: Sequence[Recording]) -> None:
        self.holds = holds
        self._guesses: list[Array | None] = [None] * len(holds)

    def coordinates(self, plant: Plant) -> list[Array]:
        """Coordinates (n,) of every hold. Raises NoHoldError."""
        return [self._rest(plant.model, i, plant.command(hold.command[0])) for i, hold in enumerate(self.holds)]

    def _rest(self, model: Model, i: int, command: Array) -> Array:
        """Coordinates (n,) of a hold's equilibrium."""
        try:
            if model.command_unit == "N":
                found = static_equilibrium(model, command, self._guesses[i])
            else:
                found, _ = commanded_equilibrium(model, command)
        except StrainLimitError as error:
            raise NoHoldError(f"{self.holds[i].where}: hold {self.holds[i].name!r} has no equilibrium: {error}") from error
        if not found.converged:
            raise NoHoldError(f"{self.holds[i].where}: hold {self.holds[i].name!r} has no equilibrium: {found.reason}")
        self._guesses[i] = found.q
        return found.q
