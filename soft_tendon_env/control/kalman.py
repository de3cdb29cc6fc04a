"""Extended Kalman filter on the reduced model: the state of an arm from whatever is measured of it,
with offsets and gains of its inputs.

The motion is predicted by the model's own simulation, its covariance by the Jacobians that come
with it. The filter also estimates what the model has wrong, as slow random walks: a tension that is
added (offset-free control, Pannocchia and Rawlings, AIChE J. 49, 2003), a gain of every tendon, the
displacement between the model's tip and the measured one, and the latency of the commands, if it is
not known.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.control.protocol import (
    FAILURES,
    Estimate,
    InputError,
    Measurement,
    SensorNoise,
)
from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.control.smith_predictor import whole_periods
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.types import Array

IMPLAUSIBLE = 1e3  # scaled coordinates or rates, beyond which a filter begins anew
SURPRISE = 4.0
"""Mean square of the innovations, in their standard deviations, above which the forces that the
model lacks are taken for greater."""
GAINS = 0.5, 2.0  # least and greatest of a tendon
# relative model noise added to measured velocities, for the neglected dependence of the Jacobian on
# q
CHANGING = 0.05
VELOCITIES = "tip_twist", "strain_rate"  # among the fields of Measurement


class Layout(NamedTuple):
    """Slices of the filter's state, of m = 2 n + 2 n_a + 7 entries."""

    z: slice  # scaled coordinates (n,)
    v: slice  # their rates (n,) [1/s]
    offset: slice  # tensions that are added (n_a,) [N]
    gain: slice  # gains of the tendons (n_a,), less 1
    tip: slice  # twist (6,) from the model's tip to the arm's
    latency: slice  # (1,) [s]


class Uncertainty(NamedTuple):
    """Standard deviations of the model's errors: at the beginning, and of their change in 1 s,
    unless said otherwise.

    Tensions are in units of those of a single tendon that bend the arm by 1 rad.
    """

    # white generalised forces, held over a period each, as a share of those that bend the arm by 1
    # rad
    force: float = 1.5e-3
    tension: float = 2e-3  # white tensions, held over a period each
    # more white tensions, as a share of the change of commands that may arrive in a period of
    # uncertain latency
    timing: float = 1.0
    offset: float = 0.02  # tensions that are added
    offset_start: float = 0.01
    offset_time: float = 5.0  # [s] in which they are forgotten
    gain: float = 0.025  # gains of the tendons
    gain_start: float = 0.03
    gain_time: float = 30.0  # [s] in which they are forgotten
    # displacement of the tip, as a share of the rod's length; a radian counts as this length
    tip: float = 1.5e-3
    tip_start: float = 2e-3
    latency: float = 5e-4  # [s]
    latency_start: float = 8e-3
    state_start: float = (
        1e-2  # coordinates, in units of `coordinate_scale`; their rates ten times that
    )


USUAL = Uncertainty()


class Setting(NamedTuple):
    """Sensors and actuators of an estimator, besides its assumed model."""

    period: float  # [s] from one estimate to the next
    tension: ArrayLike  # (n_a,) [N] that hold the arm when an episode begins
    observed: tuple[str, ...]  # fields of Measurement that are there, besides the tip's pose
    # (s,) [m] arc lengths of the strain sensors, if strains or their rates are observed
    sensors: ArrayLike = ()
    noise: SensorNoise = SensorNoise()
    latency: float = 0.0  # [s] of commands, or the first estimate of it
    uncertainty: Uncertainty = USUAL


class Belief(NamedTuple):
    """Mean and covariance of a filter, and the internal states of the effects."""

    mean: Array  # (m,), see Layout
    covariance: Array  # (m, m)
    # (2 n, 2 n) what unknown forces of the last period have added to that of coordinates and rates
    noise: Array
    effects: Array  # internal states of the model's effects


def noise_variances(model: Model, noise: SensorNoise, sensors: int) -> dict[str, Array]:
    """Variances of measurements by their fields in Measurement: those of the sensors, and of what a
    reduced model does not know.

    At a point its strains are far less exact than poses and lengths, their integrals: in bending
    the paper's arm at "fast" is off by 0.11 over its length, and its tip by 0.0002 of it. Unknown
    loads add to that.
    """
    length, inside = model.length, np.repeat([1.0 / model.length, 1e-2], 3)
    found: dict[str, tuple[Any, Any]] = {
        "tip_pose": (
            np.repeat([noise.rotation, noise.position], 3),
            np.repeat([1e-3, 1e-4 * length], 3),
        ),
        "tip_twist": (0.0, np.repeat([1e-2, 1e-3 * length], 3)),
        "tendon_length": (noise.length, 1e-4 * length),
        "strain": (noise.of_strains(sensors), np.tile(0.1 * inside, sensors)),
        "strain_rate": (noise.of_strain_rates(sensors), np.tile(0.2 * inside, sensors)),
    }
    return {
        name: np.asarray(of_sensors) ** 2 + np.asarray(of_model) ** 2
        for name, (of_sensors, of_model) in found.items()
    }


class ExtendedKalmanFilter:
    """Extended Kalman filter of an arm. Raises TypeError, ValueError."""

    def __init__(
        self, model: Model, setting: Setting, greatest_latency: float | None = None
    ) -> None:
        """greatest_latency: [s] of one that is estimated, None: the setting's is known."""
        period, uncertainty, latency = setting.period, setting.uncertainty, setting.latency
        self.model, self.period, self.latency, self.greatest_latency = (
            model,
            period,
            latency,
            greatest_latency,
        )
        self.start = checked_array("tension", setting.tension, (model.tendon_count,))
        for name, value in {"latency": latency, **uncertainty._asdict()}.items():
            checked_number(name, value, 0.0, "a number, at least 0")
        self.history = (
            whole_periods(latency if greatest_latency is None else greatest_latency, period)[0] + 2
        )
        n, tendons = model.coordinate_count, model.tendon_count
        borders = np.cumsum([0, n, n, tendons, tendons, 6, 1]).tolist()
        self._at = at = Layout(*map(slice, borders[:-1], borders[1:]))
        self.uncertainty, self.needs = uncertainty, tuple(setting.observed)
        self._sensors = checked_array("sensors", setting.sensors, (None,))
        self._variance = noise_variances(model, setting.noise, self._sensors.size)
        terms = model.terms(np.zeros(n), np.zeros(n))
        give = np.einsum(
            "ij,ij->j",
            terms.actuation,
            np.linalg.lstsq(terms.stiffness, terms.actuation, rcond=None)[0],
        )
        self._tension = np.sqrt(
            model.bending_energy / np.maximum(give, np.finfo(float).tiny)
        )  # of one tendon that bends the arm by 1 rad
        self._scale, self._tip_unit = model.coordinate_scale(), np.repeat([1.0, model.length], 3)
        self._simulation, self._rest = Simulation(model), static_equilibrium(model, self.start).q
        walks = (
            0.0,
            0.0,
            uncertainty.offset * self._tension,
            uncertainty.gain,
            uncertainty.tip * self._tip_unit,
            uncertainty.latency,
        )
        self._drift, self._keep = self._variances(*walks) * period, np.ones(at.latency.stop)
        self._keep[at.offset], self._keep[at.gain] = np.exp(
            -period / np.array([[uncertainty.offset_time], [uncertainty.gain_time]])
        )
        self._forces = np.diag(uncertainty.force * model.bending_energy / self._scale)

    def estimate(self, measured: Measurement, last: Estimate | None) -> Estimate:
        """Prediction over a period and update by what is measured; begins anew where the model has
        no motion like that."""
        believed = self._first() if last is None else self._predict(last.memory, measured)
        updated = self._update(believed, measured)
        if updated is None:
            updated = self._update(self._first(), measured) or self._first()
        mean = updated.mean
        q, tip = self._scale * mean[self._at.z], mean[self._at.tip]
        latency = None if self.greatest_latency is None else float(mean[self._at.latency][0])
        error = InputError(1.0 + mean[self._at.gain], mean[self._at.offset])
        return Estimate(
            q,
            self._scale * mean[self._at.v],
            moved_pose(self.model.tip_pose(q), tip),
            error,
            latency,
            updated,
        )

    def _first(self) -> Belief:
        known, mean = self.uncertainty, np.zeros(self._at.latency.stop)
        mean[self._at.z], mean[self._at.latency] = self._rest / self._scale, self.latency
        offset, tip = known.offset_start * self._tension, known.tip_start * self._tip_unit
        variance = self._variances(
            known.state_start,
            10.0 * known.state_start,
            offset,
            known.gain_start,
            tip,
            known.latency_start,
        )
        effects = self._simulation.reset(self._rest, tension=self.start).effects
        return Belief(mean, np.diag(variance), np.zeros((2 * self._scale.size,) * 2), effects)

    def _variances(self, *deviations: float | Array) -> Array:
        """Variances (m,) of standard deviations in the order of Layout; a latency that is known has
        none."""
        variance = (
            np.concatenate(
                [
                    np.full(part.stop - part.start, value)
                    for part, value in zip(self._at, deviations, strict=True)
                ]
            )
            ** 2
        )
        variance[self._at.latency] *= self.greatest_latency is not None
        return variance

    def _predict(self, last: Belief, measured: Measurement) -> Belief:
        mean, gain, offset = last.mean, 1.0 + last.mean[self._at.gain], last.mean[self._at.offset]
        q, q_dot, began = (
            self._scale * mean[self._at.z],
            self._scale * mean[self._at.v],
            measured.time - self.period,
        )
        whole, rest = whole_periods(float(mean[self._at.latency][0]), self.period)
        newest = len(measured.sent) - 1 - whole
        tension = measured.sent[
            [max(newest - 1, 0), max(newest, 0)]
        ]  # that acted over the last period
        seconds = np.array([rest, self.period - rest])  # each for so long
        try:
            self._simulation.reset(q, q_dot, time=began, effects=last.effects)
            with erring_actuators():
                rollout = self._simulation.rollout(
                    (gain * tension + offset)[None], seconds, forces=self._forces
                )
        except FAILURES:
            return self._first()
        uncertain = (
            np.sqrt(last.covariance[self._at.latency, self._at.latency][0, 0]) / self.period
        )  # periods of latency
        white = np.hypot(
            self.uncertainty.tension * self._tension,
            self.uncertainty.timing * uncertain * np.ptp(measured.sent, axis=0),
        )
        transition, noise = self._linearise(rollout, tension, seconds, gain, white)
        after = mean.copy()
        after[self._at.z], after[self._at.v] = (
            rollout.q[1] / self._scale,
            rollout.q_dot[1] / self._scale,
        )
        covariance = transition @ last.covariance @ transition.T
        covariance[: len(noise), : len(noise)] += noise
        covariance[np.diag_indices_from(covariance)] += self._drift
        return Belief(self._keep * after, covariance, noise, rollout.effects[1])

    def _linearise(
        self, rollout: Rollout, acted: Array, seconds: Array, gain: Array, white: Array
    ) -> tuple[Array, Array]:
        """Transition (m, m) of deviations over a period, in whose parts (2,) [s] tensions (2, n_a)
        acted, and the covariance (2 n, 2 n) that white forces and tensions of deviations `white`
        (n_a,) [N] add to the motion."""
        unit = np.tile(self._scale, 2)
        response = rollout.by_tension[0] / unit[:, None]
        moved = np.column_stack([response * white, rollout.by_force[0] / unit[:, None]])
        inputs = np.column_stack(
            [
                np.eye(gain.size),
                np.diag(seconds @ acted / self.period),
                gain * (acted[0] - acted[1]) / self.period,
            ]
        )
        motion, transition = slice(unit.size), np.eye(self._at.latency.stop)
        transition[motion, motion] = rollout.by_state[0] * unit / unit[:, None]
        driven = response @ inputs
        transition[motion, self._at.offset.start : self._at.gain.stop] = driven[:, :-1]
        transition[motion, self._at.latency] = driven[:, -1:]
        return transition * self._keep[:, None], moved @ moved.T

    def _update(self, believed: Belief, measured: Measurement) -> Belief | None:
        """Update: the belief after a measurement; None where there is no such state."""
        mean, covariance = believed.mean, believed.covariance
        try:
            missed, slope, variance = self._innovations(mean, measured)
            spread, weight = _gain(slope, covariance, variance, missed)
            surprise = missed @ weight[:, -1] / missed.size
            if (
                surprise > SURPRISE
            ):  # of the motion, not of what the model has wrong in the long run
                covariance, moving = covariance.copy(), slice(len(believed.noise))
                covariance[moving, moving] += (surprise / SURPRISE - 1.0) * believed.noise
                spread, weight = _gain(slope, covariance, variance, missed)
        except FAILURES:
            return None
        after = mean + spread.T @ weight[:, -1]
        covariance = covariance - spread.T @ weight[:, :-1]
        after[self._at.gain] = np.clip(after[self._at.gain], GAINS[0] - 1.0, GAINS[1] - 1.0)
        if self.greatest_latency is not None:
            after[self._at.latency] = np.clip(after[self._at.latency], 0.0, self.greatest_latency)
        if not (np.isfinite(covariance).all() and np.abs(after).max() < IMPLAUSIBLE):
            return None
        try:
            self.model.tip_pose(self._scale * after[self._at.z])
        except FAILURES:
            return None
        return Belief(after, 0.5 * (covariance + covariance.T), believed.noise, believed.effects)

    def _innovations(self, mean: Array, measured: Measurement) -> tuple[Array, Array, Array]:
        """Innovations (k,), the Jacobian (k, m) of what was expected of the state `mean` (m,), and
        the variances (k,) of the noise."""
        at, scale = self._at, self._scale
        q, q_dot = scale * mean[at.z], scale * mean[at.v]
        terms = self.model.terms(q, q_dot, time=measured.time)
        strain, slope = (
            self.model.strain_at(q, self._sensors)
            if self._sensors.size
            else (np.zeros((0, 6)), np.zeros((0, 6, q.size)))
        )
        slope, J = slope.reshape(-1, q.size), terms.tip_jacobian
        expected: dict[
            str, tuple[Any, Array]
        ] = {  # and Jacobians (k, n) by coordinates, of VELOCITIES by their rates
            "tip_twist": (J @ q_dot, J),
            "tendon_length": (self.model.tendon_lengths(q), -terms.actuation.T),
            "strain": (strain, slope),
            "strain_rate": ((slope @ q_dot).reshape(-1, 6), slope),
        }
        missed, rows, variances = [], [], []
        for name in ("tip_pose", *self.needs):
            if name == "tip_pose":
                innovation, jacobian = (
                    pose_error(moved_pose(terms.tip_pose, mean[at.tip]), measured.tip_pose),
                    J,
                )
            else:
                innovation, jacobian = (
                    (getattr(measured, name) - expected[name][0]).ravel(),
                    expected[name][1],
                )
            row, variance = (
                np.zeros((innovation.size, mean.size)),
                np.broadcast_to(self._variance[name], innovation.shape),
            )
            row[:, at.v if name in VELOCITIES else at.z] = jacobian * scale
            if name in VELOCITIES:
                variance = variance + (CHANGING * jacobian @ q_dot) ** 2
            if name == "tip_pose":
                row[:, at.tip] = np.eye(6)
            missed.append(innovation)
            rows.append(row)
            variances.append(variance)
        return np.concatenate(missed), np.vstack(rows), np.concatenate(variances)


def _gain(slope: Array, covariance: Array, variance: Array, missed: Array) -> tuple[Array, Array]:
    """H P, and (H P H^T + R)^-1 (H P, innovations)."""
    spread = slope @ covariance
    return spread, np.asarray(
        np.linalg.solve(spread @ slope.T + np.diag(variance), np.column_stack([spread, missed]))
    )
