"""Scores against episodes whose numbers are known by hand."""

import math

import numpy as np
import pytest

from soft_tendon_env.evaluation import tables
from soft_tendon_env.evaluation.metrics import METRICS, Episode, Metric, chatter, score, settling_time
from soft_tendon_env.evaluation.summaries import CHATTER_COST, WORST, Standing, summarise, tracking_cost

PERIOD = 0.5  # [s]


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
        "violation": np.zeros(steps, dtype=bool),
        "seconds": np.full(steps, 0.001),
    }
    return Episode(**{**values, **changes})


@pytest.mark.parametrize(
    "error, settled",
    [
        ((5.0, 5.0, 0.5, 0.4, 0.9), 1.0),
        ((0.5, 5.0, 0.5, 0.4, 0.9), 1.0),  # back outside: only the last time counts
        ((5.0, 0.5, 5.0, 0.4, 0.9), None),  # there for half a second
        ((5.0, 5.0, 5.0, 5.0, 0.9), None),  # there in the last sample
        ((0.5, 0.5, 0.5), 0.0),
        ((0.5, 0.5), None),  # an episode of half a second
        ((0.5, 0.5, 0.5, 0.5, 0.5), 0.0),
        ((5.0, 0.5, 0.5, 0.5, 1.0), None),  # the bound itself is outside
        ((5.0, 0.5, 0.5, 0.5, math.nan), None),
    ],
)
def test_settled_is_to_stay_below_to_the_end_for_a_second(error, settled):
    assert settling_time(np.array(error), PERIOD, 1.0) == settled


@pytest.mark.cases(
    "jumps, skip, steady",
    [
        ((), 0.0, math.nan),
        ((1, 2, 3, 4, 5, 6, 7), 0.0, math.nan),  # it moves on
        ((4,), 0.0, (3.5 + 7.5) / 2),  # halves: samples 2, 3 and 6, 7 with errors 3, 4 and 7, 8
        ((4,), 1.5, (4.0 + 7.5) / 2),  # sample 2 is left out
        ((4,), 2.5, 7.5),
        ((4, 6), 0.0, (3.5 + 6.0 + 8.0) / 3),  # of two samples the second
        ((3, 6), 0.0, (3.0 + 6.0) / 2),  # the last hold is cut off
        ((4, 7), 0.0, (3.5 + 7.0) / 2),
    ],
)
def test_the_steady_state_is_the_second_half_of_every_hold_between_jumps(jumps, skip, steady):
    moved = np.zeros(8, dtype=bool)
    moved[[*jumps]] = True
    found = score(episode(np.arange(1.0, 9.0), moved=moved), skip).errors["position_error"]
    assert found.steady_state == pytest.approx(steady, nan_ok=True)


@pytest.mark.cases(
    "changes, bad",
    [
        ({"position": (0.1, 0.1, 0.015, 0.015)}, False),
        ({"position": (0.1, 0.1, 0.025, 0.025)}, True),
        ({"position": (0.1, 0.1, 0.015, 0.015), "length": 0.3}, True),
        ({"position": (0.1, 0.1, 0.015, 0.015), "cause": "too fast"}, True),
        ({"position": (0.1, 0.001, 0.1, 0.001), "moved": np.array([False, False, True, False])}, False),  # but for its jumps
    ],
)
def test_bad_is_an_error_above_two_hundredths_of_the_rod(changes, bad):
    judged = score(episode(**changes), skip=0.0 if "moved" in changes else 1.0)
    assert judged.bad == bad


@pytest.mark.parametrize("frequency, share", [(2.0, 0.0), (8.0, 0.0), (12.0, 1.0), (20.0, 1.0), (25.0, 1.0)])
def test_chatter_is_the_part_above_ten_hertz_of_the_changes_of_tension(frequency, share):
    """Of a sine whose changes from step to step have a known amplitude; at the Nyquist frequency all of them are of one size."""
    period, amplitude = 0.02, 3.0
    time = period * np.arange(301)
    tension = np.stack([amplitude * np.cos(2 * np.pi * frequency * time), np.zeros(time.size)], axis=1)
    change = math.sqrt(np.mean(np.diff(tension[:, 0]) ** 2) / 2)  # over both tendons
    assert chatter(tension, period) == pytest.approx(share * change, rel=0.02, abs=1e-4 * change)
    assert chatter(tension + 5.0 * time[:, None], period) == pytest.approx(chatter(tension, period), rel=1e-3, abs=1e-3)


@pytest.mark.cases(
    "judge, said",
    [
        (lambda: score(episode(), skip=2.5), "skip should be at most the episode's 2 s, not 2.5 s"),  # of one that lived
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
    assert summary.errors["position_error"].rms == pytest.approx(math.sqrt(np.mean(positions**2)))
    assert summary.errors["position_error"].percentile_95 == pytest.approx(np.percentile(positions, 95, axis=1).mean())
    assert summary.effort == pytest.approx(math.sqrt(12.5))
    assert (summary.episodes, summary.diverged, summary.flagged, summary.reached) == (3, 0, False, None)


def test_a_divergence_flags_the_summary_and_stays_out_of_the_errors():
    lived, died = episode((0.2, 0.2, 0.2)), episode((0.2, 9.0), cause="too fast", reward=np.zeros(1), reached=False)
    summary = summarise([score(e, skip=0.0) for e in (lived, died)])
    assert (summary.episodes, summary.diverged, summary.flagged) == (2, 1, True)
    assert summary.errors["position_error"].rms == pytest.approx(0.2)
    assert summary.mean_return == pytest.approx(0.25), "of both: no reward follows a divergence"
    none_lived = summarise([score(died, skip=0.0)])
    assert math.isnan(none_lived.errors["position_error"].rms) and math.isnan(none_lived.effort)
    assert none_lived.flagged


def test_tuning_costs_are_of_errors_and_chatter_within_the_worst():
    still, fast = np.ones((151, 2)), np.ones((151, 2))
    fast[::2] += 0.5
    judged = lambda error, tension, **more: score(episode(np.full(151, error), tension=tension, period=0.02, **more))  # noqa: E731
    assert tracking_cost([judged(2e-3, still)]) == pytest.approx(2e-3)
    assert tracking_cost([judged(2e-3, still), judged(0.5, still)]) == pytest.approx((2e-3 + WORST) / 2)
    assert tracking_cost([judged(2e-3, still, cause="diverged")]) == WORST
    assert tracking_cost([score(episode(np.full(5, 2e-3), period=0.02), 0.0)]) == 2e-3, "too short for chatter"
    shaken = judged(2e-3, fast)
    assert shaken.chatter == pytest.approx(0.5, rel=1e-3) and tracking_cost([shaken]) == 2e-3 + CHATTER_COST * shaken.chatter


def test_a_metric_of_your_own_is_an_entry(monkeypatch):
    """It is in scores, summaries, tables and files."""
    own = Metric("largest tension [N]", lambda episode, first: float(episode.tension.max()))
    monkeypatch.setitem(METRICS, "largest_tension", own)
    judged = score(episode())
    summary = summarise([judged])
    assert judged.largest_tension == summary.largest_tension == 4.0 and judged.record()["largest_tension"] == 4.0
    assert "| largest tension [N] |" in tables.summary_table("policy", {"a": summary})
    assert tables.records({("a", "nominal"): Standing([[judged]])})[0]["largest_tension"] == 4.0
    with pytest.raises(AttributeError, match="EpisodeScore has no largest_tensoin"):
        judged.largest_tensoin  # noqa: B018
