"""Extended Kalman filter on the reduced model, for the state of an arm.

It takes whatever is measured of the arm, and estimates what the model has wrong, as slow random
walks: loads along the arm, stiffness, damping, a payload, friction of the tendons, their offsets
and gains (offset-free control, Pannocchia and Rawlings, AIChE J. 49, 2003), the displacement
between the model's tip and the measured one, latency and lag of the actuators.

What is measured updates the belief in Joseph's form, which keeps the covariance symmetric and
positive definite, with the slope H of what is expected and the variances R of its noise:

    K = P H^T (H P H^T + R)^-1,    P+ = (1 - K H) P (1 - K H)^T + K R K^T

It holds for any K: innovations that no hypothesis explains change less of what the model has wrong,
or a quick motion, of which a linearisation is far off, would be taken for loads and lag.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from soft_tendon_env.control import timing_bank
from soft_tendon_env.control.belief import Belief, StateSpace
from soft_tendon_env.control.belief_prediction import UNIFORM, BeliefPrediction
from soft_tendon_env.control.command_filter import Timing, remembered_commands
from soft_tendon_env.control.diagnosis import Diagnosis, diagnosis
from soft_tendon_env.control.initial_belief import InitialBelief
from soft_tendon_env.control.innovations import SensorModel
from soft_tendon_env.control.protocol import FAILURES, Estimate, Measurement
from soft_tendon_env.control.rigid_motions import moved_pose
from soft_tendon_env.control.uncertainty import GREATEST_LAG, GREATEST_LATENCY, Setting
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.types import Array

IMPLAUSIBLE = 1e3
"""Scaled coordinates or rates, beyond which a filter has lost the arm."""
EVIDENCE = 4.0
"""Logarithm of the likelihood ratio above which loads have jumped, though they seldom do."""
SURPRISE = 4.0
"""Mean square of the innovations, in their standard deviations, above which forces were greater."""
LEAST_FACTOR = 0.5
"""Least gain of a tendon, and factor of the stiffness."""
GREATEST_FACTOR = 2.0
"""Greatest of them."""
LEAST_DAMPING = 0.2
"""Least factor of the damping."""
GREATEST_DAMPING = 4.0
"""Greatest of it."""
GREATEST_FRICTION = 1.0
"""Greatest coefficient of friction of the tendons."""
FIRST_ITERATIONS = 4
"""Gauss-Newton steps of the first update, before which loads have bent the arm far."""
MOST_PREDICTIONS = 5
"""Predictions of a period, each about the state and the hypotheses that the last one found."""
SAME_WEIGHT = 0.2
"""Probability that may go from hypotheses to others without another prediction."""
SAME_STATE = 0.5
"""Standard deviations by which a measurement may move the state before it likewise."""
LEAST_DEVIATION = 1e-9
"""Standard deviation below which a part of the state is known."""
CERTAIN_LATENCY = 2e-3
"""Standard deviation [s] of the bank's latencies, below which one filter goes on alone."""
CERTAIN_LAG = 4e-3
"""Standard deviation [s] of its lags, likewise."""
TIMED = 5e-3
"""Standard deviation [s] of latency and lag together, below which loads may be seen to jump."""


class Update(NamedTuple):
    """Belief after a measurement, and what the measurement says of the time before it."""

    belief: Belief
    score: Array  # (m,) H^T S^-1 of the innovation: the slope of the log likelihood by the mean


class ExtendedKalmanFilter:
    """Extended Kalman filter of an arm.

    Args:
        model: of the arm, as the filter assumes it.
        setting: sensors and actuators.

    Raises:
        TypeError: for arrays that are not of numbers.
        ValueError: for arrays of another shape, and numbers below 0.
    """

    def __init__(self, model: Model, setting: Setting) -> None:
        tension = checked_array("tension", setting.tension, (model.tendon_count,))
        for name in ("latency", "lag"):
            seconds = getattr(setting, name)
            if seconds is not None:
                checked_number(name, seconds, 0.0, "a number, at least 0, or None")
        for name, value in setting.uncertainty._asdict().items():
            checked_number(f"uncertainty.{name}", value, 0.0, "a number, at least 0")
        sensors = checked_array("sensors", setting.sensors, (None,))
        self.model = model
        self.needs = tuple(setting.observed)
        self.known = Timing(setting.latency, setting.lag)
        self.greatest = Timing(
            GREATEST_LATENCY if setting.latency is None else setting.latency,
            GREATEST_LAG if setting.lag is None else setting.lag,
        )
        self.history = remembered_commands(*self.greatest, setting.period) + 1
        self.space = StateSpace(model)
        self._least, self._most = self._bounds()
        self._initial = InitialBelief(self.space, setting, tension, self.greatest)
        self._prediction = BeliefPrediction(self.space, setting, self.history)
        self._period = setting.period
        # no estimate of the tip's pose is better than an exact measurement
        self._is_pose_exact = setting.noise.position == 0.0 == setting.noise.rotation
        self._sensor_model = SensorModel(
            model, self.space.layout, self.needs, sensors, setting.noise
        )

    def estimate(self, measured: Measurement, last: Estimate | None) -> Estimate:
        """Estimates the state after a period: prediction and update.

        The filter begins anew where the model has no motion like that.

        Args:
            measured: at the end of the period.
            last: estimate of the period before, None when an episode begins.

        Returns:
            Coordinates and rates, errors of inputs and forces; the tip's pose, as it is measured
            where its sensors are exact, and the timing of commands if it is estimated.
        """
        belief = None
        if last is not None:
            belief = self._next(last.memory, measured)
            if belief is None:
                update = self._update(self._initial.lost(last.memory), measured)
                belief = None if update is None else update.belief
        if belief is None:
            belief = self._begin(measured)
        mean = belief.mean
        q, q_dot = self.space.coordinates(mean)
        tip_pose = measured.tip_pose
        if not self._is_pose_exact:
            displacement = mean[self.space.layout.tip]
            tip_pose = moved_pose(belief.locality.terms.tip_pose, displacement)
        return Estimate(
            q=q,
            q_dot=q_dot,
            tip_pose=tip_pose,
            input_error=self.space.input_error(mean),
            force_error=self.space.force_error(mean, belief.locality),
            timing=self.space.timing(mean) if None in self.known else None,
            timing_spread=_timing_spread(belief.bank),
            surprise=belief.surprise.lasting,
            memory=belief,
        )

    def diagnosis(self, estimate: Estimate) -> Diagnosis:
        """Computes what an estimate has found out about the arm, with standard deviations.

        Args:
            estimate: of this filter.

        Returns:
            Values and standard deviations in SI units.
        """
        return diagnosis(self.space, estimate.memory)

    def _next(self, last: Belief, measured: Measurement) -> Belief | None:
        """Belief a period later; None where the model has no such motion.

        The motion is linearised about the state a period ago as it was believed then, and where the
        measurement tells another one, about that: a first motion may tell a payload of a quarter of
        the arm's mass, of which a linearisation about none makes half (iterated smoothing, Bell,
        SIAM J. Optim. 4, 1994). Hypotheses on the timing are linearised about their mean likewise.
        """
        bank = last.bank
        weight = None if bank is None else bank.weight
        point = last.mean
        deviation = np.sqrt(np.diag(last.covariance))
        known = deviation < LEAST_DEVIATION
        updated = None
        regrouped = 0.0
        for _ in range(MOST_PREDICTIONS):
            prediction = self._prediction.predict(last, measured, weight, point)
            update = None if prediction is None else self._update(prediction.belief, measured)
            if prediction is None or update is None:
                break
            updated = update.belief
            score_before = prediction.transition.T @ update.score
            smoothed = last.mean + last.covariance @ score_before
            if bank is not None and weight is not None and updated.bank is not None:
                before = weight
                weight = updated.bank.sharp_weight
                smoothed += bank.deviation @ weight
                regrouped = 0.5 * np.abs(weight - before).sum()
            smoothed = self._within_bounds(smoothed)
            change = np.abs(smoothed - point)
            moved = change[~known] / deviation[~known]
            if regrouped < SAME_WEIGHT and moved.max() < SAME_STATE:
                break
            point = smoothed
        if updated is None:
            return None
        if bank is not None and regrouped >= SAME_WEIGHT:
            # found about another motion than the likeliest, likelihoods say nothing of the timing
            updated = _weighted_as(updated, bank)
        return self._settled(updated)

    def _begin(self, measured: Measurement) -> Belief:
        """Belief when an episode begins: at rest under the tensions and loads that hold the arm.

        As loads bend it far, the statics are linearised anew about where the update finds it.
        """
        first = self._initial.at_rest(self._initial.rest)
        belief = first
        point = None
        for _ in range(FIRST_ITERATIONS):
            update = self._update(first, measured, point)
            if update is None:
                break
            belief = update.belief
            point = belief.mean
            q, _ = self.space.coordinates(point)
            first = self._initial.at_rest(q)
        return belief

    def _update(
        self, predicted: Belief, measured: Measurement, point: Array | None = None
    ) -> Update | None:
        """Update: the belief after a measurement; None where there is no such state.

        What is expected is linearised about a state `point` (m,), by default the predicted mean.
        """
        mean = predicted.mean
        bank = predicted.bank
        is_iterated = point is not None
        point = mean if point is None else point
        deviations = np.zeros((mean.size, 1)) if bank is None else bank.deviation
        try:
            innovation, slope, variance = self._sensor_model.innovations(point, measured)
            expected = slope @ (mean - point)
            innovations = (innovation - expected)[:, None] - slope @ deviations
            noise = np.diag(variance)
            left_out = None
            uncertain = noise
            if bank is not None:
                # what a linearisation about their mean leaves out of the motions of hypotheses is
                # taken for their own motions about it
                by_timing = slope @ bank.covariance
                left_out = by_timing @ slope.T
                uncertain = noise + left_out
            covariance, inverse_root, square = _plausible(predicted, slope, uncertain, innovations)
            cross = slope @ covariance
            gain = _gain(cross, inverse_root)
            moving = len(predicted.noise)
            if bank is not None:
                # a measurement tells where the arm is, by whatever timing it came there
                spread = cross + by_timing
                spread_root = _inverse_root(slope, spread, noise)
                gain[:moving] = _gain(spread[:, :moving], spread_root)
                sharp_root = _inverse_root(slope, cross, noise)
                bank = timing_bank.judged(bank, innovations, inverse_root, sharp_root)
        except FAILURES:
            return None
        if not is_iterated:
            # where it is far off, a linearisation tells where the arm is, but not why
            doubt = max(1.0, _least_square(inverse_root, innovations))
            gain[moving:] /= doubt
        moved = deviations + gain @ innovations
        likely = innovations[:, 0]
        if bank is not None:
            likely = innovations @ bank.sharp_weight
        whitened = inverse_root @ likely
        score = slope.T @ (inverse_root.T @ whitened)
        change = moved[:, 0]
        if bank is not None:
            change = moved @ bank.weight
            bank = bank._replace(deviation=moved - change[:, None])
        after = mean + change
        rest = np.eye(mean.size) - gain @ slope
        erring = (gain * variance) @ gain.T
        if left_out is not None:
            of_motion = gain[moving:]
            erring[moving:, moving:] += of_motion @ left_out @ of_motion.T
        covariance = rest @ covariance @ rest.T + erring
        after = self._within_bounds(after)
        is_plausible = np.abs(after).max() < IMPLAUSIBLE  # not of NaN either
        if not is_plausible or not np.isfinite(covariance).all():
            return None
        try:
            locality = self.space.locality(*self.space.coordinates(after))
        except FAILURES:  # the model has no such shape
            return None
        belief = predicted._replace(
            mean=after,
            covariance=0.5 * (covariance + covariance.T),  # symmetric, also after round-off
            bank=bank,
            locality=locality,
            surprise=predicted.surprise.after(square, self._period),
        )
        return Update(belief, score)

    def _settled(self, belief: Belief) -> Belief:
        """Belief whose bank has lost the unlikely hypotheses.

        Where the timing is certain enough, the whole bank becomes part of the covariance, by the
        second moment of its deviations.
        """
        if belief.bank is None:
            return belief
        bank = timing_bank.pruned(belief.bank)
        _, deviations = bank.moments()
        if deviations.latency > CERTAIN_LATENCY or deviations.lag > CERTAIN_LAG:
            return belief._replace(bank=bank)
        covariance = belief.covariance + bank.covariance
        for name, seconds in self.known._asdict().items():
            if seconds is None:
                part = getattr(self.space.layout, name)
                covariance[part, part] += (UNIFORM * timing_bank.LATENCY_STEP) ** 2
        return belief._replace(covariance=covariance, bank=None)

    def _bounds(self) -> tuple[Array, Array]:
        """Least and greatest states (m,), infinite of what has no bounds."""
        layout = self.space.layout
        lower = np.full(layout.size, -np.inf)
        upper = np.full(layout.size, np.inf)
        for part, least, greatest in (
            (layout.gain, LEAST_FACTOR - 1.0, GREATEST_FACTOR - 1.0),
            (layout.stiffness, LEAST_FACTOR - 1.0, GREATEST_FACTOR - 1.0),
            (layout.damping, LEAST_DAMPING - 1.0, GREATEST_DAMPING - 1.0),
            (layout.payload, 0.0, self.space.mass),
            (layout.friction, 0.0, GREATEST_FRICTION),
            (layout.latency, 0.0, self.greatest.latency),
            (layout.lag, 0.0, self.greatest.lag),
        ):
            lower[part] = least
            upper[part] = greatest
        return lower, upper

    def _within_bounds(self, mean: Array) -> Array:
        """State (m,) that is cut off at its bounds."""
        at_least = np.maximum(mean, self._least)
        return np.asarray(np.minimum(at_least, self._most))


def _timing_spread(bank: timing_bank.Bank | None) -> float:
    """Standard deviation [s] of latency and lag together, of a bank."""
    if bank is None:
        return 0.0
    _, deviations = bank.moments()
    return float(np.hypot(*deviations))


def _weighted_as(belief: Belief, last: timing_bank.Bank) -> Belief:
    """Belief with the probabilities of hypotheses that a bank of as many had before."""
    bank = belief.bank
    if bank is None:
        return belief
    bank = bank._replace(log_likelihood=last.log_likelihood)
    change = bank.deviation @ bank.weight
    bank = bank._replace(deviation=bank.deviation - change[:, None])
    return belief._replace(mean=belief.mean + change, bank=bank)


def _gain(cross: Array, inverse_root: Array) -> Array:
    """Gain (p, k) of p states, of their covariance (k, p) with the measurements, and L^-1."""
    return (inverse_root.T @ (inverse_root @ cross)).T


def _plausible(
    predicted: Belief, slope: Array, noise: Array, innovations: Array
) -> tuple[Array, Array, float]:
    """Covariance (m, m) under which innovations (k, H) are plausible, and L^-1 of theirs.

    Loads have jumped where that is far more likely. Where all hypotheses are surprised still, the
    forces of the last period are taken for as much greater: by the mean square of the innovations
    before that, which comes third. Raises LinAlgError.
    """
    covariance = predicted.covariance
    inverse_root = _inverse_root(slope, slope @ covariance, noise)
    whitened = inverse_root @ innovations
    squares = (whitened**2).sum(axis=0)
    best = int(squares.argmin())
    # a command that comes at another time than is believed looks like a jump
    is_timed = _timing_spread(predicted.bank) < TIMED
    jump = slope @ predicted.jump
    if is_timed and _evidence(inverse_root @ jump, whitened[:, best]) > EVIDENCE:
        covariance_of_jump = predicted.jump @ predicted.jump.T
        covariance = covariance + covariance_of_jump
        inverse_root = _inverse_root(slope, slope @ covariance, noise)
    square = _least_square(inverse_root, innovations)
    if square > SURPRISE:
        motion = slice(len(predicted.noise))
        growth = square / SURPRISE - 1.0
        covariance = covariance.copy()
        covariance[motion, motion] += growth * predicted.noise
        inverse_root = _inverse_root(slope, slope @ covariance, noise)
    return covariance, inverse_root, square


def _evidence(jump: Array, innovation: Array) -> float:
    """Logarithm of how much likelier an innovation is if a jump adds to its covariance.

    With white innovations w (k,) and J (k, p) of unknown jumps, of deviation 1 each, w has the
    covariance 1 + J J^T instead of 1:

        log ratio = (J^T w)^T (1 + J^T J)^-1 (J^T w) / 2 - log det (1 + J^T J) / 2
    """
    prior = np.eye(jump.shape[1])
    information = prior + jump.T @ jump
    root = np.linalg.cholesky(information)
    whitened = np.linalg.solve(root, jump.T @ innovation)
    log_determinant = np.log(np.diag(root)).sum()
    return float(0.5 * whitened @ whitened - log_determinant)


def _inverse_root(slope: Array, cross: Array, noise: Array) -> Array:
    """L^-1 of the innovations' covariance C H^T + R = L L^T, C = H P. Raises LinAlgError."""
    innovation_covariance = cross @ slope.T + noise
    root = np.linalg.cholesky(innovation_covariance)
    if not np.isfinite(root).all():
        raise np.linalg.LinAlgError("the covariance of the innovations is not finite")
    unit = np.eye(len(noise))
    return np.asarray(solve_triangular(root, unit, lower=True, check_finite=False))


def _least_square(inverse_root: Array, innovations: Array) -> float:
    """Least mean square of innovations (k, H) in their standard deviations."""
    squares = ((inverse_root @ innovations) ** 2).sum(axis=0)
    return float(squares.min()) / len(innovations)
