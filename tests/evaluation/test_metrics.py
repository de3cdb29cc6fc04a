"""Scores against episodes whose numbers are known by hand."""

import math

import numpy as np
import pytest

from soft_tendon_env.evaluation import tables
from soft_tendon_env.evaluation.metrics import METRICS, Episode, Metric, chatter, has_settled, record, score
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
        "seconds": np.full(steps, 0.001),
    }
    return Episode(**{**values, **changes})


@pytest.mark.parametrize(
    "error, settled",
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
    assert score(episode(errors, jumped=True), skip=0.0).settled and not score(episode(errors), skip=0.0).settled


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
    assert summary.metrics["effort"] == pytest.approx(math.sqrt(12.5))
    assert (summary.episodes, summary.diverged, summary.settled, summary.reached) == (3, 0, 0, None)


def test_a_divergence_is_counted_and_stays_out_of_the_errors():
    lived, died = episode((0.2, 0.2, 0.2)), episode((0.2, 9.0), cause="too fast", reward=np.zeros(1), reached=False)
    summary = summarise([score(e, skip=0.0) for e in (lived, died)])
    assert (summary.episodes, summary.diverged) == (2, 1)
    assert summary.errors["position_error"].rms == pytest.approx(0.2)
    assert summary.mean_return == pytest.approx(0.25), "of both: no reward follows a divergence"
    none_lived = summarise([score(died, skip=0.0)])
    assert math.isnan(none_lived.errors["position_error"].rms) and math.isnan(none_lived.metrics["effort"])


def test_tuning_costs_are_of_errors_and_chatter_within_the_worst():
    still, fast = np.ones((151, 2)), np.ones((151, 2))
    fast[::2] += 0.5
    judged = lambda error, tension, **more: score(episode(np.full(151, error), tension=tension, period=0.02, **more))  # noqa: E731
    assert tracking_cost([judged(2e-3, still)]) == pytest.approx(2e-3)
    assert tracking_cost([judged(2e-3, still), judged(0.5, still)]) == pytest.approx((2e-3 + WORST) / 2)
    assert tracking_cost([judged(2e-3, still, cause="diverged")]) == WORST
    assert tracking_cost([score(episode(np.full(5, 2e-3), period=0.02), 0.0)]) == 2e-3, "too short for chatter"
    shaken = judged(2e-3, fast)
    found = shaken.metrics["chatter"]
    assert found == pytest.approx(0.5, rel=1e-3) and tracking_cost([shaken]) == 2e-3 + CHATTER_COST * found


def test_a_metric_of_your_own_is_an_entry(monkeypatch):
    """It is in scores, summaries, tables and files."""
    own = Metric("largest tension [N]", lambda episode, first: float(episode.tension.max()))
    monkeypatch.setitem(METRICS, "largest_tension", own)
    judged = score(episode())
    summary = summarise([judged])
    assert judged.metrics["largest_tension"] == summary.metrics["largest_tension"] == record(judged)["metrics"]["largest_tension"] == 4.0
    assert "| largest tension [N] |" in tables.summary_table("policy", {"a": summary}, {"a": "none"})
    assert tables.records({("a", "nominal"): Standing([[judged]])})[0]["largest_tension"] == 4.0
