"""Task-space feedback linearisation (39) in implicit form: at the control period that there is,
within tension limits, against model error.

The acceleration of the tip is asked for as in (39). Which tensions give it is asked of the implicit
step of the motion; of all that do, those are taken that disturb least the arm's motion under the
tensions which would hold the target (Gauss's principle of least constraint). At vanishing periods,
without static tensions, the law is (39).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import discrete_gains, implicit_step
from soft_tendon_env.control.objectives import Objective
from soft_tendon_env.control.protocol import (
    FAILURES,
    ControllerInput,
    ControllerOutput,
    ModelController,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

# least over greatest singular value of the map from tensions to the task, below which the task
# counts as singular
SINGULAR = 1e-3
FREE, STATIC = (
    1e-3,
    0.1,
    # weights of leaving the arm to itself, or to the static tensions where they are known, against
    # the task's
)


class TipMemory(NamedTuple):
    """The integral of the error (k,) and the multipliers (n_a,) of the last allocation."""

    integral: Array
    multipliers: Array


class TipTracking(ModelController):
    """Tip tracking by implicit feedback linearisation and tension allocation; for the gains, and
    what is raised, see `discrete_gains`."""

    def __init__(
        self,
        model: Model,
        limits: Array,
        period: float,
        objective: Objective,
        *,
        settling_time: float = 0.2,
        damping: float = 1.0,
        integral_time: float | None = None,
    ) -> None:
        super().__init__(model, limits, period)
        self.objective = objective
        self.gains = discrete_gains(settling_time, damping, period, integral_time)

    def act(self, now: ControllerInput, memory: TipMemory | None = None) -> ControllerOutput:
        h, gains = self.period, self.gains
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)
            step = implicit_step(terms, now.q_dot, h)
        except FAILURES:
            return self.hold(now, memory)
        aim, next_aim = (self.objective.aim(now, terms, time, h) for time in (0.0, h))
        integral = np.zeros_like(aim.error) if memory is None else memory.integral
        velocity = aim.jacobian @ now.q_dot
        last_velocity = (
            2.0 * aim.velocity - next_aim.velocity
        )  # of the target over the period that has passed
        feedback = (
            gains.kp * aim.error + gains.kd * (last_velocity - velocity) + gains.ki * integral
        )
        wanted = velocity + h * feedback + aim.velocity - last_velocity
        (free, response, metric), static = step, now.reference.tension
        if now.input_error is not None:
            gain, offset = now.input_error
            free, response, metric = (
                free + response @ offset,
                response * gain,
                metric * gain * gain[:, None],
            )
            static = None if static is None else (static - offset) / gain
        task = aim.jacobian @ response
        missing = wanted - aim.jacobian @ free - h * aim.bias
        weight, reference = (
            (FREE, np.zeros_like(self.least)) if static is None else (STATIC, static)
        )
        passive = (
            weight * np.trace(task.T @ task) / np.trace(metric) * metric
        )  # of the motion by other tensions than these
        hessian, gradient = task.T @ task + passive, -task.T @ missing - passive @ reference
        found = allocate(
            hessian,
            gradient,
            self.least,
            self.greatest,
            None if memory is None else memory.multipliers,
        )
        ways, scale, _ = np.linalg.svd(task)
        open_ways = ways[:, : scale.size][
            :, scale > SINGULAR * scale[0]
        ]  # directions in which tensions move the tip at all
        refused = (
            task @ (np.linalg.lstsq(hessian, -gradient, rcond=None)[0] - found.x) / h
        )  # by the limits
        integral = integral + h * (
            open_ways @ (open_ways.T @ aim.error) - refused / gains.kp
        )  # no wind-up by what cannot be done
        return self.output(
            found.x,
            TipMemory(integral, found.multipliers),
            not found.solved or open_ways.shape[1] < task.shape[0],
        )
