"""Readings of recordings beside those that are simulated: residuals and their derivatives by the parameters."""

import copy
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from soft_tendon_env.identification.plant import Plant, Plants
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.identification.sensed import Sensed
from soft_tendon_env.identification.simulated import Simulated
from soft_tendon_env.identification.split import same_commands
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.types import Array

DIFFERENCE = {"hold": 1e-4, "motion": 1e-3}
"""Changes of a dimensionless coordinate for central differences, whose error is their square: equilibria are exact to 1e-10, steps of
motions to their tolerance."""


class Readings:
    """Readings of recordings in one vector (N,): marker coordinates, of which unseen ones are left out, then what else is sensed."""

    def __init__(self, plants: Plants, recordings: Sequence[Recording]) -> None:
        holds, motions = ([own for own in recordings if bool(own.period) == moves] for moves in (False, True))
        self.plants, self.recordings = plants, [*holds, *motions]
        self._simulated = Simulated(self.recordings)
        self._sensed = Sensed(plants.markers, self.recordings, plants.scene)
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
    def group(self) -> Array:
        """Index (recordings,) that recordings with the same commands share."""
        return same_commands(self.recordings)

    @cached_property
    def cluster(self) -> Array:
        """Index of the recordings with the same commands of each reading (N,), as whose errors are common."""
        of_sample = np.repeat(self.group, [len(own.command) for own in self.recordings])
        placed = np.broadcast_to(of_sample[:, None, None], self.measured.shape)[self.seen]
        return np.concatenate([placed, np.broadcast_to(of_sample[:, None], self._sensed.seen.shape)[self._sensed.seen]])

    def with_plants(self, plants: Plants) -> "Readings":
        """Readings of the same recordings by other plants, whose equilibria are sought from these on."""
        found = copy.copy(self)
        found.plants = plants
        return found

    def positions(self, x: Array) -> Array:
        """Simulated positions (samples, m, 3) [m] at coordinates x (k,). Raises NoHoldError, ConfigurationError."""
        plant = self.plants.at(x)
        return plant.positions(self._poses(plant, self.coordinates(plant)))

    def coordinates(self, plant: Plant) -> list[Array]:
        """Simulated coordinates (n,) at every sample. Raises NoHoldError."""
        with erring_actuators():  # by the gains and offsets that are looked for
            return self._simulated.coordinates(plant)

    def _poses(self, plant: Plant, coordinates: Sequence[Array]) -> Array:
        """Poses (samples, m, 4, 4) of the markers' sections from the base."""
        return np.array([plant.model.backbone_at(q, self.plants.markers.arc_lengths) for q in coordinates])

    def residual(self, x: Array) -> Array:
        """Simulated less measured readings (N,) [m]; what else is sensed as positions that weigh as much. Raises as `positions`."""
        plant = self.plants.at(x)
        coordinates = self.coordinates(plant)
        return self._residual(plant, coordinates, self._poses(plant, coordinates))

    def _residual(self, plant: Plant, coordinates: Sequence[Array], poses: Array) -> Array:
        """The residual (N,) of simulated coordinates, and poses of the markers' sections."""
        placed = (plant.positions(poses) - self.measured)[self.seen]
        return np.concatenate([placed, self._sensed.residual(plant, coordinates, poses)])

    def jacobian(self, x: Array) -> Array:
        """Derivatives (N, k) [m] of the readings by the coordinates, by central differences within the bounds. Raises as `positions`."""
        columns, plant = [], self.plants.at(x)
        still = self.coordinates(plant)
        still_poses = self._poses(plant, still)
        for i, parameter in enumerate(self.plants.parameters):
            low, high = parameter.bounds
            ends = np.clip([x[i] - self._difference, x[i] + self._difference], low, high)
            found = []
            for end in ends:
                at = x.copy()
                at[i] = end
                plant = self.plants.at(at)
                moved = self.coordinates(plant) if self.plants.is_of_model(i) else still
                found.append(self._residual(plant, moved, still_poses if moved is still else self._poses(plant, moved)))
            columns.append((found[1] - found[0]) / (ends[1] - ends[0]))
        return np.stack(columns, axis=-1)

    def errors(self, x: Array) -> Array:
        """Mean distance [m] of the seen markers from where they are simulated, of each recording (recordings,), NaN
        without any. Raises as `positions`."""
        if not self.recordings:
            return np.zeros(0)
        distance = np.linalg.norm(self.positions(x) - self.measured, axis=-1)
        ends = np.cumsum([len(own.command) for own in self.recordings])[:-1]
        return np.array([mean_of_finite(own) for own in np.split(distance, ends)])


def mean_of_finite(values: Array) -> float:
    """Mean of the values that are there, NaN without any."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if there.size else np.nan
