"""Intervals of every loss hold the truth, with outliers and without, on a linear model of readings."""

from types import SimpleNamespace

import numpy as np
import pytest

from soft_tendon_env.identification.fit import fit
from soft_tendon_env.identification.intervals import intervals
from soft_tendon_env.identification.parameters import Parameter

NOISE, OUTLIER = 4e-4, 0.03  # [m]
PARAMETERS = [Parameter(f"p{i}", None, 1.0, 0.01, 100.0, None, True) for i in range(2)] + [
    Parameter(f"prior{i}", None, 0.0, -0.05, 0.05, 0.01, False) for i in range(2)
]


class Readings:
    """Readings in proportion to the parameters: three markers of each hold."""

    def __init__(self, holds, outliers, seed):
        random = np.random.default_rng([seed, holds])
        command = random.uniform(0.0, 1.0, (holds, 1, 3))
        moved = np.einsum("hat,apkt->hpk", command, random.normal(size=(1, 9, len(PARAMETERS), 3)))
        self._J, self.cluster = 0.05 * moved.reshape(9 * holds, -1), np.repeat(np.arange(holds), 9)
        self.plants = SimpleNamespace(parameters=PARAMETERS, length=0.3)
        self.truth = random.normal(size=len(PARAMETERS)) * [0.1, 0.1, 1.0, 1.0]
        common = random.normal(size=(holds, 1, 1))  # of the markers of a hold
        noise = NOISE * (np.sqrt(0.7) * random.normal(size=(holds, 3, 3)) + np.sqrt(0.3) * common)
        off = (random.random((holds, 3, 1)) < outliers) * OUTLIER * random.normal(size=(holds, 3, 3))
        self._measured = self._J @ self.truth + (noise + off).ravel()

    def residual(self, x):
        return self._J @ x - self._measured

    def jacobian(self, x):
        return self._J


def share_of_hits(loss, holds, outliers, data_sets):
    """Share of data sets in which the intervals hold the truth, of the parameter that they hold least often."""
    hits = []
    for seed in range(data_sets):
        readings = Readings(holds, outliers, seed)
        spread = intervals(fit(readings, loss=loss), readings.cluster, PARAMETERS)
        truth = [own.at(at) for own, at in zip(PARAMETERS, readings.truth, strict=True)]
        hits.append((spread.low <= truth) & (truth <= spread.high))
    return np.mean(hits, axis=0).min()


LOSSES = [(loss, outliers) for loss in ("linear", "soft_l1", "cauchy") for outliers in (0.0, 0.1)]


@pytest.mark.cases("loss, outliers", LOSSES)
def test_intervals_of_every_loss_hold_the_truth(loss, outliers):
    assert share_of_hits(loss, 10, outliers, 20) >= 0.9


@pytest.mark.slow
@pytest.mark.cases("loss, outliers", LOSSES)
def test_intervals_hold_the_truth_in_90_of_100_with_few_holds_and_with_many(loss, outliers):
    assert share_of_hits(loss, 5, outliers, 100) >= 0.9 and share_of_hits(loss, 30, outliers, 100) >= 0.9


@pytest.mark.cases("loss", ["soft_l1", "cauchy"])
def test_the_noise_that_a_robust_loss_finds_is_that_of_readings_which_are_no_outliers(loss):
    clean, spoilt = (np.mean([fit(Readings(20, outliers, seed), loss=loss).sigma for seed in range(10)]) for outliers in (0.0, 0.1))
    assert clean == pytest.approx(NOISE, rel=0.06) and clean < spoilt < 1.25 * NOISE


def test_a_prior_counts_in_full_beside_a_robust_loss():
    readings = Readings(3, 0.0, 0)
    readings._measured = readings._J @ [0.1, -0.1, 4.0, -4.0]  # four standard deviations from the priors
    found = [fit(readings, sigma=0.06, loss=loss).x for loss in ("linear", "cauchy")]
    assert 1.0 < found[0][2] < 3.9 and found[1][2:] == pytest.approx(found[0][2:], rel=0.05)
