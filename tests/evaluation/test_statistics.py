"""Interquartile means, their intervals over seeds of training and episodes, and differences of pairs, against cases worked out by hand."""

import math

import numpy as np
import pytest
from scipy.stats import trim_mean

from soft_tendon_env.evaluation import summaries
from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.summaries import Standing, bootstrap_interval, difference, interquartile_mean, tails

KEY = "own_rms"


def standing(values, shared=False):
    """values: (members, episodes) of an error, the only one; None where an episode diverged. shared: members play other episodes each."""

    def score(seed, value):
        error, cause = (math.nan, "too fast") if value is None else (value, None)
        metrics = {"effort": 5.0, "chatter": 0.1}
        return EpisodeScore(seed, 10, {"own": ErrorScore(error, error)}, False, metrics, 0.0, None, cause, 0.001, 1e3)

    return Standing([[score(shared * place * len(row) + k, value) for k, value in enumerate(row)] for place, row in enumerate(values)])


def test_an_episode_that_diverged_is_worse_than_any_number():
    """The mean is that of the middle half of all episodes of all members."""
    assert standing([[1.0, 2.0], [3.0, 100.0]]).mean(KEY).value == 2.5
    assert standing([[1.0, 1.0], [1.0, None]]).mean(KEY).value == 1.0
    half = standing([[1.0, 1.0, None, None]])
    assert tails(half.values(KEY)) == (math.inf, math.inf)
    assert half.mean(KEY).value == math.inf


def test_comparisons_are_made_episode_by_episode():
    """One is better by a little on every episode, of which some are far harder than others: their own intervals overlap."""
    hard = np.geomspace(1.0, 10.0, 20)
    one, other = standing([(0.9 * hard).tolist()]), standing([hard.tolist()])
    found = difference(one, other, KEY)
    assert one.mean(KEY).high > other.mean(KEY).low
    assert found.value == pytest.approx(one.mean(KEY).value - other.mean(KEY).value) and found.low < found.value < found.high < 0.0


def test_policies_that_differ_by_chance_alone_are_not_separated():
    near, far, lost = standing([[1.0, 1.1, 0.9, 1.0]] * 5), standing([[5.0, 5.1, 4.9, 5.0]]), standing([[None] * 4])
    assert difference(near, far, KEY).high < 0.0 and difference(far, far, KEY) == (0.0, 0.0, 0.0)
    by_chance = difference(standing([[1.0, 5.0, 3.0]]), standing([[5.0, 1.0, 3.0]]), KEY)
    assert by_chance.low < 0.0 < by_chance.high
    assert difference(near, lost, KEY).high == -math.inf and difference(lost, far, KEY).low == math.inf
    assert math.isnan(difference(lost, lost, KEY).value)


@pytest.mark.parametrize("other", [[[1.0, 2.0]], [[1.0, 1.0, 1.0, 1.0]] * 2])
def test_who_has_not_played_the_same_episodes_alone_is_not_compared(other):
    with pytest.raises(ValueError, match="single member, which has played the same episodes"):
        difference(standing([[1.0, 1.1, 0.9, 1.0]]), standing(other), KEY)


@pytest.mark.cases("count", range(1, 14))
def test_the_middle_half_is_averaged_and_counts_are_cut_as_scipy_cuts_them(count):
    assert interquartile_mean([5.0, 100.0, 3.0, -100.0, 4.0]) == 4.0, "a quarter of 5 is 1.25, so one at either end"
    values = np.random.default_rng(count).normal(size=(3, count, 2))
    np.testing.assert_allclose(interquartile_mean(values, axis=1), trim_mean(values, 0.25, axis=1), atol=1e-15)


@pytest.mark.cases(
    "values, expected",
    [
        ([[3.0] * 6, [3.0] * 3 + [70.0] * 3], (19.75, 70.0)),  # whose interquartile mean is 3
        (np.arange(11.0), (5.0, 9.0)),
        ([1.0] * 10 + [math.inf], (math.inf, 1.0)),
        ([1.0] * 8 + [math.inf] * 2, (math.inf, math.inf)),
    ],
)
def test_tails_are_what_the_middle_half_hides(values, expected):
    assert tails(values) == pytest.approx(expected)


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
