"""Sensor noise: Gaussian, on tip poses, tendon lengths and strains, drawn per row in chunks."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.mechanics.motion.pose_errors import perturb_poses
from soft_tendon_env.tools.types import Array

CHUNK = 128
"""Samples of noise drawn at a time."""


class Measured(NamedTuple):
    """Sensor readings of every row, noise and all; see Reading."""

    tip_pose: Array  # (rows, 4, 4)
    tendon_length: Array  # (rows, n_a) [m]
    strain: Array  # (rows, sensors, 6)
    strain_rate: Array  # (rows, sensors, 6)


class Sensors:
    """Rows of noisy sensors."""

    def __init__(self, noise: SensorNoise, rows: int, tendons: int, sensors: int) -> None:
        self._deviation = np.concatenate(
            [
                np.repeat([noise.position, noise.rotation], 3),
                np.full(tendons, noise.length),
                noise.of_strains(sensors),
                noise.of_strain_rates(sensors),
            ]
        )
        ends = np.cumsum([3, 3, tendons, 6 * sensors, 6 * sensors]).tolist()
        self._parts = [slice(start, end) for start, end in pairwise([0, *ends])]
        self._noise = np.zeros((rows, CHUNK, self._deviation.size))
        self._generator = [np.random.default_rng(0) for _ in range(rows)]

    def begin(self, row: int, seed: int) -> None:
        """A new episode of a row."""
        self._generator[row] = np.random.default_rng(seed)

    def measured(self, reading: Reading, step_count: Indices, members: Indices) -> Measured:
        """Sensor readings of true ones; `members` have moved on."""
        for row in members[step_count[members] % CHUNK == 0]:
            self._noise[row] = self._generator[row].standard_normal(self._noise.shape[1:]) * self._deviation
        noise = self._noise[np.arange(len(step_count)), step_count % CHUNK]
        position, rotation, length, strain, rate = (noise[:, part] for part in self._parts)
        pose = np.empty_like(reading.tip_pose)
        perturb_poses(reading.tip_pose, rotation.copy(), position.copy(), pose)
        return Measured(
            tip_pose=pose,
            tendon_length=reading.tendon_length + length,
            strain=reading.strain + strain.reshape(reading.strain.shape),
            strain_rate=reading.strain_rate + rate.reshape(reading.strain_rate.shape),
        )
