"""Shape control by the laws (37), (38) in implicit form: at the control period that there is, and within tension limits.

u = q_a_bar + G_aa^-1 B^T (kd (q_bar_dot - q_dot) + kp (q_bar - q)) is (37) where every coordinate is actuated, and (38) in newtons
otherwise. Its q and q_dot are those at the end of the period, solved for together with the implicit step of the motion (stable PD control
of Tan, Liu and Turk 2011): gains of any size are stable at any period, also the paper's.
"""

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import implicit_step, natural_frequency
from soft_tendon_env.control.protocol import FAILURES, ControllerInput, ControllerOutput, ModelController
from soft_tendon_env.control.rigid_motions import value_at
from soft_tendon_env.mechanics.types import Explicit
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

LOOSE = 1e-6  # weight of the tensions themselves against that of the motion they make, which decides where tendons are redundant


class ShapeFeedforward(ModelController):
    """u = q_a_bar, the tensions that hold the shape wanted at the end of the period, within limits. Raises ValueError as `tensions_of`."""

    def __init__(self, model: Model, limits: Array, period: float) -> None:
        super().__init__(model, limits, period)
        self._tensions = tensions_of(model)

    def act(self, now: ControllerInput, memory: None = None) -> ControllerOutput:
        assert now.reference.q is not None
        return self.within_limits(self._tensions @ value_at(now.reference.ahead, now.reference.q, self.period))


class ShapeTracking(ModelController):
    """Shape tracking by implicit feedback and tension allocation. Raises ValueError as `tensions_of` and `natural_frequency`.

    settling_time, damping: of the arm's slowest mode: [s] to 2 %, and the ratio. Faster modes settle at the rate (1 + kp) / kd at least.
    With 0.4 and 10 the gains are about the paper's, kp = 1,000 and kd = 100.
    """

    def __init__(self, model: Model, limits: Array, period: float, *, settling_time: float = 0.4, damping: float = 10.0) -> None:
        super().__init__(model, limits, period)
        self._tensions = tensions_of(model)
        self.kp, self.kd = shape_gains(model, settling_time, damping)

    def act(self, now: ControllerInput, memory: Array | None = None) -> ControllerOutput:
        """Tensions of the implicit law; memory: multipliers (n_a,) of the last allocation."""
        assert now.reference.q is not None
        h, kp, kd = self.period, self.kp, self.kd
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)
            step = implicit_step(terms, now.q_dot, h)
        except FAILURES:
            return self.hold(now, memory)
        q, then = (value_at(now.reference.ahead, now.reference.q, time) for time in (0.0, h))
        project = np.linalg.pinv(self._tensions @ terms.stiffness @ self._tensions.T) @ self._tensions @ terms.stiffness
        goal = self._tensions @ then + project @ (kd * (then - q) / h + kp * (then - now.q))
        grip = (kd + h * kp) * project
        rates = np.linalg.solve(np.eye(now.q.size) + step.response @ grip, step.free + step.response @ goal)
        wanted = goal - grip @ rates
        motion = step.metric + LOOSE * np.trace(step.metric) / wanted.size * np.eye(wanted.size)
        found = allocate(motion, -motion @ wanted, self.least, self.greatest, memory)
        return ControllerOutput(found.x, found.multipliers, {"limited": found.limited, "singular": float(not found.solved)})


def tensions_of(model: Model) -> Array:
    """The matrix (n_a, n) that makes coordinates at rest tensions, of least norm where tendons are redundant (34). Raises ValueError."""
    if isinstance(model.arm.strain, Explicit):
        raise ValueError("shape control needs coordinates that are tensions: the statics-based strain, not an explicit basis")
    return np.linalg.pinv(np.stack([model.rest_coordinates(unit) for unit in np.eye(model.tendon_count)], axis=1))


def shape_gains(model: Model, settling_time: float, damping: float) -> tuple[float, float]:
    """kp [-] and kd [s] of (37) that give the slowest mode of the model this settling time [s] and damping ratio, at least zero."""
    terms, natural = model.terms(*np.zeros((2, model.coordinate_count))), natural_frequency(settling_time, damping)
    squares, shapes = np.linalg.eig(np.linalg.solve(terms.mass, terms.stiffness))
    square, shape = squares.real.min(), shapes[:, np.argmin(squares.real)].real
    own = shape @ terms.damping @ shape / (shape @ terms.mass @ shape)  # share of the damping in the inertia [1/s]
    return max(natural**2 / square - 1.0, 0.0), max((2.0 * damping * natural - own) / square, 0.0)
