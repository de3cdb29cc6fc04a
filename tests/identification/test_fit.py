"""The fit against linear readings, whose estimate, deviations and intervals have closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t

from soft_tendon_env.identification.fit import Fit, fit, intervals, variances
from soft_tendon_env.identification.parameters import Parameter

LENGTH = 0.3
DIFFERENCES = 40
"""Readings of a test, in clusters of four."""


def difference(name, prior=None, low=-10.0, high=10.0):
    """A number around 0; without a prior its coordinate counts in tenths of the bounds."""
    return Parameter(name, None, 0.0, low, high, prior, is_factor=False)


class LinearReadings:
    """Readings J x - y of parameters' coordinates x."""

    def __init__(self, parameters, slope, measured, cluster=None):
        model = SimpleNamespace(length=LENGTH)
        self.plants = SimpleNamespace(parameters=parameters, model=model)
        self.slope = slope
        self.measured = measured
        self.cluster = np.arange(len(measured)) if cluster is None else cluster

    def residual(self, x):
        return self.slope @ x - self.measured

    def jacobian(self, x):
        return self.slope


@pytest.fixture
def problem():
    """Two parameters, the second with a prior, and readings with a noise of a millimetre."""
    random = np.random.default_rng(3)
    parameters = (difference("free"), difference("known before", prior=0.5))
    slope = 1e-3 * random.normal(size=(DIFFERENCES, 2))
    truth = np.array([0.2, 1.5])
    measured = slope @ truth + 1e-3 * random.normal(size=DIFFERENCES)
    return LinearReadings(parameters, slope, measured, np.arange(DIFFERENCES) // 4)


def closed_form(readings, sigma):
    """Estimate and covariance of Gaussian errors, the prior of the second coordinate of width 1."""
    J = readings.slope
    information = J.T @ J / sigma**2 + np.diag([0.0, 1.0])
    covariance = np.linalg.inv(information)
    return covariance @ J.T @ readings.measured / sigma**2, covariance


@pytest.mark.parametrize("sigma", [3e-4, 1e-3, 3e-3])
def test_data_and_priors_are_weighed_by_their_variances(problem, sigma):
    """The more noise, the nearer the second parameter to its prior."""
    estimate = fit(problem, sigma)
    x, covariance = closed_form(problem, sigma)
    deviation = np.sqrt(np.diag(covariance))
    assert (np.abs(estimate.x - x) < 0.03 * deviation).all(), "where progress is noise it ends"
    np.testing.assert_allclose(variances(estimate), deviation**2, rtol=1e-9)
    np.testing.assert_allclose(estimate.residual, problem.residual(estimate.x), atol=1e-12)
    assert estimate.converged
    assert estimate.sigma == sigma


def test_a_noise_that_is_not_known_is_that_of_the_residuals(problem):
    """Less the parameters that the data decide: one, and a share of the one with a prior."""
    estimate = fit(problem)
    x, covariance = closed_form(problem, estimate.sigma)
    assert (np.abs(estimate.x - x) < 0.03 * np.sqrt(np.diag(covariance))).all()
    J = problem.slope
    decided = np.trace(covariance @ J.T @ J) / estimate.sigma**2
    assert 1.0 < decided < 2.0
    squares = np.sum(problem.residual(x) ** 2)
    assert estimate.sigma == pytest.approx(np.sqrt(squares / (DIFFERENCES - decided)), rel=0.02)


def test_the_fit_stays_within_its_bounds():
    slope = 1e-3 * np.ones((8, 1))
    readings = LinearReadings((difference("beyond", 0.5, -1.0, 1.0),), slope, 0.05 * slope[:, 0])
    readings.measured += 1.0
    assert fit(readings, 1e-3).x == pytest.approx(2.0, abs=1e-6), "the bound, in deviations"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_number_that_begins_at_its_bound_is_found_away_from_it(side):
    """Half of the way to the other bound, of a scene that lies on one."""
    low, high = sorted((0.0, 10.0 * side))
    slope = np.ones((4, 1))
    readings = LinearReadings(
        (difference("at its bound", None, low, high),), slope, side * np.ones(4)
    )
    assert fit(readings, 1e-3).x == pytest.approx(side, abs=1e-5)


def test_intervals_are_at_least_student_s():
    """Of independent readings as wide as Student's t of their degrees of freedom says."""
    random = np.random.default_rng(5)
    slope = np.ones((6, 1))
    measured = 1e-3 * random.normal(size=6)
    readings = LinearReadings((difference("mean"),), 10.0 * slope, measured)
    estimate = fit(readings)
    deviation = np.std(measured, ddof=1) / np.sqrt(6.0)
    reach = t.ppf(0.975, 5) * deviation
    found = intervals(estimate, readings)
    assert found.identified.all()
    assert found.high[0] + found.low[0] == pytest.approx(2.0 * measured.mean(), abs=1e-8)
    assert found.high[0] - measured.mean() == pytest.approx(reach, rel=0.05)


def test_errors_that_clusters_share_widen_intervals():
    """Five clusters of twenty equal readings each are five readings."""
    random = np.random.default_rng(6)
    of_clusters = 1e-3 * random.normal(size=5)
    measured = np.repeat(of_clusters, 20)
    slope = 10.0 * np.ones((100, 1))
    cluster = np.repeat(np.arange(5), 20)
    readings = LinearReadings((difference("mean"),), slope, measured, cluster)
    found = intervals(fit(readings), readings)
    # the bootstrap's deviation is that of the clusters' means, by their own number
    deviation = np.std(of_clusters) / np.sqrt(5.0)
    reach = t.ppf(0.975, 4) * deviation
    assert found.high[0] - of_clusters.mean() == pytest.approx(reach, rel=0.1)


def test_what_the_data_do_not_contain_has_the_bounds_as_its_interval():
    """Readings of a sum of two parameters say nothing of their difference."""
    random = np.random.default_rng(7)
    slope = np.column_stack([np.ones(12), np.ones(12), np.zeros(12)])
    slope[:, 2] = random.normal(size=12)
    parameters = [difference(name, low=-2.0, high=2.0) for name in ("a", "b", "c")]
    readings = LinearReadings(parameters, slope, 1e-3 * random.normal(size=12))
    estimate = fit(readings)
    assert np.isinf(variances(estimate)).tolist() == [True, True, False]
    found = intervals(estimate, readings)
    assert found.identified.tolist() == [False, False, True]
    np.testing.assert_allclose([found.low[:2], found.high[:2]], [[-2.0, -2.0], [2.0, 2.0]])
    assert found.high[2] < 0.01
    (direction,) = found.unseen
    np.testing.assert_allclose(np.abs(direction), [np.sqrt(0.5), np.sqrt(0.5), 0.0], atol=1e-6)


def test_factors_of_negative_numbers_have_ordered_intervals():
    """A factor e^x of -2: the greater the coordinate, the less the value."""
    negative = Parameter("E", None, -2.0, -8.0, -0.5, None, is_factor=True)
    residual = 1e-3 * np.array([1.0, -1.0, 0.5, -0.5])
    slope = np.ones((4, 1))
    estimate = Fit(np.zeros(1), residual, slope, 1e-3, np.zeros(1), converged=True)
    readings = LinearReadings((negative,), slope, residual)
    found = intervals(estimate, readings)
    assert found.low[0] < -2.0 < found.high[0]
    assert found.low[0] * found.high[0] == pytest.approx(4.0)
