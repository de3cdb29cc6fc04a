"""Task-space feedback linearisation (39) in implicit form.

It works at the control period that there is, within tension limits, against model error.

The acceleration of the tip is asked for as in (39). Which tensions give it is asked of the implicit
step of the motion; of all that do, those are taken that disturb least the arm's motion under the
tensions which would hold the target (Gauss's principle of least constraint). At vanishing periods,
without static tensions, the law is (39).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import ImplicitStep, discrete_gains, implicit_step
from soft_tendon_env.control.objectives import Aim, TrackedObjective
from soft_tendon_env.control.protocol import (
    FAILURES,
    ControllerInput,
    ControllerOutput,
    InputError,
    ModelController,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

# least over greatest singular value of the map from tensions to the task, below which the task
# counts as singular
SINGULAR = 1e-3
# weights against that of the task
FREE = 1e-3  # of leaving the arm to itself
STATIC = 0.1  # of leaving it to the static tensions, where they are known


class TipMemory(NamedTuple):
    """The integral of the error (k,) and the multipliers (n_a,) of the last allocation."""

    integral: Array
    multipliers: Array


class TipTracking(ModelController):
    """Tip tracking by implicit feedback linearisation and tension allocation.

    For the gains, and what is raised, see `discrete_gains`.
    """

    def __init__(
        self,
        model: Model,
        limits: Array,
        period: float,
        objective: TrackedObjective,
        *,
        settling_time: float = 0.2,
        damping: float = 1.0,
        integral_time: float | None = None,
    ) -> None:
        super().__init__(model, limits, period)
        self.objective = objective
        self.gains = discrete_gains(settling_time, damping, period, integral_time)

    def act(self, now: ControllerInput, memory: TipMemory | None = None) -> ControllerOutput:
        """Tensions of the implicit law; memory: integral and multipliers of the last period."""
        h = self.period
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)
            step = implicit_step(terms, now.q_dot, h)
        except FAILURES:
            return self.hold(now, memory)
        aim = self.objective.aim(now, terms, 0.0, h)
        next_aim = self.objective.aim(now, terms, h, h)
        integral = np.zeros_like(aim.error)
        multipliers = None
        if memory is not None:
            integral = memory.integral
            multipliers = memory.multipliers
        velocity = self._next_velocity(aim, next_aim, integral, now.q_dot)
        step, static = _allowing_for(now.input_error, step, now.reference.tension)
        # the task: jacobian (free + response u) + h bias = velocity
        task = aim.jacobian @ step.response
        by_itself = aim.jacobian @ step.free
        missing = velocity - by_itself - h * aim.bias
        # besides, the least motion by other tensions than the static ones
        if static is None:
            weight = FREE
            preferred = np.zeros_like(self.least)
        else:
            weight = STATIC
            preferred = static
        task_metric = task.T @ task
        scale = weight * np.trace(task_metric) / np.trace(step.metric)
        passive = scale * step.metric
        hessian = task_metric + passive
        gradient = -task.T @ missing - passive @ preferred
        least, greatest = self.reachable(now)
        allocation = allocate(hessian, gradient, least, greatest, multipliers)
        # the integral does not wind up by what cannot be done: by what the limits refuse, and in
        # directions in which no tensions move the tip
        unlimited, *_ = np.linalg.lstsq(hessian, -gradient, rcond=None)
        lacking = unlimited - allocation.x
        refused = task @ lacking / h
        ways = _open_ways(task)
        along_ways = ways.T @ aim.error
        resolved = ways @ along_ways
        growth = resolved - refused / self.gains.kp
        next_memory = TipMemory(integral + h * growth, allocation.multipliers)
        directions, open_directions = ways.shape
        is_singular = open_directions < directions
        has_failed = not allocation.solved or is_singular
        return self.output(allocation.x, next_memory, has_failed)

    def _next_velocity(self, aim: Aim, next_aim: Aim, integral: Array, q_dot: Array) -> Array:
        """Velocity (k,) that the law asks for at the end of the period: target and feedback."""
        gains = self.gains
        velocity = aim.jacobian @ q_dot
        # of the target over the period that has passed, of which `velocity` is the end
        last_target_velocity = 2.0 * aim.velocity - next_aim.velocity
        feedback = (
            gains.kp * aim.error
            + gains.kd * (last_target_velocity - velocity)
            + gains.ki * integral
        )
        return velocity + self.period * feedback + aim.velocity - last_target_velocity


def _allowing_for(
    error: InputError | None, step: ImplicitStep, static: Array | None
) -> tuple[ImplicitStep, Array | None]:
    """Step and static tensions in terms of the tensions that are asked for.

    An estimator has found an error of the inputs.
    """
    if error is None:
        return step, static
    gain, offset = error
    corrected = ImplicitStep(
        free=step.free + step.response @ offset,
        response=step.response * gain,
        metric=step.metric * gain * gain[:, None],
    )
    return corrected, None if static is None else (static - offset) / gain


def _open_ways(task: Array) -> Array:
    """Orthonormal directions (k, r) of the task in which tensions move the tip at all."""
    ways, scale, _ = np.linalg.svd(task)
    is_open = scale > SINGULAR * scale[0]
    columns = ways[:, : scale.size]
    return np.asarray(columns[:, is_open])
