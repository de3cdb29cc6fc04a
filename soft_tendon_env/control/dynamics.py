"""Linearised dynamics that controllers predict with, and feedback gains.

The dynamics are one linearly implicit Euler step of (23).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.algebra.linear import solve_symmetric
from soft_tendon_env.model.terms import Terms
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.types import Array

DECADES = 4.0  # time constants until an error has settled to 2 %
LEAST_TIME = 1e-9  # [s] that counts as positive
LEAST_DAMPING = 1e-9  # ratio that does


class ImplicitStep(NamedTuple):
    """One linearly implicit Euler step of (23) over a period h, that of the integrator.

    It is v+ = free + response u, q+ = q + h v+.

    A = M + h D + h^2 G with stiffness and damping of the effects, free = v + A^-1 h (F - K - C v -
    D v - h G v), response = A^-1 h B.
    """

    free: Array  # (n,)
    response: Array  # (n, n_a)
    metric: Array  # (n_a, n_a) response^T A response, in which motions by tensions are measured


def implicit_inertia(terms: Terms, period: float) -> Array:
    """A = M + h D + h^2 G (n, n) of the implicit step over a period."""
    stiffness = terms.stiffness + terms.external_stiffness
    damping = terms.damping + terms.external_damping
    resistance = damping + period * stiffness
    return np.asarray(terms.mass + period * resistance)


def implicit_step(terms: Terms, q_dot: Array, period: float) -> ImplicitStep:
    """Linearly implicit Euler step of the motion.

    Args:
        terms: of the equation of motion, where the step begins.
        q_dot: rates (n,) there.
        period: of the step [s].

    Returns:
        The rates after the step, as a linear function of the tensions.

    Raises:
        LinAlgError: if A is singular.
    """
    # A v+ = M v + h (F + D_F v - K - C v) + h B u: F is linearised about v, and the external
    # damping D_F stands on both sides
    effects = terms.external_force + terms.external_damping @ q_dot
    force = effects - terms.elastic_force - terms.bias
    free_impulse = terms.mass @ q_dot + period * force
    impulses = np.column_stack([free_impulse, period * terms.actuation])
    rates = impulses.copy()
    solve_symmetric(implicit_inertia(terms, period), rates)
    if not np.isfinite(rates).all():
        raise np.linalg.LinAlgError("the matrix of the implicit step is singular")
    free = rates[:, 0]
    response = rates[:, 1:]
    metric = impulses[:, 1:].T @ response
    return ImplicitStep(free, response, metric)


class Gains(NamedTuple):
    """Feedback gains for an error e: acceleration = kp e + kd e_dot + ki (integral of e)."""

    kp: float  # [1/s^2]
    kd: float  # [1/s]
    ki: float = 0.0  # [1/s^3]


def discrete_gains(
    settling_time: float, damping: float, period: float, integral_time: float | None = None
) -> Gains:
    """Computes gains by pole placement for a double integrator held over each period.

    They give it the poles exp(s period) of the continuous loop with poles s.

    The slowest s has the real part -4 / settling_time: e settles to 2 % in that time. The loop is
    e_dot+ = e_dot - period (kp e + kd e_dot + ki i), e+ = e + period e_dot+, i+ = i + period e+.

    Args:
        settling_time: [s].
        damping: ratio zeta of the pair of poles.
        period: of control [s].
        integral_time: [s] of a third pole at -4 / integral_time, and the integral that goes with
            it; None: no integral.

    Returns:
        kp, kd and ki.

    Raises:
        TypeError, ValueError: for what is no positive number.
    """
    checked_number("period", period, LEAST_TIME, "a positive number")
    natural = natural_frequency(settling_time, damping)
    signs = np.array([1.0, -1.0])
    split = np.emath.sqrt(damping**2 - 1.0) * signs
    poles = natural * (split - damping)
    if integral_time is not None:
        checked_number("integral_time", integral_time, LEAST_TIME, "a positive number, or None")
        poles = np.append(poles, -DECADES / integral_time)
    # characteristic polynomial in z - 1; without an integral it has no third coefficient
    discrete_poles = np.exp(poles * period)
    coefficients = np.real(np.poly(discrete_poles - 1.0))
    first, second = coefficients[1:3]
    third = coefficients[3] if integral_time is not None else 0.0
    return Gains(
        kp=(second - 2.0 * third) / period**2,
        kd=(first - second + third) / period,
        ki=third / period**3,
    )


def natural_frequency(settling_time: float, damping: float) -> float:
    """Natural frequency [rad/s] of a second-order system with a settling time [s].

    Its slowest pole has the real part -4 / settling_time. Raises as above.
    """
    checked_number("settling_time", settling_time, LEAST_TIME, "a positive number")
    checked_number("damping", damping, LEAST_DAMPING, "a positive number")
    # real part of the slowest pole, in natural frequencies: above 1 there are two real poles
    slow = damping
    if damping > 1.0:
        slow = damping - np.sqrt(damping**2 - 1.0)
    return float(DECADES / settling_time / slow)
