"""Linearised dynamics that controllers predict with: one linearly implicit Euler step of (23), and
feedback gains."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.linear import solve_symmetric
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.types import Array

DECADES = 4.0  # time constants until an error has settled to 2 %


class ImplicitStep(NamedTuple):
    """One linearly implicit Euler step of (23) over a period h, that of the integrator: v+ = free +
    response u, q+ = q + h v+.

    A = M + h D + h^2 G with stiffness and damping of the effects, free = v + A^-1 h (F - K - C v -
    D v - h G v), response = A^-1 h B.
    """

    free: Array  # (n,)
    response: Array  # (n, n_a)
    metric: Array  # (n_a, n_a) response^T A response, in which motions by tensions are measured


def implicit_inertia(terms: Terms, period: float) -> Array:
    """A = M + h D + h^2 G (n, n) of the implicit step over a period."""
    stiffness = terms.stiffness + terms.external_stiffness
    return np.asarray(
        terms.mass + period * (terms.damping + terms.external_damping + period * stiffness)
    )


def implicit_step(terms: Terms, q_dot: Array, period: float) -> ImplicitStep:
    """The step from where `terms` were computed. Raises LinAlgError if A is singular."""
    force = terms.external_force + terms.external_damping @ q_dot - terms.elastic_force - terms.bias
    impulses = np.column_stack([terms.mass @ q_dot + period * force, period * terms.actuation])
    rates = impulses.copy()
    solve_symmetric(implicit_inertia(terms, period), rates)
    if not np.isfinite(rates).all():
        raise np.linalg.LinAlgError("the matrix of the implicit step is singular")
    return ImplicitStep(rates[:, 0], rates[:, 1:], impulses[:, 1:].T @ rates[:, 1:])


class Gains(NamedTuple):
    """Feedback gains for an error e: acceleration = kp e + kd e_dot + ki (integral of e)."""

    kp: float  # [1/s^2]
    kd: float  # [1/s]
    ki: float = 0.0  # [1/s^3]


def discrete_gains(
    settling_time: float, damping: float, period: float, integral_time: float | None = None
) -> Gains:
    """The gains that give a double integrator, held over each period, the poles exp(s period) of
    the continuous loop with poles s.

    The slowest s has the real part -4 / settling_time: e settles to 2 % in that time [s]. `damping`
    is the ratio zeta of the pair. `integral_time` [s]: a third pole at -4 / integral_time and the
    integral that goes with it; None: no integral. The loop is e_dot+ = e_dot - period (kp e + kd
    e_dot + ki i), e+ = e + period e_dot+, i+ = i + period e+. Raises TypeError, ValueError.
    """
    checked_number("period", period, 1e-9, "a positive number")
    poles = natural_frequency(settling_time, damping) * (
        -damping + np.array([1.0, -1.0]) * np.emath.sqrt(damping**2 - 1.0)
    )
    if integral_time is not None:
        poles = np.append(
            poles,
            -DECADES
            / checked_number("integral_time", integral_time, 1e-9, "a positive number, or None"),
        )
    _, *rest = np.real(np.poly(np.exp(poles * period) - 1.0))  # in z - 1
    first, second, third = (*rest, 0.0)[:3]
    return Gains(
        (second - 2.0 * third) / period**2, (first - second + third) / period, third / period**3
    )


def natural_frequency(settling_time: float, damping: float) -> float:
    """Natural frequency [rad/s] of a second-order system whose slowest pole has the real part -4 /
    settling_time [s]. Raises as above."""
    checked_number("settling_time", settling_time, 1e-9, "a positive number")
    checked_number("damping", damping, 1e-9, "a positive number")
    slow = damping if damping <= 1.0 else damping - np.sqrt(damping**2 - 1.0)
    return float(DECADES / settling_time / slow)
