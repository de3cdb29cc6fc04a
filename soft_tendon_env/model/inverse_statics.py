"""Inverse statics: tensions u within limits whose equilibrium has a desired tip pose or position.

Bounded least squares of the scaled tip error e and of the effort, |e|^2 + mu^2 |u|^2 with mu that
fall, with exact derivatives by statics.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.algebra.lie import coefficients, rotation_log
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import ChordSolver, Equilibrium, static_equilibrium
from soft_tendon_env.tools.checks import checked_array, checked_type
from soft_tendon_env.tools.types import Array

# weights mu of the effort, one after the other, for errors in lengths of the rod, and tensions that
# would move the tip by as much
EFFORTS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
# efforts that a start other than at rest leaves out, as a large mu leads back to rest
NEAR = 3
# starts other than at rest
RANDOM_STARTS = 6
# share of the tensions' largest range from slack up to which an arm without equilibrium is given up
NEXT_TO_SLACK = 1e-3
# error of the tip that counts as reached, of the rod's length
POSITION_TOLERANCE = 1e-4
# way of a tip per radian of an arc's bend, of the rod's length
ANGLE_WEIGHT = 0.5
# of scipy's least_squares; its "dogbox" stalls where many tendons are at limits
OPTIONS = {
    "method": "trf",
    "ftol": 1e-8,
    "xtol": 1e-8,
    "gtol": 1e-14,
    "max_nfev": 60,
}
# deviation of R^T R from the identity up to which a matrix counts as a rotation
RIGID = 1e-6


class InverseEquilibrium(NamedTuple):
    """Solution of the inverse statics: tensions, their equilibrium, and its tip's distance."""

    tension: Array  # (n_a,) [N]
    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    position_error: float  # [m] from the desired position
    angle_error: float  # [rad] from the desired orientation, 0 for a position alone
    reachable: bool  # whether both errors are within the tolerance
    reason: str  # empty when reachable


def tension_for_tip_pose(
    model: Model, pose: ArrayLike, *, start: ArrayLike | None = None
) -> InverseEquilibrium:
    """Solves the inverse statics for a tip pose: tensions within the scene's limits.

    They are locally of least effort |u| if there are many. If the pose cannot be reached within
    1e-4 of the rod's length, the result is the nearest pose, with a `reason`. A radian counts as
    half the rod's length.

    Args:
        model: of the arm.
        pose: (4, 4) in the world frame.
        start: tensions (n_a,) [N] near the solution, when following a path: one local search from
            there instead of several from afar. Where many tensions reach the pose, they stay near
            these and are not of least effort.

    Returns:
        The tensions and their equilibrium.

    Raises:
        TypeError: for wrong types.
        ValueError: for wrong shapes, NaN, or a matrix that is no rigid transform.
    """
    checked_type("model", model, Model, "see build_model")
    pose = checked_array("pose", pose, (4, 4))
    # a rotation has R^T R = 1, and no reflection
    R = pose[:3, :3]
    excess = R.T @ R - np.eye(3)
    stretch = np.abs(excess)
    difference = pose[3] - [0, 0, 0, 1]
    off_last_row = np.abs(difference)
    deviation = max(stretch.max(), off_last_row.max())
    is_reflection = np.linalg.det(R) < 0
    if deviation > RIGID or is_reflection:
        raise ValueError(
            "pose should be a rigid transform [[R, r], [0, 0, 0, 1]] with a rotation R"
        )
    angle_weight = ANGLE_WEIGHT * model.length
    search = _TipSearch(model, pose, angle_weight)
    return search.nearest(start)


def tension_for_tip_position(
    model: Model, position: ArrayLike, *, start: ArrayLike | None = None
) -> InverseEquilibrium:
    """Solves the inverse statics for a tip position alone, whatever the tip's orientation.

    Args:
        model: of the arm.
        position: (3,) [m] in the world frame.
        start: as of `tension_for_tip_pose`.

    Returns:
        The tensions and their equilibrium, as of `tension_for_tip_pose`.

    Raises:
        TypeError: for wrong types.
        ValueError: for wrong shapes, or NaN.
    """
    checked_type("model", model, Model, "see build_model")
    pose = np.eye(4)
    pose[:3, 3] = checked_array("position", position, (3,))
    search = _TipSearch(model, pose, angle_weight=0.0)
    return search.nearest(start)


class _TipSearch:
    """The search for one tip pose."""

    def __init__(self, model: Model, pose: Array, angle_weight: float) -> None:
        """angle_weight: [m] that a radian counts as; 0: orientations do not matter."""
        self.model = model
        self.pose = pose
        self.angle_weight = angle_weight
        limits = model.discretisation.tension_limits
        self.least, self.greatest = limits.T
        self.slack = np.clip(0.0, self.least, self.greatest)
        # the last tensions and their equilibrium
        self._last: tuple[Array, Equilibrium] | None = None

    def nearest(self, start: ArrayLike | None) -> InverseEquilibrium:
        """The first solution that reaches the pose, or the nearest of all.

        Args:
            start: tensions (n_a,) to search from; None: from slack and then from anywhere.
        """
        if start is None:
            starts = [self.slack, *self._random_starts()]
        else:
            starts = [checked_array("start", start, self.slack.shape)]
        solutions = list[InverseEquilibrium]()
        for tension in starts:
            first_effort = NEAR
            if tension is self.slack:
                first_effort = 0
            efforts = EFFORTS[first_effort:]
            within_limits = np.clip(tension, self.least, self.greatest)
            optimum = self.descend(within_limits, efforts)
            solution = self.solution(optimum)
            if solution.reachable:
                return solution
            solutions.append(solution)
        return min(solutions, key=self._error_of)

    def descend(self, u: Array, efforts: Iterable[float]) -> Array:
        """The tensions (n_a,) of least |e|^2 + mu^2 |u|^2 within the limits.

        Args:
            u: tensions (n_a,) [N] to start from.
            efforts: mu, one after the other.
        """
        # tensions without equilibrium are halved towards slack
        ranges = self.greatest - self.least
        largest_range = np.abs(ranges).max()
        next_to_slack = NEXT_TO_SLACK * largest_range
        while not self.equilibrium(u).converged:
            pull = np.abs(u - self.slack)
            if pull.max() <= next_to_slack:
                return u
            u = 0.5 * (self.slack + u)
        try:
            length = self.model.length
            slopes = self.derivative(u)
            sensitivity = float(np.linalg.norm(slopes, 2))
            # [N], moves the tip by about the rod's length
            unit = length / (sensitivity or length)
            for mu in efforts:
                u = self._least_squares(u, mu, unit)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            # next to the strain limit; the last u stands
            pass
        return np.clip(u, self.least, self.greatest)

    def equilibrium(self, u: Array) -> Equilibrium:
        """The equilibrium under tensions (n_a,), kept for the next call."""
        if self._last is not None:
            tension, equilibrium = self._last
            if np.array_equal(tension, u):
                return equilibrium
        equilibrium = static_equilibrium(self.model, u)
        self._last = (u.copy(), equilibrium)
        return equilibrium

    def distance(self, tip: Array) -> tuple[Array, Array]:
        """Rotation vector in the tip frame and displacement from a tip pose to the desired one.

        Args:
            tip: pose (4, 4).

        Returns:
            (3,) [rad] and (3,) [m].
        """
        R = tip[:3, :3]
        R_desired = self.pose[:3, :3]
        relative = R.T @ R_desired
        entries = np.ravel(relative).tolist()
        turn = rotation_log(tuple(entries))
        position = tip[:3, 3]
        desired = self.pose[:3, 3]
        return np.array(turn), desired - position

    def error(self, u: Array) -> Array:
        """Error e (6,) [m] from the tip to the desired pose; NaN without equilibrium.

        It has the weighted rotation vector and the displacement.
        """
        equilibrium = self.equilibrium(u)
        if not equilibrium.converged:
            return np.full(6, np.nan)
        turn, displacement = self.distance(equilibrium.tip_pose)
        angular = self.angle_weight * turn
        return np.concatenate([angular, displacement])

    def derivative(self, u: Array) -> Array:
        """Derivative d e / d u (6, n_a) of the error.

        It is minus the inverse left Jacobian of SO(3) on the body's turn, and minus R on its shift.
        """
        equilibrium = self.equilibrium(u)
        tip = equilibrium.tip_pose
        turn, _ = self.distance(tip)
        chord = ChordSolver(self.model, equilibrium.q, u)
        # of the body by tensions
        motion = chord.terms.tip_jacobian @ chord.answer
        rotation = motion[:3]
        shift = motion[3:]
        by_rotation = self.angle_weight * _inverse_left_jacobian(turn)
        angular = by_rotation @ rotation
        R = tip[:3, :3]
        linear = R @ shift
        return -np.concatenate([angular, linear])

    def solution(self, u: Array) -> InverseEquilibrium:
        """Solution that the tensions are, with the errors of its tip.

        It has a reason where the tip is too far.
        """
        equilibrium = self.equilibrium(u)
        turn, displacement = self.distance(equilibrium.tip_pose)
        position_error = float(np.linalg.norm(displacement))
        angle_error = 0.0
        if self.angle_weight > 0:
            angle_error = float(np.linalg.norm(turn))
        tolerance = POSITION_TOLERANCE * self.model.length
        error = max(position_error, self.angle_weight * angle_error)
        reachable = equilibrium.converged and error <= tolerance
        reason = ""
        if not reachable:
            reason = equilibrium.reason or (
                f"the nearest tip found is {position_error:.3g} m and {angle_error:.3g} rad away"
            )
        return InverseEquilibrium(
            tension=u,
            q=equilibrium.q,
            tip_pose=equilibrium.tip_pose,
            position_error=position_error,
            angle_error=angle_error,
            reachable=reachable,
            reason=reason,
        )

    def _random_starts(self) -> Array:
        """Tensions (starts, n_a) [N] half-way from slack to anywhere within the limits."""
        random = np.random.default_rng(0)
        shape = (RANDOM_STARTS, self.slack.size)
        anywhere = random.uniform(self.least, self.greatest, shape)
        return 0.5 * (self.slack + anywhere)

    def _least_squares(self, u: Array, mu: float, unit: float) -> Array:
        """Tensions (n_a,) [N] of least |e|^2 + mu^2 |u|^2.

        There tensions are in units of `unit` [N] and errors in lengths.
        """
        # here: it takes longer to import than all else that most scenes need
        from scipy.optimize import least_squares

        length = self.model.length

        def residual(x: Array) -> Array:
            error = self.error(x * unit) / length
            effort = mu * x
            return np.concatenate([error, effort])

        def jacobian(x: Array) -> Array:
            slopes = self.derivative(x * unit)
            error_slopes = slopes * unit / length
            effort_slopes = mu * np.eye(x.size)
            return np.concatenate([error_slopes, effort_slopes])

        least = self.least / unit
        greatest = self.greatest / unit
        optimum = least_squares(
            residual,
            u / unit,
            jacobian,
            (least, greatest),
            **OPTIONS,
        )
        return np.asarray(unit * optimum.x)

    def _error_of(self, solution: InverseEquilibrium) -> float:
        """Weighted error [m] of a solution."""
        angle_error = self.angle_weight * solution.angle_error
        return float(np.hypot(solution.position_error, angle_error))


def _inverse_left_jacobian(turn: Array) -> Array:
    """Inverse (3, 3) of the left Jacobian of SO(3) at a rotation vector (3,) [rad]."""
    x, y, z = turn
    skew = np.array(
        [
            [0.0, -z, y],
            [z, 0.0, -x],
            [-y, x, 0.0],
        ]
    )
    c = coefficients(turn @ turn)
    factor = 0.5 * c.a1 / c.a
    second_order = factor * skew @ skew
    return np.eye(3) - 0.5 * skew - second_order
