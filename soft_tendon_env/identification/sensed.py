"""Measurements besides the positions of markers, where markers.toml names them: their orientations, tendon lengths, strains at sensors.

Columns of a recording: `NAME_qw`, `NAME_qx`, `NAME_qy`, `NAME_qz`, the section's frame in that of the data as a unit quaternion;
`tendon_length_0` [m]; `strain_0_torsion`, `_bend_y`, `_bend_z` [1/m], `_stretch`, `_shear_y`, `_shear_z`. Lengths and strains may count
from any zero, which is found with the parameters. All of them weigh against positions as their usual noise does, see policies.regimes, on
a rod of 1 m; on others with lengths in proportion.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.identification.markers import MarkerSet
from soft_tendon_env.identification.plant import Plant, base_rotation
from soft_tendon_env.identification.recordings import Recording
from soft_tendon_env.policies.regimes import NOISE
from soft_tendon_env.scene.scene import Scene, rod_length
from soft_tendon_env.tools.types import Array


class Sensed:
    """Residuals of what is measured besides positions, for any plant. seen (samples, k): which of the numbers of a sample are there."""

    def __init__(self, markers: MarkerSet, recordings: Sequence[Recording], scene: Scene) -> None:
        tendons, length = len(scene.tendons), rod_length(scene)
        self._markers = markers
        columns = len(markers.sensed(tendons))
        given = [own.sensed if own.sensed is not None else np.full((len(own.command), columns), np.nan) for own in recordings]
        measured = np.concatenate([np.zeros((0, columns)), *given])
        self._oriented = [i for i, marker in enumerate(markers.markers.values()) if marker.orientation]
        ends = 4 * len(self._oriented)
        quaternions, self._measured = measured[:, :ends].reshape(len(measured), len(self._oriented), 4), measured[:, ends:]
        self._turned = np.isfinite(quaternions).all(axis=2)
        whole = np.where(self._turned[..., None], quaternions, [1.0, 0.0, 0.0, 0.0]).reshape(-1, 4)
        turned = Rotation.from_quat(whole, scalar_first=True).as_matrix() if whole.size else np.zeros((0, 3, 3))
        self._rotation = (markers.frame.matrix[:3, :3] @ turned).reshape(*self._turned.shape, 3, 3)
        self.seen = np.hstack([np.repeat(self._turned, 3, axis=1), np.isfinite(self._measured)])
        noise = SensorNoise(**{**NOISE, "length": length * NOISE["length"], "curvature": NOISE["curvature"] / length})
        usual = [np.full(3 * len(self._oriented), noise.rotation), np.full(tendons * markers.sensors.tendon_lengths, noise.length)]
        self._metres = length * noise.position / np.concatenate([*usual, noise.of_strains(len(markers.sensors.strain))])

    def residual(self, plant: Plant, coordinates: Sequence[Array], poses: Array) -> Array:
        """Simulated less measured numbers that are there, in metres of a position that weighs as much. poses (samples, m, 4, 4): of the
        markers' sections from the base."""
        samples = len(self.seen)
        if not self.seen.size:
            return np.zeros(0)
        turned = base_rotation(plant.measurement.rotation) @ poses[:, self._oriented, :3, :3]
        away = (self._rotation.swapaxes(-1, -2) @ turned).reshape(-1, 3, 3)
        rotations = (Rotation.from_matrix(away).as_rotvec() if away.size else away).reshape(samples, 3 * len(self._oriented))
        others = np.array([self._simulated(plant, q) for q in coordinates]) - self._measured
        others = others - [np.mean(own[np.isfinite(own)]) if np.isfinite(own).any() else 0.0 for own in others.T]
        found = np.hstack([rotations, others]) * self._metres
        return np.asarray(found[self.seen])

    def _simulated(self, plant: Plant, q: Array) -> Array:
        """Tendon lengths and strains, those that are measured, at coordinates (n,)."""
        sensors = self._markers.sensors
        lengths = plant.model.tendon_lengths(q) if sensors.tendon_lengths else np.zeros(0)
        strains = plant.model.strain_at(q, np.array(sensors.strain))[0].ravel() if sensors.strain else np.zeros(0)
        return np.concatenate([lengths, strains])
