"""Readings of recordings beside those that are simulated: residuals and their derivatives by the parameters."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from soft_tendon_env.identification.motions import Motions
from soft_tendon_env.identification.plant import Plant, Plants
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.statics import Statics
from soft_tendon_env.tools.types import Array

DIFFERENCE = {"hold": 1e-4, "motion": 1e-3}
"""Changes of a dimensionless coordinate for central differences, whose error is their square: equilibria are exact to 1e-10, steps of
motions to their tolerance."""


class Readings:
    """Marker coordinates of recordings in one vector (N,), of which unseen ones are left out."""

    def __init__(self, plants: Plants, recordings: Sequence[Recording]) -> None:
        holds, motions = ([own for own in recordings if bool(own.period) == moves] for moves in (False, True))
        self.plants, self.recordings = plants, [*holds, *motions]
        self._statics, self._motions = Statics(holds), Motions(motions)
        self._difference = DIFFERENCE["motion" if motions else "hold"]

    @cached_property
    def measured(self) -> Array:
        """Measured positions (samples of all recordings, m, 3) [m], NaN where a marker was not seen."""
        return np.concatenate([own.positions for own in self.recordings])

    @cached_property
    def seen(self) -> Array:
        """Which of the measured coordinates (samples, m, 3) are there."""
        return np.isfinite(self.measured)

    @cached_property
    def recording(self) -> Array:
        """Index of the recording of each reading (N,)."""
        of_sample = np.repeat(np.arange(len(self.recordings)), [len(own.command) for own in self.recordings])
        return np.broadcast_to(of_sample[:, None, None], self.measured.shape)[self.seen]

    def positions(self, x: Array) -> Array:
        """Simulated positions (samples, m, 3) [m] at coordinates x (k,). Raises NoHoldError, ConfigurationError."""
        plant = self.plants.at(x)
        return plant.positions(self._poses(plant))

    def coordinates(self, plant: Plant) -> list[Array]:
        """Simulated coordinates (n,) at every sample. Raises NoHoldError."""
        return self._statics.coordinates(plant) + self._motions.coordinates(plant)

    def _poses(self, plant: Plant) -> Array:
        """Poses (samples, m, 4, 4) of the markers' sections from the base."""
        places = plant.model, self.plants.markers.arc_lengths
        return np.array([places[0].backbone_at(q, places[1]) for q in self.coordinates(plant)])

    def residual(self, x: Array) -> Array:
        """Simulated less measured readings (N,) [m]. Raises as `positions`."""
        return np.asarray((self.positions(x) - self.measured)[self.seen])

    def jacobian(self, x: Array) -> Array:
        """Derivatives (N, k) [m] of the readings by the coordinates, by central differences within the bounds. Raises as `positions`."""
        columns, still = [], self._poses(self.plants.at(x))
        for i, parameter in enumerate(self.plants.parameters):
            low, high = parameter.bounds
            ends = np.clip([x[i] - self._difference, x[i] + self._difference], low, high)
            found = []
            for end in ends:
                at = x.copy()
                at[i] = end
                plant = self.plants.at(at)
                found.append(plant.positions(self._poses(plant) if self.plants.is_of_model(i) else still))
            columns.append(((found[1] - found[0]) / (ends[1] - ends[0]))[self.seen])
        return np.stack(columns, axis=-1)

    def errors(self, x: Array) -> Array:
        """Mean distance [m] of the seen markers from where they are simulated, of each recording (recordings,). Raises as `positions`."""
        if not self.recordings:
            return np.zeros(0)
        distance = np.linalg.norm(self.positions(x) - self.measured, axis=-1)
        ends = np.cumsum([len(own.command) for own in self.recordings])[:-1]
        return np.array([float(np.nanmean(own)) for own in np.split(distance, ends)])
