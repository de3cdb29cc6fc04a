"""Prediction of the Kalman filter: the model's motion over a period, and its linearisation.

    x+ = f(x, u) + B Q,    P+ = F P F^T + W

f is the simulation of the model under the tensions that the actuators make of late commands, and Q
the force that the model lacks. The derivatives F and B come with the simulation.
"""

import math
from typing import NamedTuple

import numpy as np

from soft_tendon_env.control import timing_bank
from soft_tendon_env.control.belief import Belief, StateSpace, tip_acceleration
from soft_tendon_env.control.command_filter import Timing, mean_weights, weight_slopes
from soft_tendon_env.control.force_errors import ForceError, corrected_rollout, sliding_direction
from soft_tendon_env.control.protocol import FAILURES, InputError, Measurement
from soft_tendon_env.control.uncertainty import Setting
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.tools.types import Array

UNIFORM = 1.0 / np.sqrt(12.0)
"""Standard deviation of what is anywhere within a unit."""


class PeriodStart(NamedTuple):
    """State at the beginning of a period, about which the motion is linearised."""

    belief: Belief  # whose mean it is
    q: Array  # (n,)
    q_dot: Array  # (n,)
    input_error: InputError
    force_error: ForceError


class ActingTension(NamedTuple):
    """Tensions that act over the last period, of S steps of equal length.

    All but `pull` are without gains and offsets.
    """

    steps: Array  # (S, n_a) [N] means of the steps
    slopes: Array  # (2, S, n_a) [N/s] of them, by latency and lag
    hypotheses: Array | None  # (H, S, n_a) [N] means of steps by hypothesis, where there is a bank
    pull: Array  # (S, n_a) [N] with which tendons pull in the steps: with gains and offsets


class PeriodMotion(NamedTuple):
    """Motion over a period of S steps, and its derivatives by what acts in them.

    Derivatives are of scaled coordinates and rates at the end of the period.
    """

    q: Array  # (S + 1, n) when the period begins, and the steps end
    q_dot: Array  # (S + 1, n)
    effects: Array  # internal states of the effects at its end
    by_state: Array  # (2 n, 2 n) by scaled coordinates and rates
    by_tension: Array  # (S, 2 n, n_a) by tensions in each of the steps
    by_force: Array  # (S, 2 n, n) by generalised forces


class Prediction(NamedTuple):
    """Belief after a period, before what is measured then."""

    belief: Belief
    transition: Array  # F (m, m) of deviations over the period


class BeliefPrediction:
    """Prediction of beliefs by a period.

    Args:
        space: of the state.
        setting: sensors and actuators.
        history: number of commands that a measurement has.
    """

    def __init__(self, space: StateSpace, setting: Setting, history: int) -> None:
        uncertainty = setting.uncertainty
        self.space = space
        self.period = setting.period
        self.history = history
        # of a period: as short as hypotheses on the latency differ
        count = math.ceil(self.period / timing_bank.LATENCY_STEP)
        self._step = self.period / count
        self._starts = np.linspace(-self.period, 0.0, count, endpoint=False)
        self._simulation = Simulation(space.model)
        # change of the state in a second: the variance of its walks
        self._even_walks = space.variances(
            z=0.0,
            v=0.0,
            offset=uncertainty.offset * space.tension,
            gain=uncertainty.gain,
            tip=uncertainty.tip * space.tip,
            load=uncertainty.load * space.weight,
            stiffness=uncertainty.stiffness,
            damping=uncertainty.damping,
            payload=uncertainty.payload * space.mass,
            friction=uncertainty.friction,
            latency=uncertainty.latency if setting.latency is None else 0.0,
            lag=uncertainty.lag if setting.lag is None else 0.0,
        )
        # and as shares of what there is already
        self._load_share = uncertainty.load_share
        self._load_most = uncertainty.load_most * space.weight
        self._gain_share = uncertainty.gain_share
        self._offset_share = uncertainty.offset_share
        # what is not forgotten in a period
        self._keep = np.ones(space.layout.size)
        times = np.array([uncertainty.offset_time, uncertainty.gain_time])  # 0 s forgets at once
        offset_kept, gain_kept = np.exp(-self.period / times)
        self._keep[space.layout.offset] = offset_kept
        self._keep[space.layout.gain] = gain_kept
        self._white_tension = uncertainty.tension * space.tension
        self._sliding = uncertainty.sliding
        self._force_unit = space.model.bending_energy / space.scale
        self._white_force = uncertainty.force
        self._inertial = uncertainty.inertial
        self._jump = uncertainty.load_jump * space.weight

    def predict(
        self, last: Belief, measured: Measurement, weight: Array | None, point: Array
    ) -> Prediction | None:
        """Prediction of a belief; None where the model has no such motion.

        Args:
            last: belief a period ago.
            measured: now, of which the commands are used.
            weight: (H,) of hypotheses, under whose mean command the motion is linearised; None:
                there is no bank.
            point: state (m,) a period ago, about which the motion is linearised.

        Returns:
            The belief at the end of the period, and the transition.
        """
        layout = self.space.layout
        start = self._start(last._replace(mean=point))
        acting = self._acting(start, measured, weight)
        motion = self._motion(start, measured, acting)
        if motion is None:
            return None
        moving = slice(layout.v.stop)
        gain = start.input_error.gain
        by_tension = motion.by_tension.sum(axis=0)
        transition = self._transition(start, motion, acting)
        # a deviation needs no exact tension: that of the commands, without gains and offsets
        commanded = np.abs(acting.steps).mean(axis=0)
        rubbed = start.force_error.friction.loss * commanded
        white_tension = np.hypot(self._white_tension, self._sliding * rubbed)
        bank = last.bank
        if acting.hypotheses is not None and bank is not None:
            # what lies between two hypotheses
            slope = acting.slopes[0].mean(axis=0)
            width = UNIFORM * timing_bank.LATENCY_STEP
            between = width * gain * slope
            white_tension = np.hypot(white_tension, between)
            deviation = transition @ bank.deviation
            apart = gain * (acting.hypotheses - acting.steps)
            deviation[moving] += np.einsum("sit,hst->ih", motion.by_tension, apart)
            bank = bank._replace(deviation=deviation)
        white_force = self._white_forces(last, motion)
        by_force = motion.by_force.sum(axis=0)
        moved = np.column_stack([by_tension * white_tension, by_force * white_force])
        noise = moved @ moved.T
        covariance = transition @ last.covariance @ transition.T
        covariance[moving, moving] += noise
        covariance[np.diag_indices_from(covariance)] += self._walks(point)
        mean = self._keep * point
        q_end = motion.q[-1]
        q_dot_end = motion.q_dot[-1]
        mean[layout.z] = q_end / self.space.scale
        mean[layout.v] = q_dot_end / self.space.scale
        deviation_of_mean = last.mean - point
        mean += transition @ deviation_of_mean
        belief = Belief(
            mean=mean,
            covariance=covariance,
            noise=noise,
            jump=self._jump * transition[:, layout.load],
            effects=motion.effects,
            bank=bank,
            locality=last.locality,
            surprise=last.surprise,
        )
        return Prediction(belief, transition)

    def _walks(self, state: Array) -> Array:
        """Variances (m,) of the walks of a state (m,) in a period.

        What is there changes by a share of itself besides: where nothing errs, little changes. Of
        loads the share is bounded: errors of quick motions are taken for loads at first, which
        would feed their own growth.
        """
        layout = self.space.layout
        variance = self._even_walks.copy()
        gain_walk = self._gain_share * state[layout.gain]
        offset_walk = self._offset_share * state[layout.offset]
        loads = state[layout.load]
        forces = loads.reshape(-1, 3)
        sizes = np.linalg.norm(forces, axis=1)
        growth = np.minimum(self._load_share * sizes, self._load_most)
        load_walk = np.repeat(growth, 3)  # of each component
        variance[layout.gain] += gain_walk**2
        variance[layout.offset] += offset_walk**2
        variance[layout.load] += load_walk**2
        return self.period * variance

    def _start(self, belief: Belief) -> PeriodStart:
        """Mean of a belief as the beginning of a period."""
        q, q_dot = self.space.coordinates(belief.mean)
        return PeriodStart(
            belief=belief,
            q=q,
            q_dot=q_dot,
            input_error=self.space.input_error(belief.mean),
            force_error=self.space.force_error(belief.mean, belief.locality),
        )

    def _acting(
        self, start: PeriodStart, measured: Measurement, weight: Array | None
    ) -> ActingTension:
        """Tensions that act over the last period, by the believed timing or by a weight (H,)."""
        timing = self.space.timing(start.belief.mean)
        bank = start.belief.bank
        input_error = start.input_error
        slopes = weight_slopes(timing, self.period, self.history, self._starts, self._step)
        hypotheses = None
        if bank is None or weight is None:
            steps = self._means(timing) @ measured.sent
        else:
            latencies, lags = (values[:, None] for values in bank.timing)
            hypotheses = self._means(Timing(latencies, lags)) @ measured.sent
            steps = np.einsum("h,hst->st", weight, hypotheses)
        return ActingTension(
            steps=steps,
            slopes=np.array(slopes) @ measured.sent,
            hypotheses=hypotheses,
            pull=input_error.gain * steps + input_error.offset,
        )

    def _means(self, timing: Timing) -> Array:
        """Weights (..., S, history) of commands in the mean tensions of the steps."""
        return mean_weights(timing, self.period, self.history, self._starts, self._step)

    def _motion(
        self, start: PeriodStart, measured: Measurement, acting: ActingTension
    ) -> PeriodMotion | None:
        """Motion over the last period; None where the model has none."""
        time = measured.time - self.period
        effects = start.belief.effects
        error = start.force_error
        try:
            self._simulation.reset(start.q, start.q_dot, time=time, effects=effects)
            rollout = corrected_rollout(self._simulation, acting.pull, self._step, error)
        except FAILURES:
            return None
        return _period_motion(rollout, np.tile(self.space.scale, 2))

    def _white_forces(self, last: Belief, motion: PeriodMotion) -> Array:
        """Standard deviations (n,) of white forces: always, and by the inertial forces M q_ddot.

        These are a mean over all coordinates, in units of those that bend the arm by 1 rad.
        """
        q_dot_begin = motion.q_dot[0]
        q_dot_end = motion.q_dot[-1]
        change = (q_dot_end - q_dot_begin) / self.period
        shares = last.locality.terms.mass @ change / self._force_unit
        mean_square = np.mean(shares**2)
        inertial = self._inertial * np.sqrt(mean_square)
        deviation = np.hypot(self._white_force, inertial)
        return deviation * self._force_unit

    def _transition(self, start: PeriodStart, motion: PeriodMotion, acting: ActingTension) -> Array:
        """Transition F (m, m) of deviations over a period.

        A bank has the deviations by timing itself, see `predict`.
        """
        layout = self.space.layout
        locality = start.belief.locality
        terms = locality.terms
        tip = terms.tip_jacobian[3:]
        friction = start.force_error.friction
        # means of the steps (S, n)
        q_begin = motion.q[:-1]
        q_end = motion.q[1:]
        q = 0.5 * (q_end + q_begin)
        q_dot = np.diff(motion.q, axis=0) / self._step
        q_ddot = np.diff(motion.q_dot, axis=0) / self._step
        acceleration = tip_acceleration(terms, start.q_dot, q_ddot)
        tendon_rates = friction.rates(q_dot)
        direction = sliding_direction(tendon_rates)
        tension = np.maximum(acting.pull, 0.0)
        taken = locality.loss * direction * tension  # (S, n_a) by a coefficient
        # generalised forces (S, n) by factors, mass and coefficient
        forces = {
            layout.stiffness.start: -q @ terms.stiffness,
            layout.damping.start: -q_dot @ terms.damping,
            layout.payload.start: -acceleration @ tip,
            layout.friction.start: -taken @ friction.pull.T,
        }
        by_tension = motion.by_tension.sum(axis=0)
        by_force = motion.by_force.sum(axis=0)
        transition = np.eye(layout.size)
        moving = slice(layout.v.stop)
        transition[moving, moving] = motion.by_state
        transition[moving, layout.offset] = by_tension
        by_gain = np.einsum("sit,st->it", motion.by_tension, acting.steps)
        by_load = by_force @ locality.load_jacobian
        transition[moving, layout.gain] = by_gain
        transition[moving, layout.load] = by_load
        for column, force in forces.items():
            by_factor = np.einsum("sin,sn->i", motion.by_force, force)
            transition[moving, column] = by_factor
        if start.belief.bank is None:
            timing = slice(layout.latency.start, layout.lag.stop)
            slopes = start.input_error.gain * acting.slopes
            by_timing = np.einsum("sit,pst->ip", motion.by_tension, slopes)
            transition[moving, timing] = by_timing
        kept = self._keep[:, None]
        return transition * kept


def _period_motion(rollout: Rollout, unit: Array) -> PeriodMotion:
    """Motion over all steps of a rollout together, in units (2 n,) of coordinates and rates."""
    by_tension = rollout.by_tension.copy()
    by_force = rollout.by_force.copy()
    by_state = np.eye(unit.size)
    for k, step in enumerate(rollout.by_state):
        by_state = step @ by_state
        by_tension[:k] = step @ by_tension[:k]
        by_force[:k] = step @ by_force[:k]
    return PeriodMotion(
        q=rollout.q,
        q_dot=rollout.q_dot,
        effects=rollout.effects[-1],
        by_state=by_state * unit / unit[:, None],
        by_tension=by_tension / unit[:, None],
        by_force=by_force / unit[:, None],
    )
