"""The interquartile mean and its interval, against cases worked out by hand."""

import math

import numpy as np
import pytest
from scipy.stats import trim_mean

from soft_tendon_env.evaluation import summaries
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


def test_seeds_and_episodes_are_drawn_apart(monkeypatch):
    # Two seeds, 0 and 100, with episodes of +0 and +1. A resample has one of 0 and 100 twice in 1/2, both in 1/2; its episodes likewise.
    values = [[0.0, 1.0], [100.0, 101.0]]
    assert bootstrap_interval(values, axes=2) == (0.0, 101.0)
    monkeypatch.setattr(summaries, "CONFIDENCE", 0.4)
    assert bootstrap_interval(values, axes=2) == (50.0, 51.0), "of both seeds, of either episode"
