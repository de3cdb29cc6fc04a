"""Standings: interquartile means, intervals over members and episodes, and comparisons of pairs."""

import math

import numpy as np
import pytest

from soft_tendon_env.arena.standings import Standing, compared
from soft_tendon_env.evaluation.metrics import ActionTime, EpisodeScore, ErrorScore

KEY = "own_rms"


def standing(values):
    """values: (members, episodes) of an error, the only one; None where an episode diverged."""

    def score(seed, value):
        error, cause = (math.nan, "too fast") if value is None else (value, None)
        metrics, time = {"effort": 5.0, "chatter": 0.1}, ActionTime(0.001, 0.002)
        return EpisodeScore(seed, 10, {"own": ErrorScore(error, error)}, value, metrics, 1, 0.0, None, cause, time)

    return Standing([[score(k, value) for k, value in enumerate(row)] for row in values])


def test_an_episode_that_diverged_is_worse_than_any_number():
    """The mean is that of the middle half of all episodes of all members."""
    assert standing([[1.0, 2.0], [3.0, 100.0]]).mean(KEY).value == 2.5
    assert standing([[1.0, 1.0], [1.0, None]]).mean(KEY).value == 1.0
    half = standing([[1.0, 1.0, None, None]])
    assert half.mean(KEY).value == math.inf and half.bad == 0.5 and half.settled == 0.5 and half.violations == 4


def test_the_interval_covers_the_truth_as_often_as_it_says():
    """Normal episodes around normal members: in 95 of 100 draws the true mean is inside, but for what few members cannot know."""
    rng, inside = np.random.default_rng(0), 0
    for _ in range(100):
        values = 10.0 + rng.normal(0.0, 0.2, (8, 1)) + rng.normal(0.0, 1.0, (8, 20))
        _, low, high = standing(values.tolist()).mean(KEY)
        inside += low <= 10.0 <= high
    assert 85 <= inside <= 100


def test_comparisons_are_made_episode_by_episode():
    """One is better by a little on every episode, of which some are far harder than others."""
    hard = np.array([1.0, 10.0, 100.0, 1000.0])
    found = compared(standing([(0.9 * hard).tolist()]), standing([hard.tolist()]), KEY)
    assert found.probability == 1.0 and (found.low, found.high) == (1.0, 1.0) and not found.separated


def test_standings_are_apart_where_their_intervals_are():
    near, far = standing([[1.0, 1.1, 0.9, 1.0]] * 5), standing([[5.0, 5.1, 4.9, 5.0]])
    assert compared(near, far, KEY).separated and compared(far, near, KEY).probability == 0.0
    assert compared(near, near, KEY).probability == 0.5, "with itself"
    with pytest.raises(ValueError, match="same episodes"):
        compared(near, standing([[1.0, 2.0]]), KEY)
