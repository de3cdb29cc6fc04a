"""Prediction of an arm to the time at which the present command will arrive.

The commands in transit are known, and what they do until then, through dead time and lag.
"""

import numpy as np

from soft_tendon_env.control.command_filter import (
    Timing,
    mean_weights,
    remembered_commands,
    whole_periods,
)
from soft_tendon_env.control.force_errors import corrected_rollout
from soft_tendon_env.control.protocol import FAILURES, ControllerInput, LaggingActuators
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.tools.types import Array


class ArrivalPredictor:
    """Predicts the state at which the command that is issued now begins to act.

    It plays the filtered commands, under the forces that the model is known to lack (the state
    predictor of O. J. M. Smith, Chem. Eng. Progress 53, 1957, with a lag).

    Args:
        model: of the arm.
        timing: latency and lag [s] of commands, the greatest where situations say their own.
        period: [s] of control.
    """

    def __init__(self, model: Model, timing: Timing, period: float) -> None:
        self.timing = timing
        self._period = period
        self._model = model
        self._simulation = Simulation(model)
        self.history = remembered_commands(*timing, period)

    def predict(
        self, now: ControllerInput, sent: tuple[Array, ...], timing: Timing | None = None
    ) -> ControllerInput:
        """Predicted controller input at the time when the command issued now takes effect.

        Args:
            now: the present one.
            sent: tensions (n_a,) [N] of the last `history` periods, the newest last.
            timing: of the commands, None: as known.

        Returns:
            The prediction; the present one if the model has no such motion.
        """
        if timing is None:
            timing = self.timing
        latency = float(timing.latency)
        lag = float(timing.lag)
        whole, rest = whole_periods(latency, self._period)
        commands = np.array(sent)
        try:
            q, q_dot, tip_pose = now.q, now.q_dot, now.tip_pose
            effects = None
            time = now.time
            for start, duration, count in ((0.0, rest, 1), (rest, self._period, whole)):
                if duration == 0.0 or count == 0:
                    continue
                tension = self._acting(commands, timing, start, duration, count)
                if now.input_error is not None:
                    error = now.input_error
                    tension = error.gain * tension + error.offset
                self._simulation.reset(q, q_dot, time=time, effects=effects, tension=tension[0])
                rollout = corrected_rollout(self._simulation, tension, duration, now.force_error)
                q = rollout.q[-1]
                q_dot = rollout.q_dot[-1]
                effects = rollout.effects[-1]
                time += count * duration
            # the measured tip moves as the model's does
            if latency > 0.0:
                expected_pose = self._model.tip_pose(now.q)
                later_pose = self._model.tip_pose(q)
                moved = np.linalg.solve(expected_pose, later_pose)
                tip_pose = now.tip_pose @ moved
        except FAILURES:
            return now
        actuators = None
        if lag > 0.0:
            (tension,) = self._acting(commands, timing, latency, 0.0, 1)
            actuators = LaggingActuators(lag, tension)
        return now._replace(
            q=q,
            q_dot=q_dot,
            tip_pose=tip_pose,
            reference=now.reference._replace(ahead=now.reference.ahead - latency),
            time=time,
            actuators=actuators,
            lead=latency,
        )

    def _acting(
        self, commands: Array, timing: Timing, start: float, duration: float, count: int
    ) -> Array:
        """Mean tensions (count, n_a) [N] of intervals one after another from `start` [s] on."""
        rows = []
        for k in range(count):
            weights = mean_weights(
                timing, self._period, len(commands), start + k * duration, duration
            )
            rows.append(weights @ commands)
        return np.array(rows)
