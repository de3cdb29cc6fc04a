"""Measurement model of the extended Kalman filter: innovations, their Jacobian and the variances of their noise."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.control.protocol import Measurement
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.control.sensor_noise import SensorNoise
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.types import Array

CHANGING = 0.05
"""Relative model noise added to measured velocities, for the neglected dependence of the Jacobian on q."""
MEASURED = "tip_twist", "tendon_length", "strain", "strain_rate", "q", "q_dot"
"""Fields of Measurement that the filter makes use of where they are measured, besides the tip's pose."""
VELOCITIES = "tip_twist", "strain_rate", "q_dot"
"""Velocities among MEASURED."""
EXACT = SensorNoise()


class Sensing(NamedTuple):
    """Measured quantities of an arm, besides the tip's pose.

    uses: names of MEASURED. sensors: arc lengths (s,) [m] of the strain sensors, if strains or their rates are used. noise: of the
    sensors.
    """

    uses: tuple[str, ...]
    sensors: ArrayLike = ()
    noise: SensorNoise = EXACT


class Layout(NamedTuple):
    """Slices of the filter's state, of m = 2 n + 2 n_a + 7 entries."""

    z: slice  # scaled coordinates (n,)
    v: slice  # their rates (n,) [1/s]
    offset: slice  # tensions that are added (n_a,) [N]
    gain: slice  # gains of the tendons (n_a,), less 1
    tip: slice  # twist (6,) from the model's tip to the arm's
    latency: slice  # (1,) [s]


def noise_variances(model: Model, noise: SensorNoise, sensors: int) -> dict[str, Array]:
    """Variances of measurements by their fields in Measurement: those of the sensors, and of what a reduced model does not know."""
    told: dict[str, Array | float] = {"tip_pose": np.repeat([noise.rotation, noise.position], 3), "tendon_length": noise.length}
    told |= {"strain": noise.of_strains(sensors), "strain_rate": noise.of_strain_rates(sensors)}
    length, inside = model.length, np.repeat([1.0 / model.length, 1e-2], 3)
    own: dict[str, Array | float] = {
        "tip_pose": np.repeat([1e-3, 1e-4 * length], 3),
        "tip_twist": np.repeat([1e-2, 1e-3 * length], 3),
        "tendon_length": 1e-4 * length,
        "strain": np.tile(2e-2 * inside, sensors),
        "strain_rate": np.tile(0.2 * inside, sensors),
        "q": 1e-4,
        "q_dot": 1e-3,
    }
    return {name: np.asarray(told.get(name, 0.0)) ** 2 + np.asarray(value) ** 2 for name, value in own.items()}


class MeasurementModel:
    """Expected measurements of a model's arm. Raises TypeError, ValueError for a bad `sensing`."""

    def __init__(self, model: Model, sensing: Sensing) -> None:
        n, tendons, self.model, self.uses = model.coordinate_count, model.tendon_count, model, tuple(sensing.uses)
        borders = np.cumsum([0, n, n, tendons, tendons, 6, 1]).tolist()
        self.layout = Layout(*map(slice, borders[:-1], borders[1:]))
        if unknown := [name for name in self.uses if name not in MEASURED]:
            raise ValueError(f"uses names {unknown[0]!r}: it should be of {', '.join(MEASURED)}")
        self.sensors = checked_array("sensors", sensing.sensors, (None,))
        rest = np.zeros(n)
        self._scale, self._rest_lengths = model.coordinate_scale(), model.tendon_lengths(rest)
        self._stress_free = model.strain_at(rest, self.sensors)[0]
        self._variance = noise_variances(model, sensing.noise, self.sensors.size)

    def compared(self, mean: Array, measured: Measurement) -> tuple[Array, Array, Array]:
        """Innovations (k,), the Jacobian (k, m) of what was expected of the state `mean` (m,), and the variances (k,) of the noise."""
        at, scale = self.layout, self._scale
        q_dot = scale * mean[at.v]
        told = self._innovations(scale * mean[at.z], q_dot, mean[at.tip], measured)
        missed, rows, variances = [], [], []
        for name in ("tip_pose", *self.uses):
            innovation, jacobian = told[name]
            row, variance = np.zeros((innovation.size, mean.size)), np.broadcast_to(self._variance[name], innovation.shape)
            row[:, at.v if name in VELOCITIES else at.z] = jacobian * scale
            if name in VELOCITIES:
                variance = variance + (CHANGING * jacobian @ q_dot) ** 2
            if name == "tip_pose":
                row[:, at.tip] = np.eye(6)
            missed.append(innovation)
            rows.append(row)
            variances.append(variance)
        return np.concatenate(missed), np.vstack(rows), np.concatenate(variances)

    def _innovations(self, q: Array, q_dot: Array, tip: Array, measured: Measurement) -> dict[str, tuple[Array, Array]]:
        """Each quantity as measured less as expected (k,), and its Jacobian (k, n) by coordinates, of VELOCITIES by their rates."""
        terms, scale = self.model.terms(q, q_dot, time=measured.time), self._scale
        strain, slope = self.model.strain_at(q, self.sensors) if self.sensors.size else (np.zeros((0, 6)), np.zeros((0, 6, q.size)))
        slope, J = slope.reshape(-1, q.size), terms.tip_jacobian
        told = {"tip_pose": (pose_error(moved_pose(terms.tip_pose, tip), measured.tip_pose), J)}
        if measured.tip_twist is not None:
            told["tip_twist"] = measured.tip_twist - J @ q_dot, J
        if measured.tendon_length is not None:
            told["tendon_length"] = measured.tendon_length - self.model.tendon_lengths(q) + self._rest_lengths, -terms.actuation.T
        if measured.strain is not None:
            told["strain"] = (measured.strain - strain + self._stress_free).ravel(), slope
        if measured.strain_rate is not None:
            told["strain_rate"] = measured.strain_rate.ravel() - slope @ q_dot, slope
        if measured.q is not None:
            told["q"] = (measured.q - q) / scale, np.diag(1.0 / scale)
        if measured.q_dot is not None:
            told["q_dot"] = (measured.q_dot - q_dot) / scale, np.diag(1.0 / scale)
        return told
