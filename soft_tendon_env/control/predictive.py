"""Model-predictive control on the reduced model: the tensions of the next periods that bring the arm nearest to the target.

Every period the last plan is played through the model (exactly: with the simulation's own steps), the motion linearised about that
with the implicit step's matrices, and the plan improved by one quadratic program with bounds: the real-time iteration of Diehl, Bock
and Schlöder (2005). What the model does not know is estimated and allowed for: tensions that would explain how the last period
differed from its prediction (a momentum observer, unless an estimator has found an InputError), and the displacement between the tip that
is measured and that of the model.

Effects of the model act at their time: disturbances and a base that moves are foreseen. Their internal states, of memory and friction, are
not measured: they begin at rest with the episode and are advanced by the model, from the measured coordinates of every period.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import LinearConstraints, allocate
from soft_tendon_env.control.dynamics import DECADES, ImplicitStep, implicit_step, slowest_mode
from soft_tendon_env.control.objectives import Dynamics, Objective
from soft_tendon_env.control.protocol import FAILURES, Decision, InputError, Reference, Situation
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.types import Array

HORIZON = 6
"""Periods that are planned, unless said otherwise."""
RESOLVED = 0.3
"""Phase [rad] of the slowest mode that one implicit step of the linearised motion may cover."""


class Plan(NamedTuple):
    """A plan, kept from period to period.

    tension (N, n_a) [N] from the period that has passed on, the multipliers of their program, the disturbance (n_a,) [N], and the rates
    (n,) and internal states (m,) of the effects predicted for now, if they could be.
    """

    tension: Array
    multipliers: Array
    disturbance: Array
    rates: Array | None
    effects: Array | None


class Tuning(NamedTuple):
    """Weights, horizon and bounds of a model-predictive controller.

    Attributes:
        settling_time: [s], within which errors that are there now are planned to fall to 2 %.
        horizon: intervals to plan.
        hold: control periods that an interval lasts, in which tensions stay as they are (move blocking).
        effort: weight of tensions against that of errors, where both are measured by what they do to the task.
        smoothness: the same of changes from period to period.
        tension_rate: greatest change of tensions [N/s]; None: any.
        observer: share of the unexplained motion that is taken for a disturbance every period, 0 to 1.
    """

    settling_time: float = 0.3
    horizon: int = HORIZON
    hold: int = 1
    effort: float = 3e-3
    smoothness: float = 0.5
    tension_rate: float | None = None
    observer: float = 0.2

    @property
    def looks_ahead(self) -> int:
        """Control periods ahead for which the target is needed."""
        return self.horizon * self.hold + 1


DEFAULT = Tuning()


class Predictive:
    """Model-predictive controller by real-time iterations, for an arm of n_a tendons.

    Args:
        model: what the controller believes.
        limits: (n_a, 2) least and greatest tension [N].
        period: [s] of control.
        objective: the error to drive to zero.
        tuning: weights, horizon and bounds.
    """

    def __init__(self, model: Model, limits: Array, period: float, objective: Objective, tuning: Tuning = DEFAULT) -> None:
        self.model, self.period, self.objective, self.horizon = model, period, objective, tuning.horizon
        self.least, self.greatest = limits.T.copy()
        self._hold, self._interval = tuning.hold, tuning.hold * period
        self.observer, self._decay = tuning.observer, np.exp(-DECADES * self._interval / tuning.settling_time)
        size = self.least.size
        lasts = np.repeat([period, *[self._interval] * (self.horizon - 1)], size)  # first changes have a period, whatever the interval
        self._reach = None if tuning.tension_rate is None else tuning.tension_rate * lasts
        self._change = np.eye(self.horizon * size) - np.eye(self.horizon * size, k=-size)
        self._effort, self._smoothness = tuning.effort**2, tuning.smoothness**2
        self._substeps = int(np.ceil(self._interval * slowest_mode(model).frequency / RESOLVED))
        self._simulation = Simulation(model)

    def act(self, now: Situation, memory: Plan | None = None) -> Decision:
        """First tensions of the improved plan. Where the model cannot follow its plan, the last ones are held and the plan begins anew."""
        size, N = self.least.size, self.horizon
        last = np.clip(now.tension, self.least, self.greatest)
        plan = np.tile(last, (N, 1)) if memory is None else _later(memory.tension, self._hold)
        effects = None if memory is None else memory.effects
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time, effects=effects)
            step = implicit_step(terms, now.q_dot, self._interval / self._substeps)
            error = now.input_error or InputError(np.ones(size), np.zeros(size) if memory is None else self._observed(memory, now, step))
            reference = self.objective.seen_from(terms.tip_pose, now.reference, now.tip_pose)
            hessian, gradient = self._program(terms, step, now, effects, plan, error, reference)
        except FAILURES:
            return Decision(last, None, {"limited": 1.0, "singular": 1.0})
        offset = plan.ravel()
        change = self._change @ offset
        change[:size] -= last
        unit = np.trace(hessian) / offset.size
        hessian = hessian + unit * (self._effort * np.eye(offset.size) + self._smoothness * self._change.T @ self._change)
        gradient = gradient + unit * (self._effort * offset + self._smoothness * self._change.T @ change)
        least, greatest = np.tile(self.least, N) - offset, np.tile(self.greatest, N) - offset
        changes = None if self._reach is None else LinearConstraints(self._change, -self._reach - change, self._reach - change)
        found = allocate(hessian, gradient, least, greatest, None if memory is None else memory.multipliers, changes)
        better = plan + found.x.reshape(N, size)
        report = {"limited": found.limited, "singular": float(not found.solved), "disturbance": float(np.abs(error.offset).max())}
        rates, effects = self._predicted(now, effects, error.gain * better[0] + error.offset)
        return Decision(better[0], Plan(better, found.multipliers, error.offset, rates, effects), report)

    def _observed(self, memory: Plan, now: Situation, step: ImplicitStep) -> Array:
        """The disturbance, moved by the share of the last period's unexplained change of momentum that tensions explain."""
        if memory.rates is None:
            return memory.disturbance
        residual = now.q_dot - memory.rates
        response = self._substeps / self._hold * step.response
        stiff = response.T @ step.system @ response
        explained = np.linalg.lstsq(stiff, response.T @ (step.system @ residual), rcond=1e-6)[0]
        return np.asarray(memory.disturbance + self.observer * explained)

    def _predicted(self, now: Situation, effects: Array | None, tension: Array) -> tuple[Array, Array] | tuple[None, None]:
        """The rates (n,) and internal states (m,) after a period under these tensions, None where the model has no such motion."""
        try:
            self._simulation.reset(now.q, now.q_dot, time=now.time, effects=effects)
            self._simulation.step(tension, self.period)
        except FAILURES:
            return None, None
        state = self._simulation.state
        return state.q_dot, state.effects

    def _program(
        self, terms: Terms, step: ImplicitStep, now: Situation, effects: Array | None, plan: Array, error: InputError, reference: Reference
    ) -> tuple[Array, Array]:
        """Hessian and gradient of the squared errors by changes of the plan (N * n_a,)."""
        h, part, size = self._interval, self._interval / self._substeps, self.least.size
        count = plan.size
        dq, dv = np.zeros((now.q.size, count)), np.zeros((now.q.size, count))
        hessian, gradient = np.zeros((count, count)), np.zeros(count)
        present = self.objective.aim(Dynamics(now.q, now.q_dot, terms), reference, 0.0, h).error
        self._simulation.reset(now.q, now.q_dot, time=now.time, effects=effects)
        for k, tension in enumerate(plan):
            self._simulation.step(error.gain * tension + error.offset, h)
            state = self._simulation.state
            given = slice((k + 1) * size)  # the tensions that have acted by then
            for _ in range(self._substeps):
                loads = terms.mass @ dv[:, given] - part * ((terms.stiffness + terms.external_stiffness) @ dq[:, given])
                dv[:, given] = np.linalg.solve(step.system, loads)
                dv[:, k * size : (k + 1) * size] += step.response * error.gain
                dq[:, given] += part * dv[:, given]
            terms = self.model.terms(state.q, state.q_dot, time=state.time, effects=state.effects)
            step = implicit_step(terms, state.q_dot, part)
            aim = self.objective.aim(Dynamics(state.q, state.q_dot, terms), reference, (k + 1) * h, h)
            slope = aim.jacobian @ dq[:, given]
            hessian[given, given] += slope.T @ slope
            gradient[given] -= slope.T @ (aim.error - self._decay ** (k + 1) * present)
        return hessian, gradient


def _later(plan: Array, hold: int) -> Array:
    """A plan (N, n_a) of intervals of `hold` periods, a period later."""
    share = 1.0 / hold
    return (1.0 - share) * plan + share * np.vstack([plan[1:], plan[-1:]])
