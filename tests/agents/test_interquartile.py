"""The interquartile mean and its interval, against cases worked out by hand."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import trim_mean

AGENTS = Path(__file__).parent.parent.parent / "agents"


@pytest.fixture
def module(monkeypatch):
    """agents/_interquartile.py."""
    monkeypatch.syspath_prepend(str(AGENTS))
    return importlib.import_module("_interquartile")


@pytest.mark.parametrize(
    "values, mean",
    [
        ([7.0], 7.0),
        ([1.0, 2.0], 1.5),
        ([1.0, 2.0, 6.0], 3.0),  # a quarter of 3 is less than one: nothing is cut
        ([9.0, 1.0, 4.0, 2.0], 3.0),  # 1 and 9 are cut
        ([5.0, 100.0, 3.0, -100.0, 4.0], 4.0),  # a quarter of 5 is 1.25, so one at either end
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 80.0], 4.5),  # two at either end: (3 + 4 + 5 + 6) / 4
    ],
)
def test_the_middle_half_is_averaged(module, values, mean):
    assert module.interquartile_mean(values) == pytest.approx(mean)


@pytest.mark.parametrize("count", range(1, 14))
def test_counts_are_cut_as_scipy_cuts_them(module, count):
    values = np.random.default_rng(count).normal(size=(3, count, 2))
    np.testing.assert_allclose(module.interquartile_mean(values, axis=1), trim_mean(values, 0.25, axis=1), atol=1e-15)


def test_a_run_without_a_number_is_the_worst(module):
    assert module.interquartile_mean([1.0, math.nan, 2.0, 4.0]) == 3.0, "1 is cut, and what has no number"
    assert math.isnan(module.interquartile_mean([1.0, math.nan])), "nothing is cut of two"
    low, high = module.bootstrap_interval([[1.0, math.nan]])
    assert low == 1.0 and math.isnan(high)


@pytest.mark.parametrize("confidence, interval", [(0.95, (1.0, 3.0)), (0.4, (2.0, 2.0))])
def test_an_interval_of_two_runs(module, confidence, interval):
    # Of the runs 1 and 3 there are four resamples: 11, 13, 31, 33 with means 1, 2, 2, 3. The 2.5 % and 97.5 % points are 1 and 3, the
    # 30 % and 70 % points are 2.
    assert module.bootstrap_interval([[1.0, 3.0]], confidence) == interval


@pytest.mark.parametrize("confidence, interval", [(0.95, (50.0, 51.0)), (0.5, (50.5, 50.5))])
def test_strata_are_resampled_apart(module, confidence, interval):
    # Every resample has two of {0, 1} and two of {100, 101}; its middle two are the larger of the first (1 with probability 3/4) and
    # the smaller of the second (100 with probability 3/4). Means: 50 in 3/16, 50.5 in 10/16, 51 in 3/16. Four drawn from all would
    # also be all of one stratum.
    strata = [[0.0, 1.0], [100.0, 101.0]]
    assert module.bootstrap_interval(strata, confidence) == interval
    together = module.bootstrap_interval([[0.0, 1.0, 100.0, 101.0]])
    assert together.low <= 1.0 and together.high >= 100.0


def test_runs_are_drawn_as_a_whole(module):
    runs = np.array([[0.0, 10.0], [4.0, 6.0]])  # the two numbers of a run always add up to 10: 0 comes with 10, 4 with 6
    drawn = module._draw(runs, 100, np.random.default_rng(0))
    assert drawn.shape == (100, 2, 2)
    np.testing.assert_array_equal(drawn.sum(axis=2), 10.0)
    low, high = module.bootstrap_interval([runs])
    np.testing.assert_array_equal([low, high], [[0.0, 6.0], [4.0, 10.0]])


def test_nothing_varies(module):
    assert module.bootstrap_interval([[2.5]]) == (2.5, 2.5), "one run says nothing of how far it is known"
    assert module.bootstrap_interval([[2.0] * 5, [2.0]]) == (2.0, 2.0)


def test_a_seed_gives_the_same_interval_again(module):
    runs = np.random.default_rng(1).normal(size=7)
    first = module.bootstrap_interval([runs], seed=3)
    assert first == module.bootstrap_interval([runs], seed=3) != module.bootstrap_interval([runs], seed=4, resamples=50)
    assert first.low < module.interquartile_mean(runs) < first.high


def test_mistakes(module):
    with pytest.raises(ValueError, match="every stratum should have at least one run"):
        module.bootstrap_interval([[1.0], []])
    with pytest.raises(ValueError, match="values should have at least one run"):
        module.interquartile_mean([])
