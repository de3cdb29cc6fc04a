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
        speed_of_tendons = np.abs(self.rates(q_dot))
        rate = np.maximum(speed_of_tendons, LEAST_RATE)
        taken = self.loss * np.maximum(tension, 0.0)
        coefficient = taken * sliding_direction(rate, speed) / rate
        friction = self.pull * coefficient[:, None]
        return np.asarray(friction @ self.pull.T)


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
        points = grid.points[grid.real]
        self._points = points.ravel()
        self._weights = np.repeat(length / POINTS, POINTS)
        # at the nearest borders, of intervals before which the integral is whole
        starts = grid.start[grid.real]
        ends = starts + length
        asked = model.length * np.array(PLACES)
        away = np.abs(ends - asked[:, None])
        nearest = away.argmin(axis=1)
        borders = np.unique(nearest)
        self.places = np.minimum(ends[borders], model.length)
        points_before = POINTS * (borders + 1)
        # (places, points) 1 for points before a place, else 0
        point_numbers = np.arange(self._points.size)
        is_before = point_numbers < points_before[:, None]
        self._before = is_before.astype(float)

    def at(self, q: Array) -> BentArm:
        """The matrix J^T, and how far the rod is bent, at coordinates q (n,).

        Raises StrainLimitError.
        """
        strain, strain_slope = self._model.strain_at(q, self._points)
        bend_y = strain[:, 1]
        bend_z = strain[:, 2]
        curvature = np.hypot(bend_y, bend_z)
        bending = self._weights @ curvature
        sections = np.concatenate([self._points, self.places])
        poses = self._model.backbone_at(q, sections)
        count = self._points.size
        rotation = poses[:count, :3, :3]
        angular_slope = strain_slope[:, :3]
        linear_slope = strain_slope[:, 3:]
        weighted = rotation * self._weights[:, None, None]
        turns = weighted @ angular_slope
        stretches = weighted @ linear_slope
        positions = poses[:, :3, 3]
        of_points = positions[:count]
        of_places = positions[count:]
        levers = of_places[:, None] - of_points
        levers *= self._before[:, :, None]
        # sums over all points before a place: rows (3 places,), as one product each
        rows = 3 * self.places.size
        columns = 3 * count
        crosses_by_point = np.moveaxis(skew(levers), 1, 2)
        crosses = crosses_by_point.reshape(rows, columns)
        turned = -crosses @ turns.reshape(columns, q.size)
        stretches_by_point = stretches.reshape(count, 3 * q.size)
        stretched = self._before @ stretches_by_point
        velocity = stretched.reshape(rows, q.size) + turned
        return BentArm(load_jacobian=velocity.T, bending=float(bending))


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
    of_rates = np.zeros(every)
    mean = np.concatenate([stiffness, of_rates], axis=2) / 2.0
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
        unheld = rollout.by_tension[k] @ error.held
        unforced = rollout.by_state[k] @ moved[k] - unheld
        end = motion[k + 1] + unforced
        explained = by_start[k] @ start
        force = error.constant - explained - by_end[k] @ end
        moved[k + 1] = unforced + by_remainder @ force
    if not np.isfinite(moved).all():
        raise np.linalg.LinAlgError("the force that the model lacks leaves it no motion")
    q_moved = moved[:, :n]
    q_dot_moved = moved[:, n:]
    tip_pose = rollout.tip_pose.copy()
    for k in range(1, len(tip_pose)):
        twist = rollout.tip_jacobian[k] @ q_moved[k]
        tip_pose[k] = moved_pose(tip_pose[k], twist)
    force_by_state = by_start + by_end @ rollout.by_state
    force_by_tension = by_end @ rollout.by_tension
    return rollout._replace(
        q=rollout.q + q_moved,
        q_dot=rollout.q_dot + q_dot_moved,
        tip_pose=tip_pose,
        by_state=rollout.by_state - by_force @ force_by_state,
        by_tension=rollout.by_tension - by_force @ force_by_tension,
        by_force=by_force,
    )
