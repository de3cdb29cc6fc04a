"""Control objectives: errors of tip pose, position, direction or shape, with their Jacobians.

Errors are in metres. Predictive control minimises the squares of any objectives; feedback and
inverse statics need a TrackedObjective, whose targets move.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from soft_tendon_env.control.protocol import ControllerInput, Reference
from soft_tendon_env.control.rigid_motions import (
    adjoint,
    adjoint_of_twist,
    inverse_pose,
    moved_pose,
    pose_at,
    pose_error,
    value_at,
)
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

LEAST_WEIGHT = 1e-9
"""Least weight of an objective [-]: at a smaller one nothing is left of it beside others."""


def checked_weight(weight: float) -> float:
    """The weight of an objective. Raises TypeError, ValueError."""
    return checked_number("weight", weight, LEAST_WEIGHT, f"a number, at least {LEAST_WEIGHT:g}")


class Aim(NamedTuple):
    """Task-space error, reference velocity, Jacobian and bias of an objective.

    They have k components, each weighted to metres.

    error (k,): what would bring the arm there in unit time. velocity (k,): the target's own, over
    the period that begins. jacobian (k, n) of the arm's velocity, and the bias (k,): the part of
    its acceleration without q_ddot, less that of the target's velocity by which the tip frame
    turns, -ad_eta (Ad eta_bar) below (39). The two of a target that moves with the arm are one
    motion.
    """

    error: Array
    velocity: Array
    jacobian: Array
    bias: Array


class Posture(NamedTuple):
    """Configuration of the arm at an instant of a plan, and the reference that it should follow."""

    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    tip_jacobian: Array  # (6, n) of the tip's body twist
    reference: Reference  # that it should follow
    ahead: float  # [s] from now
    time: float  # [s] since the episode began


class LinearError(NamedTuple):
    """Error (k,) and its Jacobian (k, n): with the coordinates it changes by -jacobian @ dq."""

    error: Array  # (k,)
    jacobian: Array  # (k, n)


class Objective(Protocol):
    """Error whose square predictive control makes small along its plan.

    `follows` names the fields of a Reference, one of which it reads; none where it needs none.
    """

    follows: ClassVar[tuple[str, ...]] = ()

    def linear_error(self, posture: Posture) -> LinearError:
        """Computes the error of a posture, and how it falls with the coordinates.

        Args:
            posture: planned, or of now.

        Returns:
            Error (k,) in metres, or what should count as such, and Jacobian (k, n).
        """

    def seen_from(self, model_pose: Array, reference: Reference, measured_pose: Array) -> Reference:
        """Moves the target for a model whose tip is elsewhere than the measured one.

        Args:
            model_pose: of the model's tip (4, 4).
            reference: for the arm.
            measured_pose: of the arm's tip (4, 4).

        Returns:
            The reference for the model; by default it stays where it is.
        """
        return reference


class TrackedObjective(Objective, Protocol):
    """Task-space error of a target that moves, which any controller drives to zero.

    The arm is at coordinates q (n,), with its tip at `tip_pose` (4, 4).
    """

    def linear_error(self, posture: Posture) -> LinearError:
        error = self.error(posture.q, posture.tip_pose, posture.reference, posture.ahead)
        return LinearError(error, self.jacobian(posture.tip_jacobian))

    def error(self, q: Array, tip_pose: Array, reference: Reference, time: float) -> Array:
        """Computes the error from the reference at a time ahead.

        It is what would bring the arm there in unit time.

        Args:
            q: coordinates (n,).
            tip_pose: of the arm (4, 4).
            reference: to follow.
            time: ahead of now [s].

        Returns:
            Error (k,) in metres.
        """

    def jacobian(self, tip_jacobian: Array) -> Array:
        """Computes the Jacobian of the arm's velocity, by which the error falls.

        Args:
            tip_jacobian: of the tip's body twist (6, n).

        Returns:
            Jacobian (k, n), in metres.
        """

    def aim(self, now: ControllerInput, terms: Terms, time: float, period: float) -> Aim:
        """Computes what feedback drives to zero, at a time ahead.

        Args:
            now: state and reference.
            terms: of the model at now.q.
            time: ahead of now [s].
            period: [s] over which the target's velocity is measured.

        Returns:
            Error, velocity of the target, Jacobian and bias.
        """

    def moved_back(
        self, reference: Reference, nearest: Array, time: float, share: float
    ) -> Reference:
        """Moves the target everywhere by a share of the way to a nearest pose.

        Args:
            reference: whose target is moved.
            nearest: pose (4, 4) to which the way leads.
            time: ahead of now [s], at which the way begins at the target.
            share: of the way.

        Returns:
            The reference that is moved; by default it stays where it is.
        """
        return reference


@dataclass(frozen=True)
class TipPose(TrackedObjective):
    """The SE(3) logarithm from tip to target; a radian is worth `angle_weight` metres.

    All of it counts `weight` times. Targets are moved by body displacements.
    """

    follows = ("tip_pose",)
    angle_weight: float = 0.1
    weight: float = 1.0

    def __post_init__(self) -> None:
        checked_weight(self.weight)

    @cached_property
    def _weight(self) -> Array:
        return self.weight * np.repeat([self.angle_weight, 1.0], 3)

    def error(self, q: Array, tip_pose: Array, reference: Reference, time: float) -> Array:
        return self._weight * pose_error(tip_pose, _pose(reference, time))

    def jacobian(self, tip_jacobian: Array) -> Array:
        return self._weight[:, None] * tip_jacobian

    def aim(self, now: ControllerInput, terms: Terms, time: float, period: float) -> Aim:
        target = _pose(now.reference, time)
        next_target = _pose(now.reference, time + period)
        # the target's own twist, in the tip's frame
        from_tip = inverse_pose(now.tip_pose) @ next_target
        twist = adjoint(from_tip) @ pose_error(target, next_target) / period
        # the frame moves: the target's own twist is not the tip's
        turning = adjoint_of_twist(terms.tip_jacobian @ now.q_dot) @ twist
        return Aim(
            error=self._weight * pose_error(now.tip_pose, target),
            velocity=self._weight * twist,
            jacobian=self.jacobian(terms.tip_jacobian),
            bias=self._weight * (terms.tip_bias + turning),
        )

    def seen_from(self, model_pose: Array, reference: Reference, measured_pose: Array) -> Reference:
        return _displace(reference, pose_error(measured_pose, model_pose))

    def moved_back(
        self, reference: Reference, nearest: Array, time: float, share: float
    ) -> Reference:
        way = pose_error(_pose(reference, time), nearest)
        return _displace(reference, share * way)


@dataclass(frozen=True)
class TipPosition(TrackedObjective):
    """The way from tip to target in the tip frame; the tip may point anywhere.

    It counts `weight` times. Targets are moved in the world frame.
    """

    follows = ("tip_position", "tip_pose")
    weight: float = 1.0

    def __post_init__(self) -> None:
        checked_weight(self.weight)

    def error(self, q: Array, tip_pose: Array, reference: Reference, time: float) -> Array:
        way = _position(reference, time) - tip_pose[:3, 3]
        into_tip = tip_pose[:3, :3].T
        seen_from_tip = into_tip @ way
        return np.asarray(self.weight * seen_from_tip)

    def jacobian(self, tip_jacobian: Array) -> Array:
        return self.weight * tip_jacobian[3:]

    def aim(self, now: ControllerInput, terms: Terms, time: float, period: float) -> Aim:
        target = _position(now.reference, time)
        next_target = _position(now.reference, time + period)
        into_tip = now.tip_pose[:3, :3].T
        tip_position = now.tip_pose[:3, 3]
        error = into_tip @ (target - tip_position)
        velocity = into_tip @ (next_target - target) / period
        twist = terms.tip_jacobian @ now.q_dot
        angular, linear = np.split(twist, 2)
        # the frame turns, the target's axes do not
        bias = terms.tip_bias[3:] + np.cross(angular, linear)
        return Aim(
            error=self.weight * error,
            velocity=self.weight * velocity,
            jacobian=self.jacobian(terms.tip_jacobian),
            bias=self.weight * bias,
        )

    def seen_from(self, model_pose: Array, reference: Reference, measured_pose: Array) -> Reference:
        model_tip = model_pose[:3, 3]
        measured_tip = measured_pose[:3, 3]
        positions = _positions(reference) + model_tip - measured_tip
        return reference._replace(tip_position=positions)

    def moved_back(
        self, reference: Reference, nearest: Array, time: float, share: float
    ) -> Reference:
        way = nearest[:3, 3] - _position(reference, time)
        return reference._replace(tip_position=_positions(reference) + share * way)


@dataclass(frozen=True)
class TipDirection(Objective):
    """The angle by which the tip's x axis, along the rod, is off a direction; it may roll.

    A radian is worth `weight` metres. The direction (3,) is in the world frame; None: that of the
    target's pose.
    """

    direction: tuple[float, float, float] | None = None
    weight: float = 0.1

    def __post_init__(self) -> None:
        checked_weight(self.weight)
        if self.direction is None:
            return
        direction = checked_array("direction", self.direction, (3,))
        if not direction.any():
            raise ValueError("direction is (0, 0, 0): it should be a vector of any length but zero")

    @property
    def follows(self) -> tuple[str, ...]:  # type: ignore[override]
        """Fields of a Reference, of which a direction of its own needs none."""
        return ("tip_pose",) if self.direction is None else ()

    def linear_error(self, posture: Posture) -> LinearError:
        if self.direction is None:
            target = _pose(posture.reference, posture.ahead)
            axis = target[:3, 0]
        else:
            direction = np.array(self.direction)
            axis = direction / np.linalg.norm(direction)
        into_tip = posture.tip_pose[:3, :3].T
        x, y, z = into_tip @ axis
        sine = np.hypot(y, z)
        # the axis (0, -z, y) / sine turns the tip's x axis to the direction; where they are
        # parallel or opposite, any axis across does
        turn = np.array([1.0, 0.0])
        if sine > 0.0:
            turn = np.array([-z, y]) / sine
        angle = np.arctan2(sine, x)
        error = self.weight * angle * turn
        jacobian = self.weight * posture.tip_jacobian[1:3]
        return LinearError(error, jacobian)

    def seen_from(self, model_pose: Array, reference: Reference, measured_pose: Array) -> Reference:
        if self.direction is not None:
            return reference
        return _displace(reference, pose_error(measured_pose, model_pose))


class Shape(TrackedObjective):
    """Shape error in coordinates, in the norm of the energy that holds them apart.

    Bending the rod by an angle of 1 counts as half its length. Targets stay where they are: shapes
    are made of tensions, and within reach.

    Args:
        model: whose coordinates they are.
        weight: of the error against that of other objectives.
    """

    follows = ("q",)

    def __init__(self, model: Model, weight: float = 1.0) -> None:
        n = model.coordinate_count
        rest = np.zeros(n)
        stiffness = model.terms(rest, rest).stiffness
        # root of the stiffness: the square of the error is the energy, in units of bending
        in_units = stiffness / model.bending_energy
        root = np.linalg.cholesky(in_units).T
        self._root = np.asarray(
            checked_weight(weight) * (0.5 * model.length * root), dtype=np.float64
        )

    def error(self, q: Array, tip_pose: Array, reference: Reference, time: float) -> Array:
        assert reference.q is not None
        target = value_at(reference.ahead, reference.q, time)
        return np.asarray(self._root @ (target - q))

    def jacobian(self, tip_jacobian: Array) -> Array:
        return self._root

    def aim(self, now: ControllerInput, terms: Terms, time: float, period: float) -> Aim:
        error = self.error(now.q, now.tip_pose, now.reference, time)
        next_time = time + period
        next_error = self.error(now.q, now.tip_pose, now.reference, next_time)
        return Aim(
            error=error,
            velocity=(next_error - error) / period,
            jacobian=self._root,
            bias=np.zeros(error.size),
        )


def _pose(reference: Reference, time: float) -> Array:
    """The target's pose (4, 4) at a time ahead [s]."""
    assert reference.tip_pose is not None
    return pose_at(reference.ahead, reference.tip_pose, time)


def _displace(reference: Reference, twist: Array) -> Reference:
    """The target with every pose moved by a body displacement (6,)."""
    assert reference.tip_pose is not None
    poses = [moved_pose(pose, twist) for pose in reference.tip_pose]
    return reference._replace(tip_pose=np.stack(poses))


def _position(reference: Reference, time: float) -> Array:
    """The target's position (3,) [m] at a time ahead [s]."""
    return value_at(reference.ahead, _positions(reference), time)


def _positions(reference: Reference) -> Array:
    """The target's positions (m, 3) [m], also of poses."""
    if reference.tip_position is not None:
        return reference.tip_position
    assert reference.tip_pose is not None
    return reference.tip_pose[:, :3, 3]
