"""Robust tuning: the search finds least costs, costs count errors and fast changes, episodes are apart from those of evaluations."""

from functools import partial

import numpy as np
import pytest

from soft_tendon_env.evaluation import metrics, tuning
from soft_tendon_env.evaluation.seeds import SEEDS
from soft_tendon_env.evaluation.tuning import TUNABLE, Tunable, cost, search


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


@pytest.mark.parametrize("what", TUNABLE)
def test_everything_can_be_tuned(what, monkeypatch):
    monkeypatch.setattr(tuning, "validation_error", partial(tuning.validation_error, seconds=0.2, skip=0.0))
    monkeypatch.setattr(tuning, "REGIMES", ("tip",))
    monkeypatch.setattr(metrics, "WORST", 10.0)  # it is far at the beginning
    tunable = TUNABLE[what]
    first = cost(tunable, tunable.start, SEEDS["tuning"][:1])
    other = cost(tunable, {name: bounds[1] for name, bounds in tunable.ranges.items()}, SEEDS["tuning"][:1])
    assert 0.0 < first < 10.0 and first != other
