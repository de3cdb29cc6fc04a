"""Extended Kalman filter on the reduced model, for the state of an arm.

It takes whatever is measured of the arm, and estimates offsets and gains of its inputs too.

The motion is predicted by the model's own simulation, its covariance by the Jacobians that come
with it. The filter also estimates what the model has wrong, as slow random walks: a tension that is
added (offset-free control, Pannocchia and Rawlings, AIChE J. 49, 2003), a gain of every tendon, the
displacement between the model's tip and the measured one, and the latency of the commands, if it is
not known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.control.innovations import SensorModel, layout_of
from soft_tendon_env.control.protocol import (
    FAILURES,
    Estimate,
    InputError,
    Measurement,
    SensorNoise,
)
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.control.smith_predictor import whole_periods
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.types import Array

IMPLAUSIBLE = 1e3  # scaled coordinates or rates, beyond which a filter begins anew
# mean square of the innovations, in their standard deviations, above which the forces that the
# model lacks are taken for greater
SURPRISE = 4.0
LEAST_GAIN = 0.5  # of a tendon
GREATEST_GAIN = 2.0


class Uncertainty(NamedTuple):
    """Standard deviations of the model's errors.

    They are those at the beginning, and of their change in 1 s, unless said otherwise.

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
    # coordinates, in units of `coordinate_scale`; their rates ten times that
    state_start: float = 1e-2


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

    mean: Array  # (m,), see innovations.Layout
    covariance: Array  # (m, m)
    # (2 n, 2 n) what unknown forces of the last period have added to that of coordinates and rates
    noise: Array
    effects: Array  # internal states of the model's effects


class ExtendedKalmanFilter:
    """Extended Kalman filter of an arm.

    Args:
        model: of the arm, as the filter assumes it.
        setting: sensors and actuators.
        greatest_latency: [s] of one that is estimated, None: the setting's is known.

    Raises:
        TypeError: for arrays that are not of numbers.
        ValueError: for arrays of another shape, and numbers below 0.
    """

    def __init__(
        self, model: Model, setting: Setting, greatest_latency: float | None = None
    ) -> None:
        period = setting.period
        uncertainty = setting.uncertainty
        self.model = model
        self.period = period
        self.latency = setting.latency
        self.greatest_latency = greatest_latency
        self.uncertainty = uncertainty
        self.start = checked_array("tension", setting.tension, (model.tendon_count,))
        checked_number("latency", self.latency, 0.0, "a number, at least 0")
        for name, value in uncertainty._asdict().items():
            checked_number(f"uncertainty.{name}", value, 0.0, "a number, at least 0")
        self.needs = tuple(setting.observed)
        longest = self.latency if greatest_latency is None else greatest_latency
        # commands that acted in the last period: two, where one took over from another
        self.history = whole_periods(longest, period)[0] + 2
        sensors = checked_array("sensors", setting.sensors, (None,))
        self._sensor_model = SensorModel(model, self.needs, sensors, setting.noise)
        self._simulation = Simulation(model)
        self._rest = static_equilibrium(model, self.start).q
        # units of the state's entries
        self._layout = layout_of(model)
        self._scale = model.coordinate_scale()
        self._tension = _bending_tension(model)
        self._tip_unit = np.repeat([1.0, model.length], 3)
        # change of the state in a period: the variance of its walks, and what is not forgotten
        walks = self._variances(
            z=0.0,
            v=0.0,
            offset=uncertainty.offset * self._tension,
            gain=uncertainty.gain,
            tip=uncertainty.tip * self._tip_unit,
            latency=uncertainty.latency,
        )
        self._drift = walks * period
        self._keep = np.ones(self._drift.size)
        times = np.array([uncertainty.offset_time, uncertainty.gain_time])  # 0 s forgets at once
        offset_kept, gain_kept = np.exp(-period / times)
        self._keep[self._layout.offset] = offset_kept
        self._keep[self._layout.gain] = gain_kept
        self._forces = np.diag(uncertainty.force * model.bending_energy / self._scale)

    def estimate(self, measured: Measurement, last: Estimate | None) -> Estimate:
        """Estimates the state after a period: prediction and update.

        The filter begins anew where the model has no motion like that.

        Args:
            measured: at the end of the period.
            last: estimate of the period before, None when an episode begins.

        Returns:
            Coordinates, rates and tip pose, errors of the inputs, and the latency if it is
            estimated.
        """
        predicted = self._first() if last is None else self._predict(last.memory, measured)
        updated = self._update(predicted, measured)
        if updated is None:
            updated = self._update(self._first(), measured) or self._first()
        mean = updated.mean
        layout = self._layout
        q = self._scale * mean[layout.z]
        is_latency_known = self.greatest_latency is None
        return Estimate(
            q=q,
            q_dot=self._scale * mean[layout.v],
            tip_pose=moved_pose(self.model.tip_pose(q), mean[layout.tip]),
            input_error=InputError(1.0 + mean[layout.gain], mean[layout.offset]),
            latency=None if is_latency_known else float(mean[layout.latency][0]),
            memory=updated,
        )

    def _first(self) -> Belief:
        """Belief when an episode begins: the arm at rest under the tensions that hold it."""
        start = self.uncertainty
        variance = self._variances(
            z=start.state_start,
            v=10.0 * start.state_start,
            offset=start.offset_start * self._tension,
            gain=start.gain_start,
            tip=start.tip_start * self._tip_unit,
            latency=start.latency_start,
        )
        mean = np.zeros(variance.size)
        mean[self._layout.z] = self._rest / self._scale
        mean[self._layout.latency] = self.latency
        motion = 2 * self._scale.size
        effects = self._simulation.reset(self._rest, tension=self.start).effects
        return Belief(
            mean=mean,
            covariance=np.diag(variance),
            noise=np.zeros((motion, motion)),
            effects=effects,
        )

    def _variances(self, **deviations: float | Array) -> Array:
        """Variances (m,) of the state from standard deviations of the parts of Layout.

        A latency that is known has none.
        """
        variance = np.zeros(self._layout.latency.stop)
        for name, part in self._layout._asdict().items():
            variance[part] = np.asarray(deviations[name]) ** 2
        if self.greatest_latency is None:
            variance[self._layout.latency] = 0.0
        return variance

    def _predict(self, last: Belief, measured: Measurement) -> Belief:
        """Belief after a period; the first one where the model has no such motion."""
        layout = self._layout
        mean = last.mean
        gain = 1.0 + mean[layout.gain]
        offset = mean[layout.offset]
        (latency,) = mean[layout.latency]
        tension, seconds = self._acting(float(latency), measured)
        try:
            self._simulation.reset(
                self._scale * mean[layout.z],
                self._scale * mean[layout.v],
                time=measured.time - self.period,
                effects=last.effects,
            )
            driven = (gain * tension + offset)[None]
            with erring_actuators():  # gain and offset may exceed the limits
                rollout = self._simulation.rollout(driven, seconds, forces=self._forces)
        except FAILURES:
            return self._first()
        white = self._white_tension(last, measured)
        transition, noise = self._linearise(rollout, tension, seconds, gain, white)
        after = mean.copy()
        after[layout.z] = rollout.q[1] / self._scale
        after[layout.v] = rollout.q_dot[1] / self._scale
        # P+ = F P F^T + Q: Q is of white forces and tensions, and of the walks
        covariance = transition @ last.covariance @ transition.T
        covariance[: len(noise), : len(noise)] += noise
        covariance[np.diag_indices_from(covariance)] += self._drift
        return Belief(
            mean=self._keep * after,
            covariance=covariance,
            noise=noise,
            effects=rollout.effects[1],
        )

    def _acting(self, latency: float, measured: Measurement) -> tuple[Array, Array]:
        """Commands that acted over the last period, where they arrive late by `latency` [s].

        They are two tensions (2, n_a) [N], one after the other, and for how long each acted (2,)
        [s].
        """
        whole, rest = whole_periods(latency, self.period)
        newest = len(measured.sent) - 1 - whole
        tension = measured.sent[[max(newest - 1, 0), max(newest, 0)]]
        return tension, np.array([rest, self.period - rest])

    def _white_tension(self, last: Belief, measured: Measurement) -> Array:
        """Standard deviations (n_a,) [N] of white tensions.

        They are more where commands change while their latency is uncertain.
        """
        latency = self._layout.latency
        latency_deviation = np.sqrt(last.covariance[latency, latency][0, 0])
        periods = latency_deviation / self.period
        change = np.ptp(measured.sent, axis=0)
        of_timing = self.uncertainty.timing * periods * change
        always = self.uncertainty.tension * self._tension
        return np.hypot(always, of_timing)

    def _linearise(
        self, rollout: Rollout, acted: Array, seconds: Array, gain: Array, white: Array
    ) -> tuple[Array, Array]:
        """Linearised motion over a period, in whose parts (2,) [s] tensions (2, n_a) acted.

        The transition (m, m) of deviations, and the covariance (2 n, 2 n) that white forces and
        tensions, of deviations `white` (n_a,) [N], add to the motion.
        """
        layout = self._layout
        unit = np.tile(self._scale, 2)  # of coordinates and rates
        by_tension = rollout.by_tension[0] / unit[:, None]
        by_force = rollout.by_force[0] / unit[:, None]
        moved = np.column_stack([by_tension * white, by_force])
        # tension of the period by offsets, by gains and by latency: a later command keeps the
        # earlier tension for longer
        mean_tension = seconds @ acted / self.period
        by_offset = np.eye(gain.size)
        by_gain = np.diag(mean_tension)
        by_latency = gain * (acted[0] - acted[1]) / self.period
        driven = by_tension @ np.column_stack([by_offset, by_gain, by_latency])
        motion = slice(unit.size)
        inputs = slice(layout.offset.start, layout.gain.stop)
        transition = np.eye(layout.latency.stop)
        by_motion = rollout.by_state[0] * unit / unit[:, None]
        transition[motion, motion] = by_motion
        transition[motion, inputs] = driven[:, :-1]
        transition[motion, layout.latency] = driven[:, -1:]
        return transition * self._keep[:, None], moved @ moved.T

    def _update(self, predicted: Belief, measured: Measurement) -> Belief | None:
        """Update: the belief after a measurement; None where there is no such state."""
        mean = predicted.mean
        covariance = predicted.covariance
        try:
            innovation, slope, variance = self._sensor_model.innovations(mean, measured)
            spread, weight = _gain(slope, covariance, variance, innovation)
            surprise = innovation @ weight[:, -1] / innovation.size
            if surprise > SURPRISE:
                # of the motion, not of what the model has wrong in the long run
                motion = slice(len(predicted.noise))
                excess = surprise / SURPRISE - 1.0
                covariance = covariance.copy()
                covariance[motion, motion] += excess * predicted.noise
                spread, weight = _gain(slope, covariance, variance, innovation)
        except FAILURES:
            return None
        after = mean + spread.T @ weight[:, -1]
        covariance = covariance - spread.T @ weight[:, :-1]
        self._keep_plausible(after)
        is_plausible = np.abs(after).max() < IMPLAUSIBLE  # not of NaN either
        if not is_plausible or not np.isfinite(covariance).all():
            return None
        try:
            self.model.tip_pose(self._scale * after[self._layout.z])
        except FAILURES:  # the model has no such shape
            return None
        return Belief(
            mean=after,
            covariance=0.5 * (covariance + covariance.T),  # symmetric, also after round-off
            noise=predicted.noise,
            effects=predicted.effects,
        )

    def _keep_plausible(self, mean: Array) -> None:
        """Cuts gains and latency of a state (m,) off at their bounds, in place."""
        gain = self._layout.gain
        mean[gain] = np.clip(mean[gain], LEAST_GAIN - 1.0, GREATEST_GAIN - 1.0)
        if self.greatest_latency is not None:
            latency = self._layout.latency
            mean[latency] = np.clip(mean[latency], 0.0, self.greatest_latency)


def _bending_tension(model: Model) -> Array:
    """Tensions (n_a,) [N] of single tendons that bend the arm by 1 rad."""
    rest = np.zeros(model.coordinate_count)
    terms = model.terms(rest, rest)
    answer, *_ = np.linalg.lstsq(terms.stiffness, terms.actuation, rcond=None)
    # twice the energy that a unit of each stores; none, of a tendon along the axis
    energy = np.einsum("ij,ij->j", terms.actuation, answer)
    energy = np.maximum(energy, np.finfo(float).tiny)
    return np.sqrt(model.bending_energy / energy)


def _gain(
    slope: Array, covariance: Array, variance: Array, innovation: Array
) -> tuple[Array, Array]:
    """H P, and (H P H^T + R)^-1 (H P, innovations)."""
    spread = slope @ covariance
    innovation_covariance = spread @ slope.T + np.diag(variance)
    columns = np.column_stack([spread, innovation])
    return spread, np.asarray(np.linalg.solve(innovation_covariance, columns))
