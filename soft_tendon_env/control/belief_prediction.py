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
from soft_tendon_env.control.command_filter import mean_weights, weight_slopes, whole_periods
from soft_tendon_env.control.force_errors import corrected_rollout
from soft_tendon_env.control.protocol import FAILURES, Measurement
from soft_tendon_env.control.uncertainty import Setting
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.tools.types import Array

UNIFORM = 1.0 / np.sqrt(12.0)
"""Standard deviation of what is anywhere within a unit."""


class ActingTension(NamedTuple):
    """Tensions that act over the last period, before gains and offsets.

    The period has S steps of equal length: one where the timing is found, and as many as hypotheses
    on the latency differ by within it.
    """

    steps: Array  # (S, parts, n_a) [N] means of parts of the steps
    seconds: Array  # (parts,) [s] that the parts of every step last
    slopes: Array  # (2, n_a) [N/s] of the mean over the period, by latency and lag
    hypotheses: Array | None  # (H, S, n_a) [N] means of steps by hypothesis, where there is a bank

    @property
    def means(self) -> Array:
        """Means (S, n_a) [N] of the steps."""
        return np.einsum("p,spt->st", self.seconds / self.seconds.sum(), self.steps)


class PeriodMotion(NamedTuple):
    """Motion over a period of S steps, and its derivatives by what acts throughout it.

    Derivatives are of scaled coordinates and rates at its end.
    """

    q: Array  # (2, n) when it begins and ends
    q_dot: Array  # (2, n)
    effects: Array  # internal states of the effects at its end
    by_state: Array  # (2 n, 2 n) by scaled coordinates and rates
    by_tension: Array  # (S, 2 n, n_a) by tensions in each of the steps
    by_force: Array  # (2 n, n) by generalised forces


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
        self._simulation = Simulation(space.model)
        # change of the state in a period: the variance of its walks, and what is not forgotten
        walks = space.variances(
            z=0.0,
            v=0.0,
            offset=uncertainty.offset * space.tension,
            gain=uncertainty.gain,
            tip=uncertainty.tip * space.tip,
            load=uncertainty.load * space.weight,
            stiffness=uncertainty.stiffness,
            damping=uncertainty.damping,
            payload=uncertainty.payload * space.mass,
            latency=uncertainty.latency if setting.latency is None else 0.0,
            lag=uncertainty.lag if setting.lag is None else 0.0,
        )
        self._drift = walks * self.period
        self._keep = np.ones(space.layout.size)
        times = np.array([uncertainty.offset_time, uncertainty.gain_time])  # 0 s forgets at once
        offset_kept, gain_kept = np.exp(-self.period / times)
        self._keep[space.layout.offset] = offset_kept
        self._keep[space.layout.gain] = gain_kept
        self._white_tension = uncertainty.tension * space.tension
        self._force_unit = space.model.bending_energy / space.scale
        self._white_force = uncertainty.force
        self._inertial = uncertainty.inertial
        self._jump = uncertainty.load_jump * space.weight

    def predict(self, last: Belief, measured: Measurement, weight: Array | None) -> Belief | None:
        """Belief after a period; None where the model has no such motion.

        Args:
            last: belief a period ago.
            measured: now, of which the commands are used.
            weight: (H,) of hypotheses, under whose mean command the motion is linearised; None:
                there is no bank.

        Returns:
            The belief.
        """
        layout = self.space.layout
        acting = self._acting(last, measured, weight)
        motion = self._motion(last, measured, acting)
        if motion is None:
            return None
        moving = slice(layout.v.stop)
        gain = 1.0 + last.mean[layout.gain]
        by_tension = motion.by_tension.sum(axis=0)
        transition = self._transition(last, motion, acting)
        white_tension = self._white_tension
        bank = last.bank
        if acting.hypotheses is not None and bank is not None:
            # what lies between two hypotheses
            between = UNIFORM * timing_bank.LATENCY_STEP * gain * acting.slopes[0]
            white_tension = np.hypot(white_tension, between)
            deviation = transition @ bank.deviation
            apart = gain * (acting.hypotheses - acting.means)
            deviation[moving] += np.einsum("sit,hst->ih", motion.by_tension, apart)
            bank = bank._replace(deviation=deviation)
        white_force = self._white_forces(last, motion)
        moved = np.column_stack([by_tension * white_tension, motion.by_force * white_force])
        noise = moved @ moved.T
        covariance = transition @ last.covariance @ transition.T
        covariance[moving, moving] += noise
        covariance[np.diag_indices_from(covariance)] += self._drift
        mean = self._keep * last.mean
        mean[layout.z] = motion.q[1] / self.space.scale
        mean[layout.v] = motion.q_dot[1] / self.space.scale
        return Belief(
            mean=mean,
            covariance=covariance,
            noise=noise,
            jump=self._jump * transition[:, layout.load],
            effects=motion.effects,
            bank=bank,
            locality=last.locality,
        )

    def _acting(self, last: Belief, measured: Measurement, weight: Array | None) -> ActingTension:
        """Tensions that act over the last period, by the believed timing or by a weight (H,)."""
        period = self.period
        timing = self.space.timing(last.mean)
        slopes = np.array(weight_slopes(timing, period, self.history, -period, period))
        hypotheses = None
        if last.bank is None or weight is None:
            # before and after a command arrives
            _, rest = whole_periods(timing.latency, period)
            starts = (-period, rest - period)
            seconds = np.array([rest, period - rest])
            weights = [
                mean_weights(timing, period, self.history, start, duration)
                for start, duration in zip(starts, seconds.tolist(), strict=True)
            ]
            steps = (np.array(weights) @ measured.sent)[None]
        else:
            count = math.ceil(period / timing_bank.LATENCY_STEP)
            seconds = np.array([period / count])
            of_bank = [
                mean_weights(
                    last.bank.timing, period, self.history, k * seconds[0] - period, seconds[0]
                )
                for k in range(count)
            ]
            hypotheses = np.stack(of_bank, axis=1) @ measured.sent
            steps = np.einsum("h,hst->st", weight, hypotheses)[:, None]
        return ActingTension(
            steps=steps,
            seconds=seconds,
            slopes=slopes @ measured.sent,
            hypotheses=hypotheses,
        )

    def _motion(
        self, last: Belief, measured: Measurement, acting: ActingTension
    ) -> PeriodMotion | None:
        """Motion over the last period; None where the model has none."""
        layout = self.space.layout
        q, q_dot = self.space.coordinates(last.mean)
        error = self.space.force_error(last.mean, last.locality)
        tension = (1.0 + last.mean[layout.gain]) * acting.steps + last.mean[layout.offset]
        start = measured.time - self.period
        try:
            self._simulation.reset(q, q_dot, time=start, effects=last.effects)
            rollout = corrected_rollout(self._simulation, tension, acting.seconds, error)
        except FAILURES:
            return None
        return _period_motion(rollout, np.tile(self.space.scale, 2))

    def _white_forces(self, last: Belief, motion: PeriodMotion) -> Array:
        """Standard deviations (n,) of white forces: always, and by the inertial forces M q_ddot.

        These are a mean over all coordinates, in units of those that bend the arm by 1 rad.
        """
        change = (motion.q_dot[1] - motion.q_dot[0]) / self.period
        shares = last.locality.terms.mass @ change / self._force_unit
        inertial = self._inertial * np.sqrt(np.mean(shares**2))
        return np.hypot(self._white_force, inertial) * self._force_unit

    def _transition(self, last: Belief, motion: PeriodMotion, acting: ActingTension) -> Array:
        """Transition F (m, m) of deviations over a period.

        A bank has the deviations by timing itself, see `predict`.
        """
        layout = self.space.layout
        terms = last.locality.terms
        tip = terms.tip_jacobian[3:]
        gain = 1.0 + last.mean[layout.gain]
        _, last_q_dot = self.space.coordinates(last.mean)
        q = motion.q.mean(axis=0)
        q_dot = motion.q_dot.mean(axis=0)
        q_ddot = (motion.q_dot[1] - motion.q_dot[0]) / self.period
        forces = {
            layout.stiffness.start: -terms.stiffness @ q,
            layout.damping.start: -terms.damping @ q_dot,
            layout.payload.start: -tip.T @ tip_acceleration(terms, last_q_dot, q_ddot),
        }
        by_tension = motion.by_tension.sum(axis=0)
        transition = np.eye(layout.size)
        moving = slice(layout.v.stop)
        transition[moving, moving] = motion.by_state
        transition[moving, layout.offset] = by_tension
        transition[moving, layout.gain] = np.einsum("sit,st->it", motion.by_tension, acting.means)
        transition[moving, layout.load] = motion.by_force @ last.locality.load_jacobian
        for column, force in forces.items():
            transition[moving, column] = motion.by_force @ force
        if last.bank is None:
            timing = slice(layout.latency.start, layout.lag.stop)
            transition[moving, timing] = by_tension @ (gain * acting.slopes).T
        return transition * self._keep[:, None]


def _period_motion(rollout: Rollout, unit: Array) -> PeriodMotion:
    """Motion over all steps of a rollout together, in units (2 n,) of coordinates and rates."""
    by_tension = rollout.by_tension.copy()
    by_state = np.eye(unit.size)
    by_force = np.zeros_like(rollout.by_force[0])
    for k, step in enumerate(rollout.by_state):
        by_state = step @ by_state
        by_force = step @ by_force + rollout.by_force[k]
        by_tension[:k] = step @ by_tension[:k]
    return PeriodMotion(
        q=rollout.q[[0, -1]],
        q_dot=rollout.q_dot[[0, -1]],
        effects=rollout.effects[-1],
        by_state=by_state * unit / unit[:, None],
        by_tension=by_tension / unit[:, None],
        by_force=by_force / unit[:, None],
    )
