"""The paper's control laws (37) to (39) as printed, with its gains, held over a control period and cut off at the tension limits.

They are continuous in time: at the 20 ms of the environments they are unstable, which comparisons show. Make them with a control
period of a millisecond or less, or use `TipTracking` and `ShapeTracking`, which are these laws made usable.
"""

import numpy as np

from soft_tendon_env.control.interpolation import pose_at, value_at
from soft_tendon_env.control.paper_laws import Gains, ShapeTarget, TipPoseTarget, shape_tension, tip_pose_tension
from soft_tendon_env.control.protocol import FAILURES, Decision, Situation
from soft_tendon_env.control.rigid_motions import pose_error
from soft_tendon_env.control.shape_tracking import tensions_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

TIP_GAINS = Gains(1e4, 1e3)
SHAPE_GAINS = Gains(1e3, 1e2)


class PaperTipPose:
    """(39) for the tip's pose, limits (n_a, 2) [N]; the target's twist and its derivative from its poses within two periods [s]."""

    def __init__(self, model: Model, limits: Array, period: float) -> None:
        self.model, self.period = model, period
        self.least, self.greatest = limits.T.copy()

    def act(self, now: Situation, memory: None = None) -> Decision:
        """Tensions of (39); where it has no solution the last ones are held."""
        assert now.reference.tip_pose is not None
        poses = [pose_at(now.reference.ahead, now.reference.tip_pose, k * self.period) for k in range(3)]
        first, second = (pose_error(a, b) / self.period for a, b in zip(poses[:-1], poses[1:], strict=True))
        acceleration = (second - first) / self.period
        wanted = TipPoseTarget(poses[0], first - 0.5 * self.period * acceleration, acceleration)
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)._replace(tip_pose=now.tip_pose)
            tension = tip_pose_tension(terms, now.q_dot, wanted, TIP_GAINS)
        except (*FAILURES, ValueError):
            return _within(now.tension, self.least, self.greatest, 1.0)
        return _within(tension, self.least, self.greatest, 0.0)


class PaperShape:
    """(37) or (38), limits (n_a, 2) [N]. Raises ValueError for models whose coordinates are not tensions."""

    def __init__(self, model: Model, limits: Array, period: float) -> None:
        self.model, self.period = model, period
        self._tensions = tensions_of(model)
        self.least, self.greatest = limits.T.copy()

    def act(self, now: Situation, memory: None = None) -> Decision:
        """Tensions of (37) or (38); where the model has no strain the last ones are held."""
        assert now.reference.q is not None
        here, then = (self._tensions @ value_at(now.reference.ahead, now.reference.q, time) for time in (0.0, self.period))
        try:
            tension = shape_tension(self.model, now.q, now.q_dot, ShapeTarget(here, (then - here) / self.period), SHAPE_GAINS)
        except (*FAILURES, ValueError):
            return _within(now.tension, self.least, self.greatest, 1.0)
        return _within(tension, self.least, self.greatest, 0.0)


def _within(tension: Array, least: Array, greatest: Array, singular: float) -> Decision:
    held = np.clip(tension, least, greatest)
    return Decision(held, None, {"limited": float(np.mean(held != tension)), "singular": singular})
