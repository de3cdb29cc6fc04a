"""Gains by what they are for: the closed loop has the poles that were asked for."""

import itertools

import numpy as np
import pytest

from soft_tendon_env.control.gains import DECADES, discrete_gains

SETTLING_TIMES = [0.05, 0.2, 0.396, 1.0, 5.0]
DAMPINGS = [0.2, 0.7, 1.0, 1.5, 5.0]  # under-, critically and overdamped
PERIODS = [1e-4, 1e-3, 0.02, 0.2]
INTEGRAL_TIMES = [None, 0.1, 0.5, 3.0]


def continuous_poles(settling_time, damping, integral_time=None):
    """Two of damping ratio zeta, the slowest at -4 / settling_time, and that of the integral."""
    pair = np.roots([1.0, 2.0 * damping, 1.0])
    pair = pair / -pair.real.max() * DECADES / settling_time
    return pair if integral_time is None else np.append(pair, -DECADES / integral_time)


def loop(gains, period, integral):
    """The documented loop as a matrix for (e_dot, e, i), or (e_dot, e)."""
    kp, kd, ki = gains
    rate = np.array([1.0 - period * kd, -period * kp, -period * ki])
    error = np.array([0.0, 1.0, 0.0]) + period * rate
    total = np.array([0.0, 0.0, 1.0]) + period * error
    size = 3 if integral else 2
    return np.stack([rate, error, total])[:size, :size]


def characteristic(matrix):
    """Coefficients of its characteristic polynomial, by traces and determinants: exact also where eigenvalues coincide."""
    if len(matrix) == 2:
        return np.array([-np.trace(matrix), np.linalg.det(matrix)])
    return np.array([-np.trace(matrix), 0.5 * (np.trace(matrix) ** 2 - np.trace(matrix @ matrix)), -np.linalg.det(matrix)])


@pytest.mark.cases("period", PERIODS)
@pytest.mark.cases("integral_time", INTEGRAL_TIMES)
def test_the_loop_has_the_poles_of_the_continuous_one(period, integral_time):
    """Compared as polynomials in (z - 1) / period, which stay well conditioned at short periods and double poles."""
    for settling_time, damping in itertools.product(SETTLING_TIMES, DAMPINGS):
        matrix = loop(discrete_gains(settling_time, damping, period, integral_time), period, integral_time is not None)
        found = characteristic((matrix - np.eye(len(matrix))) / period)
        wanted = np.poly(np.expm1(continuous_poles(settling_time, damping, integral_time) * period) / period)[1:]
        np.testing.assert_allclose(found, wanted.real, rtol=1e-6)
        slowest = np.exp(-DECADES / max(settling_time, integral_time or 0.0) * period)
        assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(slowest, rel=1e-4, abs=1e-6) and np.exp(-DECADES) < 0.02


def test_the_paper_s_gains_are_the_limit_of_short_periods():
    distances = []
    for period in (1e-5, 1e-6):
        gains = discrete_gains(0.396, 5.0, period)
        assert gains.ki == 0.0
        distances.append([abs(gains.kp / 1e4 - 1.0), abs(gains.kd / 1e3 - 1.0)])
    assert np.max(distances[1]) < 2e-3
    assert np.max(distances[0]) < 2e-2


def test_short_periods_give_the_gains_of_the_continuous_loop():
    """To first order in the period: ten times shorter, ten times nearer."""
    _, *wanted = np.poly(continuous_poles(0.5, 0.8, 0.4)).real  # s^3 + kd s^2 + kp s + ki
    kd, kp, ki = wanted
    far, near = (np.array(discrete_gains(0.5, 0.8, period, 0.4)) / [kp, kd, ki] - 1.0 for period in (1e-4, 1e-5))
    np.testing.assert_allclose(far / near, 10.0, rtol=0.02)


@pytest.mark.cases("name", ["settling_time", "damping", "period", "integral_time"])
@pytest.mark.cases("value", [0.0, -1.0, np.nan, np.inf, "short"])
def test_what_is_no_positive_number_is_named(name, value):
    with pytest.raises((TypeError, ValueError), match=f"{name} should be a positive number"):
        discrete_gains(**{"settling_time": 0.5, "damping": 1.0, "period": 0.02, "integral_time": 0.5, name: value})
