"""Smith predictor: control of an arm whose commands arrive late by a time that is known, or
estimated; delays in control periods."""

import numpy as np

from soft_tendon_env.control.protocol import FAILURES, ControllerInput
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.types import Array

SAME = (
    1e-9  # share of a period by which a delay may differ from whole periods and still count as them
)


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """Number of whole periods in a delay [s], and the rest [s]."""
    whole = int(delay / period + SAME)
    rest = delay - whole * period
    return whole, rest if rest > SAME * period else 0.0


class SmithPredictor:
    """Smith predictor: simulates the commands in transit to predict the state at which the present
    command will act.

    O. J. M. Smith, Closer control of loops with dead time, Chem. Eng. Progress 53, 1957.
    """

    def __init__(self, model: Model, latency: float, period: float) -> None:
        """latency: [s] of commands, the greatest where it is told for every situation; period: [s]
        of control."""
        self.latency, self._period = latency, period
        self._model, self._simulation = model, Simulation(model)
        self.history = whole_periods(latency, period)[0] + 1

    def predict(
        self, now: ControllerInput, sent: tuple[Array, ...], latency: float | None = None
    ) -> ControllerInput:
        """Predicted controller input at the time when the command issued now takes effect; the
        present one if the simulation fails.

        sent: tensions (n_a,) [N] of the last `history` periods, the newest last. latency: [s], as
        known by default.
        """
        latency = self.latency if latency is None else latency
        periods, rest = whole_periods(latency, self._period)
        waiting = sent[-periods - 1 :]
        if now.input_error is not None:
            waiting = tuple(
                now.input_error.gain * tension + now.input_error.offset for tension in waiting
            )
        try:
            self._simulation.reset(now.q, now.q_dot, time=now.time, tension=waiting[0])
            with erring_actuators():
                self._simulation.step(waiting[0], rest)
                for tension in waiting[1:]:
                    self._simulation.step(tension, self._period)
            moved = np.linalg.solve(self._model.tip_pose(now.q), self._simulation.tip_pose)
        except FAILURES:
            return now
        state = self._simulation.state
        reference = now.reference._replace(ahead=now.reference.ahead - latency)
        return now._replace(
            q=state.q,
            q_dot=state.q_dot,
            tip_pose=now.tip_pose @ moved,
            reference=reference,
            time=state.time,
        )
