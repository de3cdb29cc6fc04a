"""Gains by what they are for: the closed loop has the poles that were asked for."""

import itertools

import numpy as np
import pytest

from soft_tendon_env.control.gains import DECADES, discrete_gains, natural_frequency

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
        assert np.abs(np.linalg.eigvals(matrix)).max() < 1.0


def test_eigenvalues_themselves_where_they_are_apart():
    for settling_time, damping, period in itertools.product(SETTLING_TIMES, [0.2, 0.7, 1.5], [0.005, 0.02]):
        matrix = loop(discrete_gains(settling_time, damping, period, 0.7), period, True)
        wanted = np.exp(continuous_poles(settling_time, damping, 0.7) * period)
        np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(matrix)), np.sort_complex(wanted.astype(complex)), atol=1e-7)


@pytest.mark.parametrize("integral_time", [None, 0.5])
def test_errors_settle_in_the_settling_time(integral_time):
    """Two per cent, as far as one slow pole among fast ones decides."""
    period, settling_time = 1e-3, 1.0
    matrix = loop(discrete_gains(settling_time, 20.0, period, integral_time), period, integral_time is not None)
    values, vectors = np.linalg.eig(matrix)
    slow = vectors[:, np.argmax(np.abs(values))].real
    after = np.linalg.matrix_power(matrix, round(settling_time / period)) @ slow
    assert abs(after @ slow) / (slow @ slow) == pytest.approx(np.exp(-DECADES), rel=1e-6)
    assert np.exp(-DECADES) == pytest.approx(0.02, rel=0.1)


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


@pytest.mark.parametrize("damping", DAMPINGS)
def test_the_natural_frequency_puts_the_slowest_pole(damping):
    for settling_time in SETTLING_TIMES:
        omega = natural_frequency(settling_time, damping)
        poles = np.roots([1.0, 2.0 * damping * omega, omega**2])
        assert poles.real.max() == pytest.approx(-DECADES / settling_time, rel=1e-7)


@pytest.mark.cases("name", ["settling_time", "damping", "period", "integral_time"])
@pytest.mark.cases("value", [0.0, -1.0, np.nan, np.inf])
def test_bad_numbers_are_named(name, value):
    with pytest.raises(ValueError, match=f"{name} should be a positive number"):
        discrete_gains(**{"settling_time": 0.5, "damping": 1.0, "period": 0.02, "integral_time": 0.5, name: value})


@pytest.mark.parametrize("name", ["settling_time", "damping", "period", "integral_time"])
def test_other_types_are_named(name):
    with pytest.raises(TypeError, match=name):
        discrete_gains(**{"settling_time": 0.5, "damping": 1.0, "period": 0.02, "integral_time": 0.5, name: "short"})
