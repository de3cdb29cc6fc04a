"""Bank of timings: hypotheses are judged by likelihoods, and given up."""

import numpy as np
import pytest

from soft_tendon_env.control import timing_bank
from soft_tendon_env.control.command_filter import Timing

UNKNOWN = Timing(None, None)
GREATEST = Timing(0.08, 0.06)


def test_the_grid_has_every_timing_and_mostly_no_lag():
    bank = timing_bank.first_bank(5, UNKNOWN, GREATEST, 0.3)
    weight = bank.weight
    assert weight.sum() == pytest.approx(1.0)
    assert weight[bank.timing.lag > 0.0].sum() == pytest.approx(0.3)
    assert bank.timing.latency.max() == pytest.approx(0.08)
    steps = np.diff(np.unique(bank.timing.latency))
    np.testing.assert_allclose(steps, timing_bank.LATENCY_STEP)
    means, deviations = bank.moments()
    assert means.latency == pytest.approx(0.04)
    # that of a uniform distribution of 21 latencies
    expected_latency = 0.004 * np.sqrt((21**2 - 1) / 12)
    assert deviations.latency == pytest.approx(expected_latency)


def test_what_is_known_has_one_value():
    bank = timing_bank.first_bank(5, Timing(0.03, None), GREATEST, 0.3)
    assert set(bank.timing.latency) == {0.03}
    assert bank.timing.lag.size == len(timing_bank.LAGS)
    late = timing_bank.first_bank(5, Timing(None, 0.0), GREATEST, 0.3)
    assert set(late.timing.lag) == {0.0}
    expected_weight = 1.0 / late.timing.latency.size
    np.testing.assert_allclose(late.weight, expected_weight)


def test_likelihoods_multiply():
    """By Bayes: of two measurements the squares of the innovations add."""
    bank = timing_bank.first_bank(2, Timing(None, 0.0), GREATEST, 0.0)
    size = bank.timing.latency.size
    rng = np.random.default_rng(0)
    innovations = rng.normal(size=(2, 3, size))
    innovations[:, :, 0] = 0.1  # one that is not surprised
    root = np.diag([1.0, 2.0, 0.5])
    judged = bank
    squares = np.zeros(size)
    for innovation in innovations:
        judged = timing_bank.judged(judged, innovation, root, root)
        squares += ((root @ innovation) ** 2).sum(axis=0)
    likelihood = np.exp(-0.5 * squares)
    expected_weight = likelihood / likelihood.sum()
    np.testing.assert_allclose(judged.weight, expected_weight, rtol=1e-9)


def test_innovations_that_surprise_everybody_tell_less():
    bank = timing_bank.first_bank(2, Timing(None, 0.0), GREATEST, 0.0)
    innovations = np.full((3, bank.timing.latency.size), 20.0)
    innovations[:, 0] = 10.0
    root = np.eye(3)
    judged = timing_bank.judged(bank, innovations, root, root)
    # as if innovations were a tenth as large: 2 and 1 in each of three components
    square = 3 * 2.0**2
    least_square = 3 * 1.0**2
    likelihood_ratio = np.exp(-0.5 * (square - least_square))
    weight_ratio = judged.weight[1] / judged.weight[0]
    assert weight_ratio == pytest.approx(likelihood_ratio)
    assert judged.sharp_weight[0] == pytest.approx(1.0)


def test_the_sharp_weights_take_the_motions_as_they_are_linearised():
    bank = timing_bank.first_bank(1, Timing(None, 0.0), Timing(0.004, 0.0), 0.5)
    innovation = 2.0  # of the second timing; the first has none
    innovations = np.array([[0.0, innovation]])
    inverse_deviation = 0.1
    root = np.array([[inverse_deviation]])
    sharp_root = np.eye(1)
    judged = timing_bank.judged(bank, innovations, root, sharp_root)
    weight_first, weight_second = judged.weight
    sharp_first, sharp_second = judged.sharp_weight
    expected_ratio = np.exp(-0.5 * (inverse_deviation * innovation) ** 2)
    expected_sharp_ratio = np.exp(-0.5 * innovation**2)
    assert weight_second / weight_first == pytest.approx(expected_ratio)
    assert sharp_second / sharp_first == pytest.approx(expected_sharp_ratio)


def test_the_unlikely_are_given_up():
    bank = timing_bank.first_bank(2, Timing(None, 0.0), GREATEST, 0.0)
    log_likelihood = np.zeros(bank.timing.latency.size)
    log_likelihood[3:] = 2.0 * np.log(timing_bank.UNLIKELY)
    bank = timing_bank.pruned(bank._replace(log_likelihood=log_likelihood))
    np.testing.assert_allclose(bank.timing.latency, [0.0, 0.004, 0.008])
    assert bank.deviation.shape == (2, 3)
    assert bank.sharp_weight.shape == (3,)
