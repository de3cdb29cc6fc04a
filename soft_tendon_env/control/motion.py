"""Targets between and beyond the instants at which they are told, and the step of the motion that controllers reckon with."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.control.rigid_motions import moved_pose, pose_error
from soft_tendon_env.model.model import Model, Terms
from soft_tendon_env.scene.scene import Array


def pose_at(ahead: Array, poses: Array, time: float) -> Array:
    """The pose (4, 4) at a time ahead [s] of poses (m, 4, 4) at `ahead` (m,): along the screw between two, the last for ever."""
    after = int(np.searchsorted(ahead, time - 1e-9))
    if after == 0 or after == ahead.size:
        return np.asarray(poses[min(after, ahead.size - 1)])
    share = (time - ahead[after - 1]) / (ahead[after] - ahead[after - 1])
    if share > 1.0 - 1e-9:
        return np.asarray(poses[after])
    return moved_pose(poses[after - 1], share * pose_error(poses[after - 1], poses[after]))


def value_at(ahead: Array, values: Array, time: float) -> Array:
    """The same for vectors (m, k): linear between two."""
    return np.array([np.interp(time, ahead, column) for column in values.T])


class ImplicitStep(NamedTuple):
    """One linearly implicit Euler step of (23) over a period h: v+ = free + response u, q+ = q + h v+, n coordinates, n_a tendons.

    It is the step of the integrators, stable at any h: S = M + h D + h^2 G, free = v + S^-1 h (F - K - C v - D v - h G v),
    response = S^-1 h B.
    """

    system: Array  # S (n, n)
    free: Array  # (n,)
    response: Array  # (n, n_a)


def implicit_step(terms: Terms, q_dot: Array, period: float) -> ImplicitStep:
    """The step from where `terms` were computed. Raises LinAlgError if S is singular."""
    system = terms.mass + period * (terms.damping + period * terms.stiffness)
    momentum = terms.mass @ q_dot + period * (terms.external_force - terms.elastic_force - terms.bias)
    solved = np.asarray(np.linalg.solve(system, np.column_stack([momentum, period * terms.actuation])), dtype=np.float64)
    return ImplicitStep(system, solved[:, 0], solved[:, 1:])


class Mode(NamedTuple):
    """A mode of the unloaded arm: its frequency [rad/s] without damping, and its damping's share of its inertia [1/s]."""

    frequency: float
    damping: float


def slowest_mode(model: Model) -> Mode:
    """Of the motion (23), linearised at rest without tension."""
    n = model.coordinate_count
    terms = model.terms(np.zeros(n), np.zeros(n))
    squares, shapes = np.linalg.eig(np.linalg.solve(terms.mass, terms.stiffness))
    slowest = int(np.argmin(squares.real))
    shape = shapes[:, slowest].real
    return Mode(float(np.sqrt(squares[slowest].real)), float(shape @ terms.damping @ shape / (shape @ terms.mass @ shape)))
