"""Smith predictor: control of an arm whose commands arrive late.

The delay is known, or estimated; it is counted in control periods.
"""

import numpy as np

from soft_tendon_env.control.protocol import FAILURES, ControllerInput
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.tools.types import Array

# share of a period by which a delay may differ from whole periods and still count as them
SAME = 1e-9


def whole_periods(delay: float, period: float) -> tuple[int, float]:
    """Number of whole periods in a delay [s], and the rest [s]."""
    whole = int(delay / period + SAME)
    rest = delay - whole * period
    if rest <= SAME * period:
        rest = 0.0
    return whole, rest


class SmithPredictor:
    """Smith predictor: predicts the state at which the present command will act.

    It simulates the commands in transit.

    O. J. M. Smith, Closer control of loops with dead time, Chem. Eng. Progress 53, 1957.

    Args:
        model: of the arm.
        latency: [s] of commands, the greatest where it is told for every situation.
        period: [s] of control.
    """

    def __init__(self, model: Model, latency: float, period: float) -> None:
        self.latency = latency
        self._period = period
        self._model = model
        self._simulation = Simulation(model)
        self.history = whole_periods(latency, period)[0] + 1

    def predict(
        self, now: ControllerInput, sent: tuple[Array, ...], latency: float | None = None
    ) -> ControllerInput:
        """Predicted controller input at the time when the command issued now takes effect.

        Args:
            now: the present one.
            sent: tensions (n_a,) [N] of the last `history` periods, the newest last.
            latency: [s], None: as known.

        Returns:
            The prediction; the present one if the simulation fails.
        """
        if latency is None:
            latency = self.latency
        periods, rest = whole_periods(latency, self._period)
        waiting = sent[-periods - 1 :]
        if now.input_error is not None:
            gain, offset = now.input_error
            waiting = tuple(gain * tension + offset for tension in waiting)
        first, *others = waiting
        try:
            self._simulation.reset(now.q, now.q_dot, time=now.time, tension=first)
            with erring_actuators():  # gain and offset may exceed the limits
                self._simulation.step(first, rest)
                for tension in others:
                    self._simulation.step(tension, self._period)
            # the measured tip moves as the model's does
            model_tip_pose = self._model.tip_pose(now.q)
            moved = np.linalg.solve(model_tip_pose, self._simulation.tip_pose)
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
