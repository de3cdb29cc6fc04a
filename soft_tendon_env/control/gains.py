"""Discrete-time feedback gains from a settling time and a damping ratio, stable at the control period that there is."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.tools.checks import checked_number

DECADES = 4.0  # time constants until an error has settled to 2 %


class Gains(NamedTuple):
    """Feedback gains for an error e in the task's unit: acceleration = kp e + kd e_dot + ki (integral of e)."""

    kp: float  # [1/s^2]
    kd: float  # [1/s]
    ki: float  # [1/s^3]


def discrete_gains(settling_time: float, damping: float, period: float, integral_time: float | None = None) -> Gains:
    """The gains that give a double integrator, held over each period, the poles exp(s period) of the continuous loop with poles s.

    The slowest s has the real part -4 / settling_time: e settles to 2 % in that time [s]. `damping` is the ratio zeta of the pair:
    1 for a double pole, 5 with a settling time of 0.396 s for the paper's kp = 10,000 and kd = 1,000 in the limit of short periods.
    `integral_time` [s]: a third pole at -4 / integral_time and the integral that goes with it; None: no integral.

    The loop is e_dot+ = e_dot - period (kp e + kd e_dot + ki i), e+ = e + period e_dot+, i+ = i + period e+, as an implicit step
    moves: stable at any period, where kp and kd of the continuous loop are not beyond period kd = 2. Raises TypeError, ValueError.
    """
    checked_number("period", period, 1e-9, "a positive number")
    poles = natural_frequency(settling_time, damping) * (-damping + np.array([1.0, -1.0]) * np.emath.sqrt(damping**2 - 1.0))
    if integral_time is not None:
        poles = np.append(poles, -DECADES / checked_number("integral_time", integral_time, 1e-9, "a positive number, or None"))
    _, *rest = np.real(np.poly(np.exp(poles * period) - 1.0))  # in z - 1
    first, second, third = (*rest, 0.0)[:3]
    return Gains((second - 2.0 * third) / period**2, (first - second + third) / period, third / period**3)


def natural_frequency(settling_time: float, damping: float) -> float:
    """Natural frequency [rad/s] of a second-order system whose slowest pole has the real part -4 / settling_time [s].

    Raises TypeError, ValueError.
    """
    for name, value in (("settling_time", settling_time), ("damping", damping)):
        checked_number(name, value, 1e-9, "a positive number")
    slow = damping if damping <= 1.0 else damping - np.sqrt(damping**2 - 1.0)
    return float(DECADES / settling_time / slow)
