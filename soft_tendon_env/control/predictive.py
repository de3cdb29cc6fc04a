"""Model-predictive control on the reduced model: the tensions of the next periods that bring the
arm nearest to the target.

Every period the last plan is played through the model (exactly: with the simulation's own steps),
the motion linearised about that (`Simulation.rollout`), and the plan improved by one quadratic
program with bounds: the real-time iteration of Diehl, Bock and Schlöder (2005). What the model does
not know is estimated and allowed for: tensions that would explain how the last period differed from
its prediction (a momentum observer, unless an estimator has found an InputError), and the
displacement between the tip that is measured and that of the model. Internal states of effects
begin at rest with the episode and are advanced by the model.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import DECADES, implicit_inertia
from soft_tendon_env.control.objectives import Objective
from soft_tendon_env.control.protocol import (
    FAILURES,
    ControllerInput,
    ControllerOutput,
    InputError,
    ModelController,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.types import Array


class Plan(NamedTuple):
    """A plan, kept from period to period."""

    tension: Array  # (N, n_a) [N] from the period that has passed on
    multipliers: Array  # of their program
    disturbance: Array  # (n_a,) [N]
    response: Array  # (n, n_a) of the rates now to tensions over the period that has passed
    rates: Array | None  # (n,) predicted for now, if they could be
    effects: Array | None  # (m,) internal states of the effects likewise


class Tuning(NamedTuple):
    """Weights and horizon of a model-predictive controller; efforts and errors are measured by what
    they do to the task."""

    settling_time: float = (
        0.3  # [s] within which errors that are there now are planned to fall to 2 %
    )
    horizon: int = 6  # intervals to plan
    # control periods that an interval lasts, in which tensions stay as they are (move blocking)
    hold: int = 1
    effort: float = 3e-3  # weight of tensions against that of errors
    smoothness: float = 0.42  # the same of their changes from period to period
    observer: float = (
        0.25  # share of the unexplained motion that is taken for a disturbance every period, 0 to 1
    )

    @property
    def looks_ahead(self) -> int:
        """Control periods ahead for which the target is needed."""
        return self.horizon * self.hold + 1


DEFAULT = Tuning()


class Predictive(ModelController):
    """Model-predictive controller by real-time iterations: `objective` is the error to drive to
    zero, `tuning` has weights and horizon."""

    def __init__(
        self,
        model: Model,
        limits: Array,
        period: float,
        objective: Objective,
        tuning: Tuning = DEFAULT,
    ) -> None:
        super().__init__(model, limits, period)
        self.objective, self.horizon = objective, tuning.horizon
        self._hold, self._interval = tuning.hold, tuning.hold * period
        self.observer, self._decay = (
            tuning.observer,
            np.exp(-DECADES * self._interval / tuning.settling_time),
        )
        size = self.least.size
        self._change = np.eye(self.horizon * size) - np.eye(self.horizon * size, k=-size)
        self._effort, self._smoothness = tuning.effort**2, tuning.smoothness**2 * self._change.T
        self._penalty = self._effort * np.eye(self.horizon * size) + self._smoothness @ self._change
        rest = np.zeros(model.coordinate_count)
        self._inertia = implicit_inertia(model.terms(rest, rest), period)
        self._simulation = Simulation(model)

    def act(self, now: ControllerInput, memory: Plan | None = None) -> ControllerOutput:
        """First tensions of the improved plan. Where the model cannot follow its plan, the last
        ones are held and the plan begins anew."""
        size, N = self.least.size, self.horizon
        last = np.clip(now.tension, self.least, self.greatest)
        plan = np.tile(last, (N, 1))
        if memory is not None:  # a period later
            share = 1.0 / self._hold
            plan = (1.0 - share) * memory.tension + share * np.vstack(
                [memory.tension[1:], memory.tension[-1:]]
            )
        error = now.input_error or InputError(
            np.ones(size), np.zeros(size) if memory is None else self._observe(memory, now)
        )
        try:
            self._simulation.reset(
                now.q, now.q_dot, time=now.time, effects=None if memory is None else memory.effects
            )
            with erring_actuators():
                rollout = self._simulation.rollout(error.gain * plan + error.offset, self._interval)
        except FAILURES:
            return self.hold(now)
        hessian, gradient = self._program(rollout, error.gain, now)
        offset = plan.ravel()
        change = self._change @ offset
        change[:size] -= last
        unit = np.trace(hessian) / offset.size
        hessian = hessian + unit * self._penalty
        gradient = gradient + unit * (self._effort * offset + self._smoothness @ change)
        least, greatest = np.tile(self.least, N) - offset, np.tile(self.greatest, N) - offset
        found = allocate(
            hessian, gradient, least, greatest, None if memory is None else memory.multipliers
        )
        better = plan + found.x.reshape(N, size)
        rates = effects = (
            None  # predicted for the end of the period, where the model has such a motion
        )
        try:
            with erring_actuators():
                self._simulation.step(error.gain * better[0] + error.offset, self.period)
            rates, effects = self._simulation.state.q_dot, self._simulation.state.effects
        except FAILURES:
            pass
        response = rollout.by_tension[0, now.q.size :] / self._hold
        improved = Plan(better, found.multipliers, error.offset, response, rates, effects)
        return self.output(
            better[0], improved, not found.solved, disturbance=float(np.abs(error.offset).max())
        )

    def _observe(self, memory: Plan, now: ControllerInput) -> Array:
        """The disturbance, moved by the share of the last period's unexplained change of momentum
        that tensions explain."""
        if memory.rates is None:
            return memory.disturbance
        push = memory.response.T @ self._inertia
        explained = np.linalg.lstsq(
            push @ memory.response, push @ (now.q_dot - memory.rates), rcond=1e-6
        )[0]
        return np.asarray(memory.disturbance + self.observer * explained)

    def _program(self, rollout: Rollout, gain: Array, now: ControllerInput) -> tuple[Array, Array]:
        """Hessian and gradient of the squared errors by changes of the plan (N * n_a,)."""
        n, size, N, aim = now.q.size, gain.size, self.horizon, self.objective
        reference = aim.seen_from(rollout.tip_pose[0], now.reference, now.tip_pose)
        error = [
            aim.error(rollout.q[k], rollout.tip_pose[k], reference, k * self._interval)
            for k in range(N + 1)
        ]
        change, slopes, left = np.zeros((2 * n, N * size)), [], []
        for k in range(N):
            given = slice(k * size)  # the tensions that have acted before
            change[:, given] = rollout.by_state[k] @ change[:, given]
            change[:, k * size : (k + 1) * size] = rollout.by_tension[k] * gain
            slopes.append(aim.jacobian(rollout.tip_jacobian[k + 1]) @ change[:n])
            left.append(error[k + 1] - self._decay ** (k + 1) * error[0])
        slope = np.concatenate(slopes)
        return slope.T @ slope, -slope.T @ np.concatenate(left)
