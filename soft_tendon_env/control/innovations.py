"""Innovations of the Kalman filter, with Jacobians and variances.

They are what is measured less what the model expects of a state.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.protocol import Measurement, SensorNoise
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.types import Array

# relative model noise added to measured velocities, for the neglected dependence of the Jacobian on
# q
CHANGING = 0.2
LEAST_TIP_DEVIATION = 1e-4
"""Standard deviation of the model's tip as a share of the rod's length, at least."""
TOLERANCES = 4.0
"""Standard deviation of the model's tip in tolerances of its time steps: a preset's tolerance is a
hundredth to a twentieth of the error that it promises in motion."""
TURNS = 10.0
"""Angle [rad] by which the tip is turned where it is off by the rod's length."""
RATE = 10.0
"""[1/s] Standard deviation of the model's tip twist in those of its pose."""
VELOCITIES = ("tip_twist", "strain_rate")  # among the fields of Measurement
RECENT = 0.5
"""[s] over which squares of innovations are averaged."""
FORGOTTEN = 10.0
"""[s] in which a surprise falls to 1 / e: a plan that soon grew bold again would surprise anew."""
MOST_SQUARE = 10.0
"""Greatest mean square of innovations that counts: a push is one or two periods far beyond it."""


class Surprise(NamedTuple):
    """How far innovations exceed what the filter expects, where its model lacks a motion.

    Both are mean squares of innovations in their standard deviations: about 1 where the filter is
    right, less where it expects more noise than there is.
    """

    recent: float = 0.0  # running mean
    lasting: float = 0.0  # greatest of it, slowly forgotten

    def after(self, square: float, period: float) -> "Surprise":
        """Surprise a period [s] later, whose innovations have a mean square."""
        share = -math.expm1(-period / RECENT)
        recent = self.recent + share * (min(square, MOST_SQUARE) - self.recent)
        left = math.exp(-period / FORGOTTEN)
        return Surprise(recent, max(recent, left * self.lasting))


class Layout(NamedTuple):
    """Slices of the filter's state, of m entries."""

    z: slice  # scaled coordinates (n,)
    v: slice  # their rates (n,) [1/s]
    offset: slice  # tensions that are added (n_a,) [N]
    gain: slice  # gains of the tendons (n_a,), less 1
    tip: slice  # twist (6,) from the model's tip to the arm's
    load: slice  # forces in the world frame (3 places,) [N], see force_errors
    stiffness: slice  # (1,) its factor, less 1
    damping: slice  # (1,) likewise
    payload: slice  # (1,) [kg] at the tip, without its weight
    friction: slice  # (1,) coefficient of friction of the tendons
    latency: slice  # (1,) [s]
    lag: slice  # (1,) [s]

    @property
    def size(self) -> int:
        """Number of entries m."""
        return int(self.lag.stop)


def layout_of(model: Model, places: int) -> Layout:
    """Layout of the state of a model's filter, with loads at so many places."""
    n = model.coordinate_count
    n_a = model.tendon_count
    sizes = [n, n, n_a, n_a, 6, 3 * places, 1, 1, 1, 1, 1, 1]
    ends = np.cumsum(sizes).tolist()
    starts = [0, *ends[:-1]]
    return Layout(*map(slice, starts, ends))


def noise_variances(model: Model, noise: SensorNoise, sensors: int) -> dict[str, Array]:
    """Returns the variances of measurements by their fields in Measurement.

    They are those of the sensors, and of what a reduced model does not know. Its errors last for
    many periods, where those of sensors are new in each: as these they count for more, or they
    would be taken for loads. At a point its strains are far less exact than poses and lengths,
    their integrals: in bending the paper's arm at "fast" is off by 0.11 over its length, and its
    tip by 0.0002 of it. In quick motions arms at "fast" are off by up to 0.005 of their length.

    Args:
        model: of the filter.
        noise: standard deviations of the sensors.
        sensors: number of strain sensors.

    Returns:
        Variances, each (k,) or a number for all k entries of the field.
    """
    length = model.length
    tip = _tip_deviation(model)
    tip_twist = np.repeat([tip * TURNS, tip * length], 3)
    # of the sensors, and of the model, by field
    sensor_deviations: dict[str, Any] = {
        "tip_pose": np.repeat([noise.rotation, noise.position], 3),
        "tip_twist": 0.0,
        "tendon_length": noise.length,
        "strain": noise.of_strains(sensors),
        "strain_rate": noise.of_strain_rates(sensors),
    }
    angular_and_linear = [1.0 / length, 1e-2]
    unit_of_sensor = np.repeat(angular_and_linear, 3)
    strain_unit = np.tile(unit_of_sensor, sensors)
    model_deviations: dict[str, Any] = {
        "tip_pose": tip_twist,
        "tip_twist": RATE * tip_twist,
        "tendon_length": tip * length,
        "strain": 0.5 * strain_unit,
        "strain_rate": strain_unit,
    }
    variances = dict[str, Array]()
    for name, deviation in sensor_deviations.items():
        sensor_variance = np.asarray(deviation) ** 2
        model_variance = np.asarray(model_deviations[name]) ** 2
        variances[name] = sensor_variance + model_variance
    return variances


def _tip_deviation(model: Model) -> float:
    """Standard deviation of the model's tip, as a share of the rod's length."""
    tolerance = model.scene.integrator.tolerance
    if tolerance is None:
        return LEAST_TIP_DEVIATION
    return max(LEAST_TIP_DEVIATION, TOLERANCES * tolerance / model.length)


class SensorModel:
    """Expected measurements of the sensors of an arm in a state of the filter.

    Args:
        model: what the filter believes of the arm.
        layout: of the state.
        observed: fields of Measurement that are there, besides the tip's pose.
        sensors: (s,) [m] arc lengths of the strain sensors.
        noise: standard deviations of the sensors.
    """

    def __init__(
        self,
        model: Model,
        layout: Layout,
        observed: tuple[str, ...],
        sensors: Array,
        noise: SensorNoise,
    ) -> None:
        self.model = model
        self.observed = observed
        self.sensors = sensors
        self._layout = layout
        self._scale = model.coordinate_scale()
        self._variance = noise_variances(model, noise, sensors.size)

    def innovations(self, mean: Array, measured: Measurement) -> tuple[Array, Array, Array]:
        """Innovations of a measurement.

        Args:
            mean: state (m,) that is believed, see Layout.
            measured: with all that is observed.

        Returns:
            Innovations (k,), the Jacobian (k, m) of what was expected by the state, and the
            variances (k,) of the noise.
        """
        layout = self._layout
        scale = self._scale
        q = scale * mean[layout.z]
        q_dot = scale * mean[layout.v]
        terms = self.model.terms(q, q_dot, time=measured.time)
        expected = self._expected(q, q_dot, terms)
        # the tip's pose, by coordinates and by the displacement between model and arm
        tip_pose = moved_pose(terms.tip_pose, mean[layout.tip])
        tip_row = np.zeros((6, mean.size))
        tip_row[:, layout.z] = terms.tip_jacobian * scale
        tip_row[:, layout.tip] = np.eye(6)
        innovations = [pose_error(tip_pose, measured.tip_pose)]
        rows = [tip_row]
        variances = [np.broadcast_to(self._variance["tip_pose"], (6,))]
        for name in self.observed:
            value, jacobian = expected[name]
            innovation = (getattr(measured, name) - value).ravel()
            variance = np.broadcast_to(self._variance[name], innovation.shape)
            row = np.zeros((innovation.size, mean.size))
            if name in VELOCITIES:
                row[:, layout.v] = jacobian * scale
                variance = variance + (CHANGING * jacobian @ q_dot) ** 2
            else:
                row[:, layout.z] = jacobian * scale
            innovations.append(innovation)
            rows.append(row)
            variances.append(variance)
        innovation = np.concatenate(innovations)
        slope = np.vstack(rows)
        variance = np.concatenate(variances)
        return innovation, slope, variance

    def _expected(self, q: Array, q_dot: Array, terms: Terms) -> dict[str, tuple[Array, Array]]:
        """Expected measurements besides the tip's pose, with Jacobians (k, n).

        These are by coordinates, of VELOCITIES by their rates.
        """
        if self.sensors.size:
            strain, slopes = self.model.strain_at(q, self.sensors)
            slope = slopes.reshape(-1, q.size)
        else:
            strain = np.zeros((0, 6))
            slope = np.zeros((0, q.size))
        tip = terms.tip_jacobian
        return {
            "tip_twist": (tip @ q_dot, tip),
            "tendon_length": (self.model.tendon_lengths(q), -terms.actuation.T),
            "strain": (strain, slope),
            "strain_rate": ((slope @ q_dot).reshape(-1, 6), slope),
        }
