"""Smith predictor: control of an arm whose commands arrive late by a known time."""

import numpy as np

from soft_tendon_env.control.predictive import FAILURES
from soft_tendon_env.control.protocol import Situation
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation
from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.delays import whole_periods


class SmithPredictor:
    """Where an arm will be when a command that is given now arrives, by a model that gets those on their way.

    O. J. M. Smith, Closer control of loops with dead time, Chem. Eng. Progress 53, 1957.
    """

    def __init__(self, model: Model, latency: float, period: float) -> None:
        """latency: [s] of commands; period: [s] of control."""
        self.latency, self._period = latency, period
        self._model, self._simulation = model, Simulation(model)
        self.periods, self._rest = whole_periods(latency, period)

    def predicted(self, now: Situation, sent: tuple[Array, ...]) -> Situation:
        """The situation when what is decided now arrives, after tensions (n_a,) [N] asked for in the periods before, the newest last, of
        which the last `periods` + 1 matter; as it is now where the model has no such motion."""
        waiting = sent[-self.periods - 1 :]
        try:
            self._simulation.reset(now.q, now.q_dot, time=now.time, tension=waiting[0])
            self._simulation.step(waiting[0], self._rest)
            for tension in waiting[1:]:
                self._simulation.step(tension, self._period)
            moved = np.linalg.solve(self._model.tip_pose(now.q), self._simulation.tip_pose)
        except FAILURES:
            return now
        state = self._simulation.state
        reference = now.reference._replace(ahead=now.reference.ahead - self.latency)
        return now._replace(q=state.q, q_dot=state.q_dot, tip_pose=now.tip_pose @ moved, reference=reference, time=state.time)
