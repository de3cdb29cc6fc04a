"""Inverse statics: tensions u within limits whose equilibrium has a wanted tip pose or position.

Bounded least squares of the scaled tip error e and of the effort, |e|^2 + mu^2 |u|^2 with mu that
fall, with exact derivatives by statics.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.algebra.lie import coefficients, rotation_log
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import ChordSolver, Equilibrium, static_equilibrium
from soft_tendon_env.tools.checks import checked_array, checked_type
from soft_tendon_env.tools.types import Array

EFFORTS = (
    1e-1,
    1e-2,
    1e-3,
    1e-4,
    1e-5,
    1e-6,
)  # mu, for errors in lengths of the rod, and tensions that would move the tip by as much
NEAR, RANDOM_STARTS = (
    3,
    6,
    # efforts that a start other than at rest leaves out, as a large mu leads back to rest; such
    # starts
)
POSITION_TOLERANCE, ANGLE_WEIGHT = (
    1e-4,
    0.5,
)  # of the rod's length: error that counts as reached; way of a tip per radian of an arc's bend
OPTIONS = {
    "method": "trf",
    "ftol": 1e-8,
    "xtol": 1e-8,
    "gtol": 1e-14,
    "max_nfev": 60,
}  # "dogbox" stalls where many tendons are at limits
RIGID = 1e-6  # deviation of R^T R from the identity up to which a matrix counts as a rotation


class InverseEquilibrium(NamedTuple):
    """Solution of the inverse statics: tensions, their equilibrium, and the distance of its tip
    from the desired one."""

    tension: Array  # (n_a,) [N]
    q: Array  # (n,)
    tip_pose: Array  # (4, 4)
    position_error: float  # [m]
    angle_error: float  # [rad], 0 for a position alone
    reachable: bool  # whether both errors are within the tolerance
    reason: str  # empty when reachable


def tension_for_tip_pose(
    model: Model, pose: ArrayLike, *, start: ArrayLike | None = None
) -> InverseEquilibrium:
    """Inverse statics for a tip pose (4, 4): tensions within the scene's limits, locally of least
    effort |u| if there are many.

    If the pose cannot be reached within 1e-4 of the rod's length, the result is the nearest pose,
    with a `reason`. A radian counts as half the rod's length.

    start: tensions (n_a,) near the solution, when following a path: one local search from there
    instead of several from afar.

    Raises ValueError or TypeError for wrong shapes and types, NaN, or a matrix that is no rigid
    transform.
    """
    checked_type("model", model, Model, "see build_model")
    pose = checked_array("pose", pose, (4, 4))
    R = pose[:3, :3]
    if (
        np.abs(R.T @ R - np.eye(3)).max() > RIGID
        or np.linalg.det(R) < 0
        or np.abs(pose[3] - [0, 0, 0, 1]).max() > RIGID
    ):
        raise ValueError(
            "pose should be a rigid transform [[R, r], [0, 0, 0, 1]] with a rotation R"
        )
    return _TipSearch(model, pose, ANGLE_WEIGHT * model.length).nearest(start)


def tension_for_tip_position(
    model: Model, position: ArrayLike, *, start: ArrayLike | None = None
) -> InverseEquilibrium:
    """Inverse statics for a tip position (3,) [m] alone, whatever the tip's orientation; otherwise
    as `tension_for_tip_pose`."""
    checked_type("model", model, Model, "see build_model")
    pose = np.eye(4)
    pose[:3, 3] = checked_array("position", position, (3,))
    return _TipSearch(model, pose, 0.0).nearest(start)


class _TipSearch:
    """The search for one tip pose."""

    def __init__(self, model: Model, pose: Array, angle_weight: float) -> None:
        self.model, self.pose, self.angle_weight = model, pose, angle_weight
        self.least, self.greatest = model.discretisation.tension_limits.T
        self.slack = np.clip(0.0, self.least, self.greatest)
        self._last: tuple[Array, Equilibrium] | None = None

    def nearest(self, start: ArrayLike | None) -> InverseEquilibrium:
        """The first solution that reaches the pose, or the nearest of all: from `start`, or from
        slack and then anywhere."""
        if start is None:
            anywhere = np.random.default_rng(0).uniform(
                self.least, self.greatest, (RANDOM_STARTS, self.slack.size)
            )
            starts = [self.slack, *(0.5 * (self.slack + anywhere))]
        else:
            starts = [checked_array("start", start, self.slack.shape)]
        found: list[InverseEquilibrium] = []
        for u in starts:
            efforts = EFFORTS if u is self.slack else EFFORTS[NEAR:]
            found.append(
                self.solution(self.descend(np.clip(u, self.least, self.greatest), efforts))
            )
            if found[-1].reachable:
                return found[-1]
        return min(
            found, key=lambda one: np.hypot(one.position_error, self.angle_weight * one.angle_error)
        )

    def descend(self, u: Array, efforts: Iterable[float]) -> Array:
        """The tensions of least |e|^2 + mu^2 |u|^2 within the limits, for one mu after the
        other."""
        from scipy.optimize import (
            least_squares,
        )  # here: it takes longer to import than all else that most scenes need

        while not self.equilibrium(u).converged:
            if np.abs(u - self.slack).max() <= 1e-3 * np.abs(self.greatest - self.least).max():
                return u
            u = 0.5 * (self.slack + u)
        with contextlib.suppress(
            ArithmeticError, ValueError, np.linalg.LinAlgError
        ):  # next to the strain limit; the last u stands
            length = self.model.length
            unit = length / (
                float(np.linalg.norm(self.derivative(u), 2)) or length
            )  # [N], moves the tip by about the rod's length
            bounds = self.least / unit, self.greatest / unit
            for mu in efforts:

                def residual(x: Array, mu: float = mu) -> Array:
                    return np.concatenate([self.error(x * unit) / length, mu * x])

                def jacobian(x: Array, mu: float = mu) -> Array:
                    return np.concatenate(
                        [self.derivative(x * unit) * unit / length, mu * np.eye(x.size)]
                    )

                u = unit * least_squares(residual, u / unit, jacobian, bounds, **OPTIONS).x
        return np.clip(u, self.least, self.greatest)

    def equilibrium(self, u: Array) -> Equilibrium:
        """The equilibrium under tensions (n_a,), kept for the next call."""
        if self._last is None or not np.array_equal(self._last[0], u):
            self._last = u.copy(), static_equilibrium(self.model, u)
        return self._last[1]

    def distance(self, tip: Array) -> tuple[Array, Array]:
        """Rotation vector (3,) [rad] in the tip frame and displacement (3,) [m] from a tip pose to
        the wanted one."""
        turn = np.array(rotation_log(tuple((tip[:3, :3].T @ self.pose[:3, :3]).ravel().tolist())))
        return turn, self.pose[:3, 3] - tip[:3, 3]

    def error(self, u: Array) -> Array:
        """(weighted rotation vector in the tip frame, position) from the tip to the wanted pose
        (6,) [m]; NaN without equilibrium."""
        found = self.equilibrium(u)
        turn, away = self.distance(found.tip_pose)
        return (
            np.concatenate([self.angle_weight * turn, away])
            if found.converged
            else np.full(6, np.nan)
        )

    def derivative(self, u: Array) -> Array:
        """d error / du (6, n_a): minus the inverse left Jacobian of SO(3) on the body's turn, minus
        R on its shift."""
        found = self.equilibrium(u)
        tip, near = found.tip_pose, ChordSolver(self.model, found.q, u)
        motion = near.terms.tip_jacobian @ near.answer
        x, y, z = k = self.distance(tip)[0]
        c = coefficients(k @ k)
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        inverse_jacobian = np.eye(3) - 0.5 * skew - 0.5 * c.a1 / c.a * skew @ skew
        return -np.concatenate(
            [self.angle_weight * inverse_jacobian @ motion[:3], tip[:3, :3] @ motion[3:]]
        )

    def solution(self, u: Array) -> InverseEquilibrium:
        """Solution that the tensions are, with the errors of its tip and a reason where that is too
        far."""
        at = self.equilibrium(u)
        turn, away = map(float, map(np.linalg.norm, self.distance(at.tip_pose)))
        turn = turn if self.angle_weight > 0 else 0.0
        reachable = (
            at.converged
            and max(away, self.angle_weight * turn) <= POSITION_TOLERANCE * self.model.length
        )
        reason = (
            ""
            if reachable
            else at.reason or f"the nearest tip found is {away:.3g} m and {turn:.3g} rad away"
        )
        return InverseEquilibrium(u, at.q, at.tip_pose, away, turn, reachable, reason)
