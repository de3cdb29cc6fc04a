"""Measurements of an arm as rows of numbers, and derivatives of such rows as body twists, lengths and strains."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion.batch import Places, Reading
from soft_tendon_env.tools.types import Array


class Measurements(NamedTuple):
    """Measurements of an arm, with a leading axis where there are several configurations.

    As derivatives by m numbers they have these as their last axis, and poses are body twists: (6, m) and (stations, 6, m), angular before
    linear, in the section's own frame [rad, m].
    """

    tip_pose: Array  # (4, 4)
    stations: Array  # (stations, 4, 4) poses
    tendon_length: Array  # (n_a,) [m]
    strain: Array  # (sensors, 6)

    def first(self) -> "Measurements":
        """Those of the first configuration."""
        return Measurements(*(values[0] for values in self))


def rows_of(reading: Reading) -> Array:
    """Rows of numbers (rows, numbers) of what was read: tip pose, poses at stations, tendon lengths, strains."""
    parts = reading.tip_pose, reading.backbone, reading.tendon_length, reading.strain
    return np.hstack([part.reshape(len(part), part[0].size) for part in parts])


def measurements_of(rows: Array, places: Places) -> Measurements:
    """Measurements of rows (rows, numbers, ..) as `rows_of` makes them; the axes behind stay."""
    stations, sensors = places.station.size, places.sensor.size
    tips, poses, lengths, strains = np.split(rows, [16, 16 * (1 + stations), rows.shape[1] - 6 * sensors], axis=1)
    count, tail = len(rows), rows.shape[2:]
    return Measurements(
        tips.reshape(count, 4, 4, *tail), poses.reshape(count, stations, 4, 4, *tail), lengths, strains.reshape(count, sensors, 6, *tail)
    )


def derivatives_of(rows: Array, slopes: Array, places: Places) -> Measurements:
    """Measurements' derivatives, of derivatives (rows, numbers, m) of the rows (rows, numbers)."""
    at, moved = measurements_of(rows, places), measurements_of(slopes, places)
    return moved._replace(tip_pose=_twists(at.tip_pose, moved.tip_pose), stations=_twists(at.stations, moved.stations))


def _twists(poses: Array, derivatives: Array) -> Array:
    """Body twists (.., 6, m) of poses (.., 4, 4) with derivatives (.., 4, 4, m)."""
    turned = np.einsum("...ji,...jkm->...ikm", poses[..., :3, :3], derivatives[..., :3, :, :])
    return np.stack([turned[..., 2, 1, :], turned[..., 0, 2, :], turned[..., 1, 0, :], *np.moveaxis(turned[..., 3, :], -2, 0)], axis=-2)
