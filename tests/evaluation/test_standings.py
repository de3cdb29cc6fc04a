"""Standings: interquartile means, intervals over members and episodes, and comparisons of pairs."""

import math

import numpy as np
import pytest

from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore
from soft_tendon_env.evaluation.summaries import Standing, Tails, difference

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
    assert Tails.of(half.values(KEY)) == (math.inf, math.inf)
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
