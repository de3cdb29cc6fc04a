"""Robust tuning: the search finds least costs, costs count errors and fast changes, episodes are apart from those of evaluations."""

import numpy as np
import pytest

from soft_tendon_env.evaluation import EVALUATION_SEEDS, tuning
from soft_tendon_env.evaluation.scores import Episode
from soft_tendon_env.evaluation.tuning import SEEDS, TUNABLE, WORST, Tunable, cost, cost_of, high_frequency_change, search

PERIOD = 0.02


def episode(error, tension, cause=None):
    steps = len(tension) - 1
    nothing = np.zeros(steps)
    errors = {"position_error": np.full(len(tension), error)}
    return Episode(0, PERIOD, 1.0, errors, nothing, tension, nothing.astype(bool), nothing, cause=cause)


@pytest.mark.parametrize("frequency, share", [(5.0, 0.0), (15.0, 1.0), (25.0, 1.0)])
def test_changes_count_above_10_hz_alone(frequency, share):
    """Of a sine the changes are a sine: of twice its amplitude times sin(pi f T)."""
    phase = 0.5 * np.pi if frequency == 25.0 else 0.0  # at the Nyquist frequency
    tension = np.sin(2.0 * np.pi * frequency * PERIOD * np.arange(101) + phase)[:, None] * np.ones(3)
    size = 2.0 * np.sin(np.pi * frequency * PERIOD) / (1.0 if frequency == 25.0 else np.sqrt(2.0))
    assert high_frequency_change(tension, PERIOD) == pytest.approx(share * size, abs=1e-12)


def test_costs_are_of_errors_and_fast_changes_within_the_worst():
    still, fast = np.ones((151, 2)), np.ones((151, 2))
    fast[::2] += 0.5
    assert cost_of([episode(2e-3, still)]) == pytest.approx(2e-3)
    assert cost_of([episode(2e-3, still), episode(0.5, still)]) == pytest.approx((2e-3 + WORST) / 2)
    assert cost_of([episode(2e-3, still, cause="diverged")]) == WORST
    assert cost_of([episode(2e-3, fast)]) == pytest.approx(2e-3 + tuning.CHATTER * 0.5)


def test_the_search_finds_the_least_cost_within_the_ranges():
    tunable = Tunable({"a": (0.1, 10.0), "b": (1.0, 100.0)}, {"a": 10.0, "b": 1.0}, lambda values, env: None)
    seen = []

    def objective(values):
        seen.append(values)
        return np.log(values["a"] / 0.5) ** 2 + np.log(values["b"] / 30.0) ** 2

    best, least = search(tunable, objective, 60, np.random.default_rng(0))
    assert len(seen) == 60 and seen[0] == tunable.start
    assert least == objective(best) == min(objective(values) for values in seen[:60])
    assert best["a"] == pytest.approx(0.5, rel=0.3) and best["b"] == pytest.approx(30.0, rel=0.3)
    assert all(low <= values[name] <= high for values in seen for name, (low, high) in tunable.ranges.items())


def test_seeds_are_of_no_evaluation():
    assert not set(SEEDS) & set(EVALUATION_SEEDS) and max(SEEDS) < 1_000_000


@pytest.mark.parametrize("what", TUNABLE)
def test_everything_can_be_tuned(what, monkeypatch):
    monkeypatch.setattr(tuning, "SECONDS", 0.2)
    monkeypatch.setattr(tuning, "SKIPPED", 0.0)
    monkeypatch.setattr(tuning, "REGIMES", ("tip",))
    monkeypatch.setattr(tuning, "WORST", 10.0)  # it is far at the beginning
    tunable = TUNABLE[what]
    first = cost(tunable, tunable.start, SEEDS[:1])
    other = cost(tunable, {name: bounds[1] for name, bounds in tunable.ranges.items()}, SEEDS[:1])
    assert 0.0 < first < 10.0 and first != other
