"""The fit against linear readings, whose estimate, deviations and intervals have closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t

from soft_tendon_env.identification.fit import Fit, fit, intervals, variances
from soft_tendon_env.identification.parameters import Parameter

COUNT = 40
"""Readings of the problem, in clusters of four."""
NOISE = 1e-3
"""Standard deviation of readings [m]."""
TAIL = 0.975
"""Share of Student's t below the upper end of an interval at 95 %."""


def difference(name, prior=None, low=-10.0, high=10.0):
    """A number around 0; without a prior its coordinate counts in half the bounds' distance."""
    return Parameter(
        name,
        of_scene=None,
        value=0.0,
        low=low,
        high=high,
        prior=prior,
        is_factor=False,
    )


class LinearReadings:
    """Readings J x - y of parameters' coordinates x, each in a cluster of its own by default."""

    def __init__(self, parameters, slope, measured, cluster=None):
        model = SimpleNamespace(length=0.3)
        self.plants = SimpleNamespace(parameters=parameters, model=model)
        self.slope = slope
        self.measured = measured
        if cluster is None:
            self.cluster = np.arange(len(measured))
        else:
            self.cluster = cluster

    def residual(self, x):
        return self.slope @ x - self.measured

    def jacobian(self, x):
        return self.slope


@pytest.fixture
def problem():
    """Two parameters, the second with a prior."""
    random = np.random.default_rng(3)
    free = difference("free")
    known_before = difference("known before", prior=0.5)
    slope = NOISE * random.normal(size=(COUNT, 2))
    noise = NOISE * random.normal(size=COUNT)
    truth = np.array([0.2, 1.5])
    measured = slope @ truth + noise
    cluster = np.arange(COUNT) // 4
    return LinearReadings((free, known_before), slope, measured, cluster)


def closed_form(readings, sigma):
    """Estimate and covariance of Gaussian errors, with a prior of the second coordinate alone.

    Coordinates are in deviations of their priors.
    """
    J = readings.slope
    of_data = J.T @ J / sigma**2
    of_prior = np.diag([0.0, 1.0])
    covariance = np.linalg.inv(of_data + of_prior)
    right = J.T @ readings.measured / sigma**2
    return covariance @ right, covariance


@pytest.mark.parametrize("sigma", [3e-4, 1e-3, 3e-3])
def test_data_and_priors_are_weighed_by_their_variances(problem, sigma):
    """The more noise, the nearer the second parameter to its prior."""
    estimate = fit(problem, sigma)
    x, covariance = closed_form(problem, sigma)
    variance = np.diag(covariance)
    deviation = np.sqrt(variance)
    # the fit ends where progress is noise
    np.testing.assert_array_less(np.abs(estimate.x - x), 0.03 * deviation)
    np.testing.assert_allclose(variances(estimate), variance, rtol=1e-9)
    residual = problem.residual(estimate.x)
    np.testing.assert_allclose(estimate.residual, residual, atol=1e-12)
    assert estimate.converged
    assert estimate.sigma == sigma


def test_a_noise_that_is_not_known_is_that_of_the_residuals(problem):
    """Of the readings less the parameters that the data decide: one, and a share of the other."""
    estimate = fit(problem)
    x, covariance = closed_form(problem, estimate.sigma)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(estimate.x - x), 0.03 * deviation)
    J = problem.slope
    of_data = J.T @ J / estimate.sigma**2
    decided = np.trace(covariance @ of_data)
    assert 1.0 < decided < 2.0
    squares = np.sum(problem.residual(x) ** 2)
    variance = squares / (COUNT - decided)
    expected_sigma = np.sqrt(variance)
    assert estimate.sigma == pytest.approx(expected_sigma, rel=0.02)


def test_the_fit_stays_within_its_bounds():
    parameter = difference("beyond", prior=0.5, low=-1.0, high=1.0)
    slope = np.ones((8, 1))
    measured = np.full(8, 100.0)
    readings = LinearReadings((parameter,), slope, measured)
    estimate = fit(readings, NOISE)
    # in deviations of the prior
    assert estimate.x == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize(("low", "high", "truth"), [(0.0, 10.0, 1.0), (-10.0, 0.0, -1.0)])
def test_a_number_that_begins_at_its_bound_is_found_away_from_it(low, high, truth):
    parameter = difference("at its bound", low=low, high=high)
    slope = np.ones((4, 1))
    measured = np.full(4, truth)
    readings = LinearReadings((parameter,), slope, measured)
    estimate = fit(readings, NOISE)
    assert estimate.x == pytest.approx(truth, abs=1e-5)


def test_intervals_of_independent_readings_are_student_s():
    random = np.random.default_rng(5)
    measured = NOISE * random.normal(size=6)
    # the coordinate counts in tens
    slope = np.full((6, 1), 10.0)
    readings = LinearReadings((difference("mean"),), slope, measured)
    interval = intervals(fit(readings), readings)
    assert interval.identified.all()
    mean = measured.mean()
    deviation = np.std(measured, ddof=1)
    reach = t.ppf(TAIL, 5) * deviation / np.sqrt(6.0)
    assert interval.high[0] - mean == pytest.approx(reach, rel=0.05)
    assert mean - interval.low[0] == pytest.approx(reach, rel=0.05)


def test_errors_that_clusters_share_widen_intervals():
    """Five clusters of twenty equal readings each are five readings."""
    random = np.random.default_rng(6)
    of_clusters = NOISE * random.normal(size=5)
    measured = np.repeat(of_clusters, 20)
    cluster = np.repeat(np.arange(5), 20)
    slope = np.full((100, 1), 10.0)
    readings = LinearReadings((difference("mean"),), slope, measured, cluster)
    interval = intervals(fit(readings), readings)
    # the bootstrap has the variance of five drawn from five
    deviation = np.std(of_clusters) / np.sqrt(5.0)
    reach = t.ppf(TAIL, 4) * deviation
    mean = of_clusters.mean()
    assert interval.high[0] - mean == pytest.approx(reach, rel=0.1)


def test_what_the_data_do_not_contain_has_the_bounds_as_its_interval():
    """Readings of a sum of two parameters say nothing of their difference."""
    random = np.random.default_rng(7)
    ones = np.ones(12)
    slope_of_other = random.normal(size=12)
    slope = np.column_stack([ones, ones, slope_of_other])
    measured = NOISE * random.normal(size=12)
    names = ("a", "b", "other")
    parameters = [difference(name, low=-2.0, high=2.0) for name in names]
    readings = LinearReadings(parameters, slope, measured)
    estimate = fit(readings)
    is_unknown = np.isinf(variances(estimate))
    assert is_unknown.tolist() == [True, True, False]

    interval = intervals(estimate, readings)
    assert interval.identified.tolist() == [False, False, True]
    np.testing.assert_allclose(interval.low[:2], -2.0)
    np.testing.assert_allclose(interval.high[:2], 2.0)
    assert interval.high[2] < 0.01
    (direction,) = interval.unseen
    root = np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(direction), [root, root, 0.0], atol=1e-6)


def test_factors_of_negative_numbers_have_ordered_intervals():
    """A factor e^x of -2: the greater the coordinate, the less the value."""
    negative = Parameter(
        "negative",
        of_scene=None,
        value=-2.0,
        low=-8.0,
        high=-0.5,
        prior=None,
        is_factor=True,
    )
    residual = NOISE * np.array([1.0, -1.0, 0.5, -0.5])
    slope = np.ones((4, 1))
    estimate = Fit(
        x=np.zeros(1),
        residual=residual,
        jacobian=slope,
        sigma=NOISE,
        prior=np.zeros(1),
        converged=True,
    )
    readings = LinearReadings((negative,), slope, residual)
    interval = intervals(estimate, readings)
    assert interval.low[0] < -2.0 < interval.high[0]
    # factors of both ends are each other's inverse
    assert interval.low[0] * interval.high[0] == pytest.approx(4.0)
