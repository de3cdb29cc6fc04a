"""The control laws (37) to (39) of the paper's Section IV.

They are pure functions, and controllers at a control period.

The functions are continuous in time, without limits of the tensions. The controllers hold them over
a control period within the limits: at the 20 ms of the environments they are unstable, unlike their
sampled forms, `TipTracking` and `ShapeTracking`. n coordinates, n_a tendons; g and eta are pose and
body twist of the tip.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.dynamics import Gains
from soft_tendon_env.control.protocol import (
    FAILURES,
    ControllerInput,
    ControllerOutput,
    ModelController,
)
from soft_tendon_env.control.rigid_motions import (
    adjoint,
    adjoint_of_twist,
    inverse_pose,
    pose_at,
    pose_error,
)
from soft_tendon_env.control.shape_tracking import ShapeController
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.checks import checked_array
from soft_tendon_env.tools.types import Array

# relative singular value up to which directions count as dependent, as the pulls of redundant
# tendons are
DEPENDENT = 1e-9
TIP_GAINS = Gains(1e4, 1e3)  # of (39), [1/s^2] and [1/s]
SHAPE_GAINS = Gains(1e3, 1e2)  # of (37), [1] and [s]; of (38) those over B's units


class ShapeTarget(NamedTuple):
    """The shape that tensions hold at rest."""

    tension: Array  # q_a_bar (n_a,) [N]
    tension_rate: Array  # (n_a,) [N/s]


class TipPoseTarget(NamedTuple):
    """A pose in motion."""

    pose: Array  # g_bar (4, 4)
    twist: Array  # eta_bar (6,), its body twist
    acceleration: Array  # (6,), the twist's derivative


def shape_tension(model: Model, q: Array, q_dot: Array, target: ShapeTarget, gains: Gains) -> Array:
    """Shape control laws (37), and (38) where the coordinates are not just the tensions.

    The latter holds with passive coordinates, and with redundant tendons, which have fewer
    coordinates than tensions.

    Args:
        model: of the arm.
        q: coordinates (n,).
        q_dot: their rates (n,).
        target: the shape to reach.
        gains: kp and kd.

    Returns:
        Tensions (n_a,) [N], without limits.

    Raises:
        ValueError: for explicit bases, whose coordinates are no tensions, and for bad arrays.
        TypeError: for what are no arrays.
    """
    shape = (model.coordinate_count,)
    checked_q = checked_array("q", q, shape)
    q_bar = model.rest_coordinates(target.tension)
    error = q_bar - checked_q
    q_bar_dot = model.rest_coordinates(target.tension_rate)
    checked_q_dot = checked_array("q_dot", q_dot, shape)
    error_dot = q_bar_dot - checked_q_dot
    push = gains.kd * error_dot + gains.kp * error
    if not model.arm.strain.is_tensions:
        actuation = model.terms(q, q_dot).actuation
        push = actuation.T @ push
    return np.asarray(target.tension + push)


LeftInverse = Callable[[Terms], Array]


def energy_left_inverse(terms: Terms) -> Array:
    """Left inverse B^+ = (B^T G^-1 B)^-1 B^T G^-1 (n_a, n) in the elastic energy.

    B B^+ f is the force of tensions next to f in the elastic energy that it stores.

    So it does not depend on the choice of coordinates. Of redundant tendons the least tensions.
    """
    # with G = L L^T: B^+ = (L^-1 B)^+ L^-1
    root = np.linalg.cholesky(terms.stiffness)
    scaled = np.linalg.solve(root, terms.actuation)
    weighted = np.linalg.pinv(scaled, rtol=DEPENDENT)
    return np.asarray(np.linalg.solve(root.T, weighted.T).T)


def euclidean_left_inverse(terms: Terms) -> Array:
    """B^+ = (B^T B)^-1 B^T (n_a, n), as (39) is printed.

    Without full actuation it depends on the units of the coordinates.
    """
    return np.asarray(np.linalg.pinv(terms.actuation, rtol=DEPENDENT))


def tip_pose_tension(
    terms: Terms,
    q_dot: Array,
    target: TipPoseTarget,
    gains: Gains,
    left_inverse: LeftInverse = energy_left_inverse,
) -> Array:
    """Computes the tensions of the tip pose control law (39), feedback linearisation.

    With full actuation the twist's derivative is then what (39) has in its brackets before J M^-1.

    Args:
        terms: at q and q_dot, of any strain parametrisation.
        q_dot: rates (n,).
        target: the pose to follow.
        gains: kp and kd.
        left_inverse: B^+ (n_a, n) of the terms.

    Returns:
        Tensions (n_a,) [N], without limits.

    Raises:
        ValueError: where tensions cannot accelerate the tip in all six directions, as with fewer
            than six coordinates or tendons.
    """
    twist = terms.tip_jacobian @ q_dot
    twist_bar, acceleration_bar = seen_from(terms.tip_pose, twist, target)
    error = pose_error(terms.tip_pose, target.pose)
    twist_error = twist_bar - twist
    damped = acceleration_bar + gains.kd * twist_error
    acceleration = damped + gains.kp * error
    return accelerating_tension(terms, q_dot, slice(0, 6), acceleration, left_inverse)


def seen_from(pose: Array, twist: Array, target: TipPoseTarget) -> tuple[Array, Array]:
    """The target's twist Ad eta_bar and its derivative in another frame, (6,) each.

    The frame is that of pose g (4, 4), which moves with twist eta (6,).

    The two lines below (39), Ad of g^-1 g_bar.
    """
    Ad = adjoint(inverse_pose(pose) @ target.pose)
    target_twist = Ad @ target.twist
    turning = adjoint_of_twist(target_twist - twist) @ target_twist
    return target_twist, turning + Ad @ target.acceleration


def accelerating_tension(
    terms: Terms, q_dot: Array, rows: slice, acceleration: Array, left_inverse: LeftInverse
) -> Array:
    """Feedback linearisation of (39): tensions that accelerate some components of the tip's twist.

    They are B^+ J^T Omega (eta_dot + J M^-1 (C q_dot + D q_dot + K - F) - J_dot q_dot).

    Args:
        terms: at q and q_dot.
        q_dot: rates (n,).
        rows: components of the twist, k of 6.
        acceleration: eta_dot (k,) of these.
        left_inverse: B^+ (n_a, n) of the terms.

    Returns:
        Tensions (n_a,) [N], without limits.

    Raises:
        ValueError: where tensions cannot accelerate the tip in all of these directions.
    """
    J = terms.tip_jacobian[rows]
    J_over_M = np.linalg.solve(terms.mass, J.T).T  # J M^-1
    by_tension = J_over_M @ terms.actuation
    rank = np.linalg.matrix_rank(by_tension, rtol=DEPENDENT)
    if rank < acceleration.size:
        raise ValueError(
            f"tensions accelerate the tip in {rank} of {acceleration.size} directions at these"
            " coordinates: too few for (39)"
        )
    internal = terms.bias + terms.damping @ q_dot + terms.elastic_force
    resistance = internal - terms.external_force
    # Omega = (J M^-1 J^T)^-1, the inertia of the tip
    driven = acceleration + J_over_M @ resistance - terms.tip_bias[rows]
    mobility = J_over_M @ J.T
    wrench = np.linalg.solve(mobility, driven)
    force = J.T @ wrench
    return np.asarray(left_inverse(terms) @ force)


class PaperTipPose(ModelController):
    """Tip pose controller by (39).

    The target's twist and its derivative come from its poses within two periods.
    """

    def act(self, now: ControllerInput, memory: None = None) -> ControllerOutput:
        h = self.period
        ahead = now.reference.ahead
        poses = now.reference.tip_pose
        assert poses is not None
        pose = pose_at(ahead, poses, 0.0)
        next_pose = pose_at(ahead, poses, h)
        last_pose = pose_at(ahead, poses, 2 * h)
        # mean twists of the two periods are those in their middle
        first_twist = pose_error(pose, next_pose) / h
        second_twist = pose_error(next_pose, last_pose) / h
        acceleration = (second_twist - first_twist) / h
        twist = first_twist - 0.5 * h * acceleration
        target = TipPoseTarget(pose, twist, acceleration)
        try:
            terms = self.model.terms(now.q, now.q_dot, time=now.time)
            measured = terms._replace(tip_pose=now.tip_pose)
            tension = tip_pose_tension(measured, now.q_dot, target, TIP_GAINS)
            return self.output(tension)
        except (*FAILURES, ValueError):
            return self.hold(now)


class PaperShape(ShapeController):
    """Shape controller by (37), or (38)."""

    def act(self, now: ControllerInput, memory: None = None) -> ControllerOutput:
        tension = self._tensions @ self.shape_at(now.reference, 0.0)
        next_tension = self._tensions @ self.shape_at(now.reference, self.period)
        target = ShapeTarget(tension, (next_tension - tension) / self.period)
        try:
            asked = shape_tension(self.model, now.q, now.q_dot, target, SHAPE_GAINS)
            return self.output(asked)
        except (*FAILURES, ValueError):
            return self.hold(now)
