"""Model-predictive control on the reduced model.

It finds the tensions of the next periods that bring the arm nearest to the target.

Every period the last plan is played through the model (exactly: with the simulation's own steps),
the motion linearised about that (`Simulation.rollout`), and the plan improved by one quadratic
program with bounds: the real-time iteration of Diehl, Bock and Schlöder (2005). What the model does
not know is estimated and allowed for: tensions that would explain how the last period differed from
its prediction (a momentum observer, unless an estimator has found errors of inputs and forces), the
lag of the actuators, and the displacement between the tip that is measured and that of the model.
Internal states of effects begin at rest with the episode and are advanced by the model.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import Allocation, Rows, allocate
from soft_tendon_env.control.command_filter import lagged_plan
from soft_tendon_env.control.dynamics import DECADES, implicit_inertia
from soft_tendon_env.control.force_errors import SLIDING_SPEED, corrected_rollout
from soft_tendon_env.control.objectives import LinearError, Objective, Posture
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
    # (n,) predicted for now, if they could be, where disturbances are observed
    rates: Array | None
    # (m,) internal states of the effects likewise, where there are any
    effects: Array | None


class Tuning(NamedTuple):
    """Weights and horizon of a model-predictive controller.

    Efforts and errors are measured by what they do to the task. Settling time and both weights are
    those of configs/tuned_predictive.toml.
    """

    # [s] within which errors that are there now are planned to fall to 2 %; far ones take longer
    # under unknown loads
    settling_time: float = 0.174
    horizon: int = 12  # intervals to plan
    # control periods that an interval lasts, in which tensions stay as they are (move blocking)
    hold: int = 1
    effort: float = 4.7e-3  # weight of tensions against that of errors
    smoothness: float = 0.295  # the same of their changes from period to period
    # share of the unexplained motion that is taken for a disturbance every period, 0 to 1
    observer: float = 0.25

    @property
    def looks_ahead(self) -> int:
        """Control periods ahead for which the target is needed."""
        return self.horizon * self.hold + 1


DEFAULT = Tuning()
# more weight of smoothness for every period by which the arrival of commands is uncertain
CAUTION = 4.0
# most further weight of smoothness: where squares of innovations are twice what is expected
DOUBT = 10.0
# more weight of smoothness where unknown loads bend the arm by a radian or more, and nothing limits
# how tensions change: where the arm cannot hold its target, such plans swing from one limit of
# tensions to the other. Found with FAR, see docs/appendix/what_was_tried.md
LOADED = 3.0
# more of the speed at which friction is whole, for every period by which the state is predicted: a
# plan that trusts in a late direction of sliding swings about it
BLUR = 2.0
# relative singular value below which motions are not explained by tensions
EXPLAINED = 1e-6
# share of the rod's length above which errors are far where unknown loads bend it by a radian; the
# share is twice as large for half the bending. In a quick motion under loads a filter takes what it
# does not yet know of a payload for other errors
FAR = 0.075


class Predictive(ModelController):
    """Model-predictive controller by real-time iterations.

    Args:
        model: what the controller believes of the arm.
        limits: (n_a, 2) [N] of tensions.
        period: of control [s].
        objectives: the errors to drive to zero, one or several whose squares add up.
        tuning: weights and horizon.
    """

    def __init__(
        self,
        model: Model,
        limits: Array,
        period: float,
        objectives: Objective | Sequence[Objective],
        tuning: Tuning = DEFAULT,
    ) -> None:
        super().__init__(model, limits, period)
        if isinstance(objectives, Sequence):
            self.objectives = tuple(objectives)
        else:
            self.objectives = (objectives,)
        self.observer = tuning.observer
        self.horizon = tuning.horizon
        self._hold = tuning.hold
        self._interval = tuning.hold * period
        # time constants of errors in an interval, and the factor by which they are planned to fall
        self._time_constants = DECADES * self._interval / tuning.settling_time
        self._decay = np.exp(-self._time_constants)
        # changes of a plan (N n_a,) from interval to interval, and the weight of plan and changes
        size = self.least.size
        plan_size = self.horizon * size
        before = np.eye(plan_size, k=-size)
        self._change = np.eye(plan_size) - before
        self._effort = tuning.effort**2
        self._smoothness = tuning.smoothness**2
        # square of the changes of a plan, a quadratic form of it
        self._roughness = self._change.T @ self._change
        rest = np.zeros(model.coordinate_count)
        terms_at_rest = model.terms(rest, rest)
        self._inertia = implicit_inertia(terms_at_rest, period)
        self._simulation = Simulation(model)
        self._has_states = model.arm.effects.state.size > 0

    def act(self, now: ControllerInput, memory: Plan | None = None) -> ControllerOutput:
        """First tensions of the improved plan.

        Where the model cannot follow its plan, the last ones are held and the plan begins anew.
        """
        last = np.clip(now.tension, self.least, self.greatest)
        plan = self._continued(last, memory)
        error = self._input_error(memory, now)
        try:
            effects = None if memory is None else memory.effects
            self._simulation.reset(now.q, now.q_dot, time=now.time, effects=effects)
            acting_plan = self._acting(plan, error, now, self._interval)
            blur = BLUR * now.lead / self.period
            sliding_speed = SLIDING_SPEED * (1.0 + blur)
            rollout = corrected_rollout(
                self._simulation, acting_plan, self._interval, now.force_error, sliding_speed
            )
        except FAILURES:
            return self.hold(now)
        multipliers = None if memory is None else memory.multipliers
        allocation = self._improvement(rollout, plan, last, error.gain, now, multipliers)
        better = plan + allocation.x.reshape(plan.shape)
        rates, effects = None, None
        response = rollout.by_tension[0, now.q.size :]
        if self._has_states or now.input_error is None:
            (acting,) = self._acting(better[:1], error, now, self.period)
            if self._hold > 1 and now.input_error is None:
                response = self._period_response(acting)
            rates, effects = self._predicted(acting)
        improved = Plan(
            tension=better,
            multipliers=allocation.multipliers,
            disturbance=error.offset,
            response=response,
            rates=rates,
            effects=effects,
        )
        return self.output(
            better[0],
            improved,
            is_singular=not allocation.solved,
            disturbance=float(np.abs(error.offset).max()),
        )

    def _continued(self, last: Array, memory: Plan | None) -> Array:
        """The last plan (N, n_a) a period later, its end held on; at first the last tensions."""
        if memory is None:
            return np.tile(last, (self.horizon, 1))
        # of the tensions of an interval, a period is a share
        share = 1.0 / self._hold
        plan = memory.tension
        last_again = plan[-1:]
        later = np.vstack([plan[1:], last_again])
        return (1.0 - share) * plan + share * later

    def _input_error(self, memory: Plan | None, now: ControllerInput) -> InputError:
        """The estimator's error of the inputs, or else the disturbance that is observed."""
        if now.input_error is not None:
            return now.input_error
        size = self.least.size
        offset = np.zeros(size)
        if memory is not None:
            offset = self._observe(memory, now)
        return InputError(np.ones(size), offset)

    def _improvement(
        self,
        rollout: Rollout,
        plan: Array,
        last: Array,
        gain: Array,
        now: ControllerInput,
        multipliers: Array | None,
    ) -> Allocation:
        """Change (N n_a,) of a plan by the quadratic program about its rollout.

        The program has errors, tensions and changes from the last tensions (n_a,) on.
        """
        hessian, gradient = self._program(rollout, gain, now)
        tension = plan.ravel()
        change = self._change @ tension
        change[: last.size] -= last
        unit = np.trace(hessian) / tension.size
        spread = now.timing_spread / self.period
        caution = 1.0 + CAUTION * spread
        # a model that lacks a motion may let a bold plan excite it
        excess = min(max(now.surprise - 1.0, 0.0), 1.0)
        doubt = 1.0 + DOUBT * excess
        bending = min(self._bending_by_loads(now), 1.0)
        loaded = 1.0 + LOADED * self._boldness(now) * bending
        smoothness = (caution * doubt * loaded) ** 2 * self._smoothness
        effort = self._effort * np.eye(tension.size)
        penalty = effort + smoothness * self._roughness
        hessian = hessian + unit * penalty
        rough = self._change.T @ change
        penalty_gradient = self._effort * tension + smoothness * rough
        gradient = gradient + unit * penalty_gradient
        least_plan = np.tile(self.least, self.horizon)
        greatest_plan = np.tile(self.greatest, self.horizon)
        least = least_plan - tension
        greatest = greatest_plan - tension
        rows = None
        if now.greatest_change is not None:
            per_interval = self._hold * now.greatest_change
            most = np.tile(per_interval, self.horizon)
            # of the first interval it is the first period that is asked for
            most[: last.size] = now.greatest_change
            lowest = -most - change
            highest = most - change
            rows = Rows(self._change, lowest, highest)
        return allocate(hessian, gradient, least, greatest, multipliers, rows)

    def _period_response(self, tension: Array) -> Array:
        """Response (n, n_a) of the rates to tensions (n_a,) over a period.

        It is no share of that over an interval: a quick arm has swung back by then. Zero where the
        model has no such motion.
        """
        try:
            with erring_actuators():
                rollout = self._simulation.rollout(tension[None], self.period)
        except FAILURES:
            return np.zeros((self.model.coordinate_count, tension.size))
        return rollout.by_tension[0, self.model.coordinate_count :]

    def _predicted(self, tension: Array) -> tuple[Array | None, Array | None]:
        """Rates (n,) and internal states of effects (m,) after a period under tensions (n_a,).

        None where the model has no such motion.
        """
        try:
            with erring_actuators():
                self._simulation.step(tension, self.period)
        except FAILURES:
            return None, None
        state = self._simulation.state
        return state.q_dot, state.effects

    def _observe(self, memory: Plan, now: ControllerInput) -> Array:
        """The disturbance, moved by a share of the last period's unexplained change of momentum.

        The change is that which tensions explain.
        """
        if memory.rates is None:
            return memory.disturbance
        unexplained = now.q_dot - memory.rates
        push = memory.response.T @ self._inertia
        mobility = push @ memory.response
        momentum = push @ unexplained
        tension, *_ = np.linalg.lstsq(mobility, momentum, rcond=EXPLAINED)
        disturbance = memory.disturbance + self.observer * tension
        return np.asarray(disturbance)

    def _acting(
        self, plan: Array, error: InputError, now: ControllerInput, interval: float
    ) -> Array:
        """Mean tensions (k, n_a) [N] that the actuators give.

        A plan (k, n_a) is asked for, each row for an interval [s].
        """
        tension = plan
        if now.actuators is not None:
            by_plan, by_start = self._lagged(now, len(plan), interval)
            from_start = np.outer(by_start, now.actuators.tension)
            tension = by_plan @ plan + from_start
        return error.gain * tension + error.offset

    def _lagged(self, now: ControllerInput, count: int, interval: float) -> tuple[Array, Array]:
        """Mean tensions of k intervals [s] by those asked for (k, k), and by what acts now (k,)."""
        if now.actuators is None:
            return np.eye(count), np.zeros(count)
        return lagged_plan(now.actuators.lag, interval, count)

    def _program(self, rollout: Rollout, gain: Array, now: ControllerInput) -> tuple[Array, Array]:
        """Hessian and gradient of the squared errors by changes of the plan (N * n_a,)."""
        n = now.q.size
        size = gain.size
        N = self.horizon
        plan_size = N * size
        first, *later = self._linear_errors(rollout, now)
        # in metres, whatever the objectives weigh
        unit = np.linalg.norm(first.jacobian) / np.linalg.norm(rollout.tip_jacobian[0, 3:])
        error_size = float(np.linalg.norm(first.error) / unit)
        shares_left = self._shares_left(error_size, now)
        # change of coordinates and rates by the tensions that act, interval by interval
        change = np.zeros((2 * n, plan_size))
        slopes = list[Array]()
        remaining = list[Array]()
        for k, linear in enumerate(later):
            begin = k * size
            earlier = slice(begin)  # tensions that have acted before
            acting = slice(begin, begin + size)
            before = change[:, earlier]
            change[:, earlier] = rollout.by_state[k] @ before
            change[:, acting] = rollout.by_tension[k] * gain
            q_change = change[:n]
            slopes.append(linear.jacobian @ q_change)
            planned = shares_left[k] * first.error
            remaining.append(linear.error - planned)
        # by the tensions that act, then by those of the plan
        by_plan, _ = self._lagged(now, N, self._interval)
        by_acting = np.concatenate(slopes).reshape(-1, N, size)
        by_interval = np.einsum("ekt,kj->ejt", by_acting, by_plan)
        slope = by_interval.reshape(-1, plan_size)
        errors = np.concatenate(remaining)
        return slope.T @ slope, -slope.T @ errors

    def _shares_left(self, size: float, now: ControllerInput) -> Array:
        """Shares (N,) of an error of this size [m] that are planned to be left as intervals end.

        Errors fall exponentially. Under unknown loads a far error falls at a constant speed first,
        at which errors that are not far begin to fall.
        """
        excess = 0.0  # of the size over that of the greatest error that is not far, in such sizes
        bending = self._bending_by_loads(now)
        if bending > 0.0:
            greatest_near = FAR * self.model.length / bending
            excess = max(size / greatest_near - 1.0, 0.0)
        # at the constant speed a time constant takes one such size away
        constant_intervals = excess / self._time_constants
        ends = np.arange(1, self.horizon + 1)
        excess_left = np.maximum(constant_intervals - ends, 0.0) * self._time_constants
        exponential_intervals = np.maximum(ends - constant_intervals, 0.0)
        left = excess_left + self._decay**exponential_intervals
        return np.asarray(left / (1.0 + excess))

    def _boldness(self, now: ControllerInput) -> float:
        """Share of their range by which tensions may change in an interval, at most 1.

        1 where no limit is known: elastic tendons have theirs in metres.
        """
        if now.greatest_change is None:
            return 1.0
        change = self._hold * now.greatest_change.max()
        widest = (self.greatest - self.least).max()
        if change >= widest:
            return 1.0
        return float(change / widest)

    def _bending_by_loads(self, now: ControllerInput) -> float:
        """Angle [rad] of even bending that stores as much energy as loads do, by linear theory.

        They are those that an estimator has found, with the centrifugal force of a payload.
        """
        if now.force_error is None:
            return 0.0
        in_metric = self.model.metric_unit.T @ now.force_error.constant
        return float(np.linalg.norm(in_metric)) / math.sqrt(self.model.bending_energy)

    def _linear_errors(self, rollout: Rollout, now: ControllerInput) -> list[LinearError]:
        """Errors of all objectives where every interval begins, and where the last one ends."""
        references = [
            objective.seen_from(rollout.tip_pose[0], now.reference, now.tip_pose)
            for objective in self.objectives
        ]
        linear = list[LinearError]()
        for k, q in enumerate(rollout.q):
            ahead = k * self._interval
            errors = list[LinearError]()
            for objective, reference in zip(self.objectives, references, strict=True):
                posture = Posture(
                    q=q,
                    tip_pose=rollout.tip_pose[k],
                    tip_jacobian=rollout.tip_jacobian[k],
                    reference=reference,
                    ahead=ahead,
                    time=now.time + ahead,
                )
                errors.append(objective.linear_error(posture))
            together = LinearError(
                np.concatenate([part.error for part in errors]),
                np.concatenate([part.jacobian for part in errors]),
            )
            linear.append(together)
        return linear
