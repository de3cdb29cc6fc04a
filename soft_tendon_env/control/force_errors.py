"""Generalised forces that a model lacks, and motions that are corrected for them.

They are loads in the world frame at places along the arm, errors of stiffness, damping and tip
mass, and friction of the tendons:

    Q = Q_0 - S q - D v - M v_dot - B (c * B^T v)

Friction is a damping of the tendons, whose coefficients c fall with their rates as Coulomb's do.

Rollouts of the model have the derivatives by generalised forces, so that Q costs no simulation of
its own.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.rigid_motions import moved_pose, skew
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Rollout, Simulation
from soft_tendon_env.model.tension_limits import erring_actuators
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.types import Array

PLACES = (0.25, 0.5, 0.75, 1.0)
"""Places of the loads, as shares of the rod's length: gravity, payloads and pushes together."""
POINTS = 2
"""Gauss points of an interval of the model's grid, where its strains are."""
SLIDING_SPEED = 5e-3
"""Rate of a tendon at its base [m/s], above which its friction is whole."""
FRICTION_PASSES = 3
"""Corrections by friction: coefficients for one motion tell the next (secants; it converges)."""
LEAST_RATE = 1e-9
"""Rate of a tendon [m/s] below which it does not slide."""


def sliding_direction(rate: Array, speed: float = SLIDING_SPEED) -> Array:
    """Directions (..., n_a) in which tendons slide at rates (..., n_a) [m/s], from -1 to 1.

    They are whole at rates far above a speed [m/s].
    """
    return np.asarray(np.tanh(rate / speed))


class TendonFriction(NamedTuple):
    """Friction of tendons, with one direction of sliding for all of a tendon.

    A tendon that shortens at the rate r pulls with the share 1 - loss tanh(r / speed) of its
    tension. As a damping of r this holds for both senses, and for tendons that stick.
    """

    loss: Array  # (n_a,) shares of tensions that friction takes from tendons that slide
    pull: Array  # B (n, n_a), by which tendons shorten at the rates B^T q_dot

    def rates(self, q_dot: Array) -> Array:
        """Rates (..., n_a) [m/s] at which tendons shorten, of rates (..., n) of coordinates."""
        return np.asarray(q_dot @ self.pull)

    def damping(self, tension: Array, q_dot: Array, speed: float) -> Array:
        """Damping matrices (N, n, n) under tensions (N, n_a) [N] at rates (N, n) or (n,)."""
        rate = np.maximum(np.abs(self.rates(q_dot)), LEAST_RATE)
        taken = self.loss * np.maximum(tension, 0.0)
        coefficient = taken * sliding_direction(rate, speed) / rate
        return np.asarray((self.pull * coefficient[:, None]) @ self.pull.T)


class ForceError(NamedTuple):
    """Force that a model lacks: Q = constant - S q - D v - M v_dot, less friction."""

    constant: Array  # (n,)
    stiffness: Array  # S (n, n)
    damping: Array  # D (n, n)
    inertia: Array  # M (n, n)
    held: Array  # (n_a,) [N] tensions that come nearest to it at rest, see holding_matrix
    friction: TendonFriction


class BentArm(NamedTuple):
    """Geometry of an arm at its coordinates."""

    load_jacobian: Array  # J^T (n, 3 places)
    bending: float  # [rad] integral of the curvature, without torsion


class ArmGeometry:
    """Geometry of a bent arm: where loads act on it, and how far its tendons turn.

    Forces f in the world frame are generalised forces J^T f. The velocity of a place X is the
    integral of R(s) (xi_dot + phi_dot x ...), over 0 <= s <= X:

        p_dot(X) = int_0^X R v_dot + (R kappa_dot) x (p(X) - p(s)) ds

    Args:
        model: of the arm.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        grid = model.grid
        length = grid.length[grid.real]
        self._points = grid.points[grid.real].ravel()
        self._weights = np.repeat(length / POINTS, POINTS)
        # at the nearest borders, of intervals before which the integral is whole
        ends = grid.start[grid.real] + length
        asked = model.length * np.array(PLACES)
        nearest = np.abs(ends - asked[:, None]).argmin(axis=1)
        borders = np.unique(nearest)
        self.places = np.minimum(ends[borders], model.length)
        counts = POINTS * (borders + 1)
        # (places, points) 1 for points before a place, else 0
        self._before = (np.arange(self._points.size) < counts[:, None]).astype(float)

    def at(self, q: Array) -> BentArm:
        """The matrix J^T, and how far the rod is bent, at coordinates q (n,).

        Raises StrainLimitError.
        """
        strain, strain_slope = self._model.strain_at(q, self._points)
        curvature = np.hypot(strain[:, 1], strain[:, 2])
        sections = np.concatenate([self._points, self.places])
        poses = self._model.backbone_at(q, sections)
        count = self._points.size
        rotation = poses[:count, :3, :3]
        weighted = rotation * self._weights[:, None, None]
        turns = weighted @ strain_slope[:, :3]
        stretches = weighted @ strain_slope[:, 3:]
        positions = poses[:, :3, 3]
        levers = positions[count:, None] - positions[:count]
        levers *= self._before[:, :, None]
        # sums over all points before a place: rows (3 places,), as one product each
        rows = 3 * self.places.size
        crosses = np.moveaxis(skew(levers), 1, 2).reshape(rows, 3 * count)
        turned = -crosses @ turns.reshape(3 * count, q.size)
        stretched = self._before @ stretches.reshape(count, 3 * q.size)
        velocity = stretched.reshape(rows, q.size) + turned
        return BentArm(load_jacobian=velocity.T, bending=float(self._weights @ curvature))


def holding_matrix(terms: Terms) -> Array:
    """Matrix (n_a, n) of the tensions u whose statics are nearest to those of a force Q.

    They have the least (Q - B u)^T K^-1 (Q - B u): what of a load tensions can make.
    """
    stiffness = terms.stiffness + terms.external_stiffness
    softened = np.linalg.solve(stiffness.T, terms.actuation).T
    compliance = softened @ terms.actuation
    return np.asarray(np.linalg.pinv(compliance, rcond=1e-6) @ softened)


def corrected_rollout(
    simulation: Simulation,
    tension: Array,
    duration: float,
    error: ForceError | None,
    sliding_speed: float = SLIDING_SPEED,
) -> Rollout:
    """Rollout of a simulation under tensions and a force that its model lacks.

    The tensions that come nearest to the force are played with the others: only the rest of it is
    linearised.

    Args:
        simulation: from whose state it begins.
        tension: (N, n_a) [N] of periods.
        duration: of a period [s].
        error: None: the model lacks nothing, and has no derivatives by forces.
        sliding_speed: rate of tendons [m/s] above which friction is whole.

    Returns:
        The motion and its derivatives.

    Raises:
        SimulationDiverged, StrainLimitError, LinAlgError: the model has no such motion.
    """
    with erring_actuators():  # tensions that stand for errors may exceed the limits
        if error is None:
            return simulation.rollout(tension, duration)
        every_force = np.eye(error.constant.size)
        rollout = simulation.rollout(tension + error.held, duration, forces=every_force)
    friction = error.friction
    if not friction.loss.any():
        return _corrected(rollout, error, duration)
    # by the rates of each motion, first of that without friction
    corrected = rollout
    for _ in range(FRICTION_PASSES):
        q_dot = np.diff(corrected.q, axis=0) / duration
        damping = friction.damping(tension, q_dot, sliding_speed)
        rubbing = error._replace(damping=error.damping + damping)
        corrected = _corrected(rollout, rubbing, duration)
    return corrected


def _corrected(rollout: Rollout, error: ForceError, period: float) -> Rollout:
    """Rollout of a model, corrected for a force that it lacks, friction apart.

    The damping may be that of every period, (N, n, n).

    Over a period the force is held at Q = c - E_0 x - E_1 x+, of the mean coordinates, rates and
    accelerations, and x+ = x_m(x) + B Q with the model's x_m is solved for x+:

        x+ = x_m + G (c - E_0 x - E_1 x_m),    G = B (1 + E_1 B)^-1
    """
    n = rollout.q.shape[1]
    every = rollout.by_force.shape[0], n, n
    stiffness, damping, inertia = (
        np.broadcast_to(part, every) for part in (error.stiffness, error.damping, error.inertia)
    )
    mean = np.concatenate([stiffness, np.zeros(every)], axis=2) / 2.0
    # within a period rates may rise and fall: their mean is the change of the coordinates
    change = np.concatenate([damping, inertia], axis=2) / period
    by_start = mean - change
    by_end = mean + change
    motion = np.hstack([rollout.q, rollout.q_dot])
    moved = np.zeros_like(motion)
    feedback = np.eye(n) + by_end @ rollout.by_force
    by_force = rollout.by_force @ np.linalg.inv(feedback)
    for k, by_remainder in enumerate(by_force):
        start = motion[k] + moved[k]
        unforced = rollout.by_state[k] @ moved[k] - rollout.by_tension[k] @ error.held
        force = error.constant - by_start[k] @ start - by_end[k] @ (motion[k + 1] + unforced)
        moved[k + 1] = unforced + by_remainder @ force
    tip_pose = rollout.tip_pose.copy()
    for k in range(1, len(tip_pose)):
        tip_pose[k] = moved_pose(tip_pose[k], rollout.tip_jacobian[k] @ moved[k, :n])
    if not np.isfinite(moved).all():
        raise np.linalg.LinAlgError("the force that the model lacks leaves it no motion")
    return rollout._replace(
        q=rollout.q + moved[:, :n],
        q_dot=rollout.q_dot + moved[:, n:],
        tip_pose=tip_pose,
        by_state=rollout.by_state - by_force @ (by_start + by_end @ rollout.by_state),
        by_tension=rollout.by_tension - by_force @ (by_end @ rollout.by_tension),
        by_force=by_force,
    )
