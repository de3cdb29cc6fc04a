"""Scores, interquartile means, intervals and differences of pairs: against episodes and cases that
are worked out by hand."""

import csv
import math

import numpy as np
import pytest
from scipy.stats import trim_mean

from soft_tendon_env import register
from soft_tendon_env.evaluation import summaries
from soft_tendon_env.evaluation.metrics import (
    Episode,
    EpisodeScore,
    ErrorScore,
    Metric,
    chatter,
    has_settled,
    score,
)
from soft_tendon_env.evaluation.summaries import (
    Standing,
    bootstrap_interval,
    difference,
    interquartile_mean,
    summarise,
    tracking_cost,
)
from soft_tendon_env.evaluation.tables import records, summary_cells, write_csv

PERIOD = 0.5  # [s]
KEY = "own_rms"


def episode(position=(0.3, 0.3, 0.04, 0.03, 0.005), **changes):
    """Two seconds of two tendons on a rod of 1 m."""
    steps = len(position) - 1
    values = {
        "seed": 7,
        "period": PERIOD,
        "length": 1.0,
        "errors": {"position_error": np.array(position), "angle_error": np.full(steps + 1, 0.2)},
        "reward": np.full(steps, 0.25),
        "tension": np.tile([3.0, 4.0], (steps + 1, 1)),
        "tip_position": np.zeros((steps + 1, 3)),
        "target_position": np.stack([position, np.zeros(steps + 1), np.zeros(steps + 1)], axis=1),
        "seconds": np.full(steps, 0.001),
    }
    return Episode(**{**values, **changes})


@pytest.mark.parametrize(
    ("error", "settled"),
    [
        ((5.0, 5.0, 0.5, 0.4, 0.9), True),
        ((0.5, 5.0, 0.5, 0.4, 0.9), True),  # back outside: only the last time counts
        ((5.0, 0.5, 5.0, 0.4, 0.9), False),  # there for half a second
        ((0.5, 0.5, 0.5), True),
        ((0.5, 0.5), False),  # an episode of half a second
        ((5.0, 0.5, 0.5, 0.5, 1.0), False),  # the bound itself is outside
        ((5.0, 0.5, 0.5, 0.5, math.nan), False),
    ],
)
def test_settled_is_to_stay_below_to_the_end_for_a_second(error, settled):
    assert has_settled(np.array(error), PERIOD, 1.0) == settled


def test_a_jump_in_the_last_step_is_nobodys_error():
    errors = (0.3, 0.005, 0.005, 0.005, 0.3)
    assert score(episode(errors, jumped=True), skip=0.0).settled
    assert not score(episode(errors), skip=0.0).settled


@pytest.mark.parametrize(
    ("frequency", "share"), [(2.0, 0.0), (8.0, 0.0), (12.0, 1.0), (20.0, 1.0), (25.0, 1.0)]
)
def test_chatter_is_the_part_above_ten_hertz_of_the_changes_of_tension(frequency, share):
    """Of a sine whose changes from step to step have a known amplitude; at the Nyquist frequency
    all of them are of one size."""
    period = 0.02
    amplitude = 3.0
    time = period * np.arange(301)
    tension = np.stack(
        [amplitude * np.cos(2 * np.pi * frequency * time), np.zeros(time.size)], axis=1
    )
    change = math.sqrt(np.mean(np.diff(tension[:, 0]) ** 2) / 2)  # over both tendons
    assert chatter(tension, period) == pytest.approx(share * change, rel=0.02, abs=1e-4 * change)
    assert chatter(tension + 5.0 * time[:, None], period) == pytest.approx(
        chatter(tension, period), rel=1e-3, abs=1e-3
    )


def test_there_is_no_chatter_where_a_period_is_too_long_for_it():
    """Changes every 50 ms are of 10 Hz at most, of however few; a little faster they are above."""
    tension = np.tile([[0.0], [1.0]], (20, 1))
    for few in (tension, tension[:4]):
        assert chatter(few, 0.05) == 0.0
    assert chatter(tension, 0.04) == pytest.approx(1.0, rel=0.01)
    assert math.isnan(chatter(tension[:8], 0.04))


@pytest.mark.parametrize(
    ("judge", "said"),
    [
        (
            lambda: score(episode(), skip=2.5),
            "skip should be at most the episode's 2 s, not 2.5 s",
        ),  # of one that lived
        (lambda: score(episode(), skip=-1.0), "skip should be a number of seconds"),
        (lambda: summarise([]), "at least one episode"),
    ],
)
def test_what_cannot_be_judged_is_an_error(judge, said):
    with pytest.raises(ValueError, match=said):
        judge()


def test_a_summary_is_over_all_samples_of_episodes_alike():
    rng = np.random.default_rng(0)
    positions = rng.uniform(0.0, 1.0, (3, 9))
    summary = summarise([score(episode(position), skip=0.0) for position in positions])
    expected_rms = math.sqrt(np.mean(positions**2))
    assert summary.errors["position_error"].rms == pytest.approx(expected_rms)
    assert summary.errors["position_error"].percentile_95 == pytest.approx(
        np.percentile(positions, 95, axis=1).mean()
    )
    assert summary.metrics["effort"] == pytest.approx(math.sqrt(12.5))
    assert (summary.episodes, summary.diverged, summary.settled, summary.reached) == (3, 0, 0, None)


def test_a_divergence_is_counted_and_stays_out_of_the_errors():
    lived, died = (
        episode((0.2, 0.2, 0.2)),
        episode((0.2, 9.0), cause="too fast", reward=np.zeros(1), reached=False),
    )
    summary = summarise([score(e, skip=0.0) for e in (lived, died)])
    assert (summary.episodes, summary.diverged) == (2, 1)
    assert summary.errors["position_error"].rms == pytest.approx(0.2)
    assert summary.mean_return == pytest.approx(0.25), "of both: no reward follows a divergence"
    none_lived = summarise([score(died, skip=0.0)])
    assert math.isnan(none_lived.errors["position_error"].rms)
    assert math.isnan(none_lived.metrics["effort"])


def test_tuning_costs_are_of_errors_and_chatter_within_the_worst():
    still = np.ones((151, 2))
    fast = np.ones((151, 2))
    fast[::2] += 0.5

    def judged(error, tension, **more):
        return score(episode(np.full(151, error), tension=tension, period=0.02, **more))

    assert tracking_cost([judged(2e-3, still)]) == pytest.approx(2e-3)
    assert tracking_cost([judged(2e-3, still), judged(0.5, still)]) == pytest.approx(
        (2e-3 + summaries.WORST) / 2
    )
    assert tracking_cost([judged(2e-3, still, cause="diverged")]) == summaries.WORST
    assert tracking_cost([score(episode(np.full(5, 2e-3), period=0.02), 0.0)]) == 2e-3, (
        "too short for chatter"
    )
    shaken = judged(2e-3, fast)
    found = shaken.metrics["chatter"]
    assert found == pytest.approx(0.5, rel=1e-3)
    assert tracking_cost([shaken]) == 2e-3 + summaries.CHATTER_COST * found


def standing(values, shared=False):
    """values: (members, episodes) of an error, the only one; None where an episode diverged.
    shared: members play other episodes each."""

    def score(seed, value):
        error = value
        cause = None
        if value is None:
            error = math.nan
            cause = "too fast"
        metrics = {"effort": 5.0, "chatter": 0.1}
        return EpisodeScore(
            seed,
            10,
            {"own": ErrorScore(error, error)},
            False,
            metrics,
            0.0,
            None,
            cause,
            0.001,
            1e3,
        )

    return Standing(
        [
            [score(shared * place * len(row) + k, value) for k, value in enumerate(row)]
            for place, row in enumerate(values)
        ]
    )


def test_an_episode_that_diverged_is_worse_than_any_number():
    """The mean is that of the middle half of all episodes of all members."""
    assert standing([[1.0, 2.0], [3.0, 100.0]]).mean(KEY).value == 2.5
    assert standing([[1.0, 1.0], [1.0, None]]).mean(KEY).value == 1.0
    half = standing([[1.0, 1.0, None, None]])
    assert summaries.tails(half.values(KEY)) == (math.inf, math.inf)
    assert half.mean(KEY).value == math.inf


def test_comparisons_are_made_episode_by_episode():
    """One is better by a little on every episode, of which some are far harder than others: their
    own intervals overlap."""
    hard = np.geomspace(1.0, 10.0, 20)
    better = standing([(0.9 * hard).tolist()])
    worse = standing([hard.tolist()])
    gap = difference(better, worse, KEY)
    better_mean = better.mean(KEY)
    worse_mean = worse.mean(KEY)
    assert better_mean.high > worse_mean.low
    expected_value = better_mean.value - worse_mean.value
    assert gap.value == pytest.approx(expected_value)
    assert gap.low < gap.value < gap.high < 0.0


def test_policies_that_differ_by_chance_alone_are_not_separated():
    near, far, lost = (
        standing([[1.0, 1.1, 0.9, 1.0]] * 5),
        standing([[5.0, 5.1, 4.9, 5.0]]),
        standing([[None] * 4]),
    )
    assert difference(near, far, KEY).high < 0.0
    assert difference(far, far, KEY) == (0.0, 0.0, 0.0)
    by_chance = difference(standing([[1.0, 5.0, 3.0]]), standing([[5.0, 1.0, 3.0]]), KEY)
    assert by_chance.low < 0.0 < by_chance.high
    assert difference(near, lost, KEY).high == -math.inf
    assert difference(lost, far, KEY).low == math.inf
    assert math.isnan(difference(lost, lost, KEY).value)


@pytest.mark.parametrize("other", [[[1.0, 2.0]], [[1.0, 1.0, 1.0, 1.0]] * 2])
def test_who_has_not_played_the_same_episodes_alone_is_not_compared(other):
    with pytest.raises(ValueError, match="single member, which has played the same episodes"):
        difference(standing([[1.0, 1.1, 0.9, 1.0]]), standing(other), KEY)


@pytest.mark.parametrize("count", range(1, 14))
def test_the_middle_half_is_averaged_and_counts_are_cut_as_scipy_cuts_them(count):
    assert interquartile_mean([5.0, 100.0, 3.0, -100.0, 4.0]) == 4.0, (
        "a quarter of 5 is 1.25, so one at either end"
    )
    rng = np.random.default_rng(count)
    values = rng.normal(size=(3, count, 2))
    np.testing.assert_allclose(
        interquartile_mean(values, axis=1), trim_mean(values, 0.25, axis=1), atol=1e-15
    )


@pytest.mark.parametrize(
    ("values", "tails"),
    [
        ([[3.0] * 6, [3.0] * 3 + [70.0] * 3], (19.75, 70.0)),  # whose interquartile mean is 3
        (np.arange(11.0), (5.0, 9.0)),
        ([1.0] * 10 + [math.inf], (math.inf, 1.0)),
        ([1.0] * 8 + [math.inf] * 2, (math.inf, math.inf)),
        ([1.0] * 10 + [math.nan], (math.nan, 1.0)),
        ([1.0] * 8 + [math.nan, math.inf], (math.nan, math.nan)),
    ],
)
def test_tails_are_what_the_middle_half_hides(values, tails):
    assert summaries.tails(values) == pytest.approx(tails, nan_ok=True)


def test_a_run_without_a_number_is_the_worst():
    assert interquartile_mean([1.0, math.nan, 2.0, 4.0]) == 3.0, "1 is cut, and what has no number"
    assert math.isnan(interquartile_mean([1.0, math.nan])), "nothing is cut of two"
    low, high = bootstrap_interval([1.0, math.nan])
    assert low == 1.0
    assert math.isnan(high)


def test_an_own_metric_has_its_unit_in_tables_and_is_missing_where_it_is_nan(forgotten, tmp_path):
    """How far the target was from the tip at most, of episodes that know it; chatter is infinite
    where one diverged."""

    def far(episode, first):
        return (
            float(np.abs(episode.target_position - episode.tip_position).max())
            if episode.seed
            else math.nan
        )

    register("metric", "farthest", Metric("farthest [mm]", far, 1e3))
    known = [score(episode(seed=7, period=0.02), skip=0.0)]
    none = [score(episode(seed=0, period=0.02), skip=0.0)]
    assert [summary_cells(summarise(one))["farthest [mm]"] for one in (known, none)] == ["300", "-"]
    assert math.isnan(Standing([known * 3 + none]).mean("farthest").high)
    assert Standing([known * 3 + none]).mean("farthest").value == 0.3
    died = [score(episode(cause="too fast"), skip=0.0)]
    found = {
        (name, "nominal"): Standing([one]) for name, one in (("a", known), ("b", none), ("c", died))
    }
    write_csv(tmp_path / "found.csv", records(found))
    rows = [*csv.DictReader((tmp_path / "found.csv").open())]
    assert [row["farthest"] for row in rows] == ["0.3", "", "0.3"]
    assert [row["chatter_mean"] for row in rows] == ["", "", "inf"]


def test_seeds_and_episodes_are_drawn_apart(monkeypatch):
    # Two seeds, 0 and 100, with episodes of +0 and +1. A resample has one of 0 and 100 twice in
    # 1/2, both in 1/2; its episodes likewise.
    values = [[0.0, 1.0], [100.0, 101.0]]
    assert bootstrap_interval(values, axes=2) == (0.0, 101.0)
    monkeypatch.setattr(summaries, "CONFIDENCE", 0.4)
    assert bootstrap_interval(values, axes=2) == (50.0, 51.0), "of both seeds, of either episode"
