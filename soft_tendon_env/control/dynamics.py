"""Linearised dynamics that controllers predict with: one linearly implicit Euler step of (23), and its slowest mode."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.types import Array


class ImplicitStep(NamedTuple):
    """One linearly implicit Euler step of (23) over a period h: v+ = free + response u, q+ = q + h v+, n coordinates, n_a tendons.

    It is the step of the integrators, stable at any h: S = M + h D + h^2 G, free = v + S^-1 h (F - K - C v - D v - h G v),
    response = S^-1 h B, where G is with the stiffness of the effects, and D in S with their damping.
    """

    system: Array  # S (n, n)
    free: Array  # (n,)
    response: Array  # (n, n_a)


def implicit_step(terms: Terms, q_dot: Array, period: float) -> ImplicitStep:
    """The step from where `terms` were computed. Raises LinAlgError if S is singular."""
    damping, stiffness = terms.damping + terms.external_damping, terms.stiffness + terms.external_stiffness
    system = terms.mass + period * (damping + period * stiffness)
    force = terms.external_force + terms.external_damping @ q_dot - terms.elastic_force - terms.bias
    momentum = terms.mass @ q_dot + period * force
    solved = np.asarray(np.linalg.solve(system, np.column_stack([momentum, period * terms.actuation])), dtype=np.float64)
    return ImplicitStep(system, solved[:, 0], solved[:, 1:])


class Mode(NamedTuple):
    """A mode of the unloaded arm: its frequency [rad/s] without damping, and its damping's share of its inertia [1/s]."""

    frequency: float
    damping: float


def slowest_mode(model: Model) -> Mode:
    """The slowest mode of the motion (23), linearised at rest without tension."""
    n = model.coordinate_count
    terms = model.terms(np.zeros(n), np.zeros(n))
    squares, shapes = np.linalg.eig(np.linalg.solve(terms.mass, terms.stiffness))
    slowest = int(np.argmin(squares.real))
    shape = shapes[:, slowest].real
    return Mode(float(np.sqrt(squares[slowest].real)), float(shape @ terms.damping @ shape / (shape @ terms.mass @ shape)))
