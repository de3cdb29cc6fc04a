"""Shape control by the laws (37), (38) in implicit form.

It works at the control period that there is, and within tension limits.

u = q_a_bar + G_aa^-1 B^T (kd (q_bar_dot - q_dot) + kp (q_bar - q)) is (37) where every coordinate
is actuated, and (38) in newtons otherwise. Its q and q_dot are those at the end of the period,
solved for together with the implicit step of the motion (stable PD control of Tan, Liu and Turk
2011): gains of any size are stable at any period, also the paper's.
"""

import numpy as np

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import implicit_step, natural_frequency
from soft_tendon_env.control.protocol import (
    FAILURES,
    ControllerInput,
    ControllerOutput,
    ModelController,
    Reference,
)
from soft_tendon_env.control.rigid_motions import value_at
from soft_tendon_env.mechanics.types import Explicit
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

# weight of the tensions themselves against that of the motion they make, which decides where
# tendons are redundant
LOOSE = 1e-6


class ShapeController(ModelController):
    """Base of the controllers of shapes.

    Raises ValueError for an explicit basis, whose coordinates are no tensions.
    """

    def __init__(self, model: Model, limits: Array, period: float) -> None:
        super().__init__(model, limits, period)
        if isinstance(model.arm.strain, Explicit):
            raise ValueError(
                "shape control needs coordinates that are tensions: the statics-based strain, not"
                " an explicit basis"
            )
        units = np.eye(model.tendon_count)
        at_rest = np.stack([model.rest_coordinates(unit) for unit in units], axis=1)
        # (n_a, n) of coordinates at rest, of least norm where tendons are redundant (34)
        self._tensions = np.linalg.pinv(at_rest)

    def shape_at(self, reference: Reference, time: float) -> Array:
        """Coordinates (n,) of the reference at a time ahead [s]."""
        assert reference.q is not None
        return value_at(reference.ahead, reference.q, time)


class ShapeFeedforward(ShapeController):
    """Shape control by feedforward u = q_a_bar, within limits.

    These tensions hold the shape that is desired at the end of the period.
    """

    def act(self, now: ControllerInput, memory: None = None) -> ControllerOutput:
        shape = self.shape_at(now.reference, self.period)
        return self.output(self._tensions @ shape)


class ShapeTracking(ShapeController):
    """Shape tracking by implicit feedback and tension allocation.

    Raises ValueError as ShapeController and `natural_frequency`.

    settling_time, damping: of the arm's slowest mode: [s] to 2 %, and the ratio. Faster modes
    settle at the rate (1 + kp) / kd at least. With 0.4 and 10 the gains are about the paper's, kp =
    1,000 and kd = 100.
    """

    def __init__(
        self,
        model: Model,
        limits: Array,
        period: float,
        *,
        settling_time: float = 0.4,
        damping: float = 10.0,
    ) -> None:
        super().__init__(model, limits, period)
        natural = natural_frequency(settling_time, damping)
        rest = np.zeros(model.coordinate_count)
        terms = model.terms(rest, rest)
        # slowest mode of M^-1 G: with control its frequency is that of (1 + kp) G, and its damping
        # that of D + kd G
        per_mass = np.linalg.solve(terms.mass, terms.stiffness)
        eigenvalues, eigenvectors = np.linalg.eig(per_mass)
        squares = eigenvalues.real
        modes = eigenvectors.real
        slowest = np.argmin(squares)
        square = squares[slowest]
        mode = modes[:, slowest]
        mode_mass = mode @ terms.mass @ mode
        mode_damping = mode @ terms.damping @ mode
        own_damping = mode_damping / mode_mass  # [1/s]
        needed_stiffness = natural**2 / square - 1.0
        self.kp = max(needed_stiffness, 0.0)
        needed_damping = 2.0 * damping * natural - own_damping
        self.kd = max(needed_damping / square, 0.0)

    def act(self, now: ControllerInput, memory: Array | None = None) -> ControllerOutput:
        """Tensions of the implicit law; memory: multipliers (n_a,) of the last allocation."""
        h = self.period
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)
            step = implicit_step(terms, now.q_dot, h)
        except FAILURES:
            return self.hold(now, memory)
        q_bar = self.shape_at(now.reference, 0.0)
        next_q_bar = self.shape_at(now.reference, h)
        # u = goal - grip v+, with the rates v+ at the end of the period
        tensions = self._tensions
        stiffness_aa = tensions @ terms.stiffness @ tensions.T
        compliance_aa = np.linalg.pinv(stiffness_aa)
        project = compliance_aa @ tensions @ terms.stiffness
        change = next_q_bar - q_bar
        error = next_q_bar - now.q
        push = self.kd * change / h + self.kp * error
        goal = tensions @ next_q_bar + project @ push
        gain = self.kd + h * self.kp
        grip = gain * project
        # v+ = free + response u
        feedback = step.response @ grip
        closed_loop = np.eye(now.q.size) + feedback
        open_loop = step.free + step.response @ goal
        rates = np.linalg.solve(closed_loop, open_loop)
        tension = goal - grip @ rates
        # within the limits, the tensions whose motion is nearest to that of these
        loose = LOOSE * np.trace(step.metric) / tension.size
        identity = np.eye(tension.size)
        motion = step.metric + loose * identity
        gradient = -motion @ tension
        least, greatest = self.reachable(now)
        allocation = allocate(motion, gradient, least, greatest, memory)
        return self.output(allocation.x, allocation.multipliers, not allocation.solved)
