"""The interquartile mean and its interval, against cases worked out by hand."""

import math

import numpy as np
import pytest
from scipy.stats import bootstrap, trim_mean

from soft_tendon_env.evaluation.summaries import Tails, bootstrap_interval, interquartile_mean


@pytest.mark.cases("count", range(1, 14))
def test_the_middle_half_is_averaged_and_counts_are_cut_as_scipy_cuts_them(count):
    assert interquartile_mean([5.0, 100.0, 3.0, -100.0, 4.0]) == 4.0, "a quarter of 5 is 1.25, so one at either end"
    values = np.random.default_rng(count).normal(size=(3, count, 2))
    np.testing.assert_allclose(interquartile_mean(values, axis=1), trim_mean(values, 0.25, axis=1), atol=1e-15)


@pytest.mark.cases(
    "values, tails",
    [
        ([[3.0] * 6, [3.0] * 3 + [70.0] * 3], (19.75, 70.0)),  # whose interquartile mean is 3
        (np.arange(11.0), (5.0, 9.0)),
        ([1.0] * 10 + [math.inf], (math.inf, 1.0)),
        ([1.0] * 8 + [math.inf] * 2, (math.inf, math.inf)),
        ([], (math.nan, math.nan)),
    ],
)
def test_tails_are_what_the_middle_half_hides(values, tails):
    assert Tails.of(values) == pytest.approx(tails, nan_ok=True)


def test_a_run_without_a_number_is_the_worst():
    assert interquartile_mean([1.0, math.nan, 2.0, 4.0]) == 3.0, "1 is cut, and what has no number"
    assert math.isnan(interquartile_mean([1.0, math.nan])), "nothing is cut of two"
    low, high = bootstrap_interval([1.0, math.nan])
    assert low == 1.0 and math.isnan(high)


@pytest.mark.cases("confidence, interval", [(0.95, (1.0, 3.0)), (0.4, (2.0, 2.0))])
def test_an_interval_of_two_runs(confidence, interval):
    # Of the runs 1 and 3 there are four resamples: 11, 13, 31, 33 with means 1, 2, 2, 3. The 2.5 % and 97.5 % points are 1 and 3, the
    # 30 % and 70 % points are 2.
    assert bootstrap_interval([1.0, 3.0], confidence=confidence) == interval


def test_intervals_of_many_runs_are_those_of_scipy():
    runs = np.random.default_rng(1).normal(size=12)
    middle = lambda values, axis: trim_mean(values, 0.25, axis=axis)  # noqa: E731
    theirs = bootstrap((runs,), middle, n_resamples=20_000, method="percentile", rng=np.random.default_rng(0)).confidence_interval
    ours = bootstrap_interval(runs, resamples=20_000)
    assert ours == pytest.approx((theirs.low, theirs.high), abs=0.02) and ours == bootstrap_interval(runs, resamples=20_000)


def test_seeds_and_episodes_are_drawn_apart():
    # Two seeds, 0 and 100, with episodes of +0 and +1. A resample has one of 0 and 100 twice in 1/2, both in 1/2; its episodes likewise.
    values = [[0.0, 1.0], [100.0, 101.0]]
    assert bootstrap_interval(values, axes=2) == (0.0, 101.0)
    assert bootstrap_interval(values, axes=2, confidence=0.4) == (50.0, 51.0), "of both seeds, of either episode"


def test_runs_are_drawn_as_a_whole():
    runs = np.array([[0.0, 10.0], [4.0, 6.0]])  # the two numbers of a run always add up to 10: 0 comes with 10, 4 with 6
    sums = bootstrap_interval(runs, statistic=lambda drawn, axis: np.ptp(drawn.sum(axis=2), axis=1))
    assert sums == (0.0, 0.0)
    low, high = bootstrap_interval(runs)
    np.testing.assert_array_equal([low, high], [[0.0, 6.0], [4.0, 10.0]])


def test_mistakes():
    for wrong in ([], [[]]):
        with pytest.raises(ValueError, match="values should have at least one run"):
            bootstrap_interval(wrong, axes=np.ndim(wrong))
    with pytest.raises(ValueError, match="values should have at least one run"):
        interquartile_mean([])
