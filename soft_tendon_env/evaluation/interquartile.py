"""Numbers over several seeds of training: the interquartile mean, and how far it is known.

Both are those of Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021 (their package
rliable). NaN, a run without a number, counts as larger than every number, as fits errors.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.scene.scene import Array

CUT = 0.25  # of the values, at either end
RESAMPLES = 5000


class Interval(NamedTuple):
    """Between what a number lies; numbers, or arrays of the number's shape."""

    low: float | Array
    high: float | Array


def interquartile_mean(values: ArrayLike, axis: int = 0) -> float | Array:
    """Mean of the middle half along an axis, NaN where no value remains that is one.

    A quarter of the count is cut at either end, rounded down as `scipy.stats.trim_mean` does it: 1 to 3 values are all taken, 4 to 7
    lose the smallest and the largest, 8 to 11 two at either end.
    """
    ordered = np.sort(np.moveaxis(np.asarray(values, dtype=float), axis, 0), axis=0)
    if not len(ordered):
        raise ValueError("values should have at least one run")
    cut = int(CUT * len(ordered))
    mean = ordered[cut : len(ordered) - cut].mean(axis=0)
    return mean if mean.ndim else float(mean)


def bootstrap_interval(strata: Sequence[ArrayLike], confidence: float = 0.95, seed: int = 0, resamples: int = RESAMPLES) -> Interval:
    """Interval of the interquartile mean over the runs of all strata: percentiles of what resampled runs give.

    A stratum holds the runs (n_i, ...) of one configuration or task: they are drawn again, with replacement, among themselves, so that
    every resample has n_i of them. A run is drawn as a whole, with all that stands in its other axes. Raises ValueError for an empty one.
    """
    rng = np.random.default_rng(seed)
    drawn = [_draw(np.asarray(runs, dtype=float), resamples, rng) for runs in strata]
    means = np.sort(np.asarray(interquartile_mean(np.concatenate(drawn, axis=1), axis=1)), axis=0)
    tail = (1.0 - confidence) / 2.0
    low, high = (means[math.ceil(share * resamples) - 1] for share in (tail, 1.0 - tail))  # percentiles that are among them: NaN sorts last
    return Interval(low, high) if means.ndim > 1 else Interval(float(low), float(high))


def _draw(runs: Array, resamples: int, rng: np.random.Generator) -> Array:
    """Resamples (resamples, n, ...) of the runs (n, ...) of a stratum."""
    if not len(runs):
        raise ValueError("every stratum should have at least one run")
    return runs[rng.integers(len(runs), size=(resamples, len(runs)))]
