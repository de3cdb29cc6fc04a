"""Interquartile means over seeds of training and episodes, and bootstrap intervals of how far they are known.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021. NaN, a run without a number,
counts as larger than every number, as fits errors. That, infinite errors of episodes that diverged, and drawing along several axes at once
are what `scipy.stats.trim_mean` and `scipy.stats.bootstrap` do not do; counts are cut as `trim_mean` cuts them.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.tools.types import Array

CUT = 0.25  # of the values, at either end
RESAMPLES = 5000
CONFIDENCE = 0.95


class Interval(NamedTuple):
    """Lower and upper bound of a confidence interval; numbers, or arrays of the number's shape."""

    low: float | Array
    high: float | Array


def interquartile_mean(values: ArrayLike, axis: int = 0) -> float | Array:
    """Mean of the middle half along an axis, NaN where no value remains that is one.

    A quarter of the count is cut at either end, rounded down: 1 to 3 values are all taken, 4 to 7 lose the smallest and the largest, 8 to
    11 two at either end. Raises ValueError without any.
    """
    ordered = np.sort(np.moveaxis(np.asarray(values, dtype=float), axis, 0), axis=0)
    if not len(ordered):
        raise ValueError("values should have at least one run")
    cut = int(CUT * len(ordered))
    mean = ordered[cut : len(ordered) - cut].mean(axis=0)
    return mean if mean.ndim else float(mean)


def bootstrap_interval(
    values: ArrayLike,
    axes: int = 1,
    statistic: Callable[..., Any] = interquartile_mean,
    confidence: float = CONFIDENCE,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Interval:
    """Confidence interval of a statistic by the percentile bootstrap.

    values (n_1, ..., n_axes, ...): along each of the first `axes` (seeds of training, episodes) entries are drawn again as a whole, with
    replacement; statistic(drawn, axis=1) is of all that was drawn (resamples, n_1 * ... * n_axes, ...). The bounds are among the values
    that the resamples have. Raises ValueError where there is nothing to draw.
    """
    given = np.asarray(values, dtype=float)
    counts, rest = given.shape[:axes], given.shape[axes:]
    if not all(counts):
        raise ValueError("values should have at least one run")
    rng = np.random.default_rng(seed)
    drawn = [rng.integers(count, size=(resamples, count)) for count in counts]
    index = tuple(np.expand_dims(own, tuple(1 + k for k in range(axes) if k != axis)) for axis, own in enumerate(drawn))
    found = np.sort(np.asarray(statistic(given[index].reshape(resamples, -1, *rest), axis=1)), axis=0)
    tail = (1.0 - confidence) / 2.0
    low, high = (found[math.ceil(share * resamples) - 1] for share in (tail, 1.0 - tail))
    return Interval(low, high) if found.ndim > 1 else Interval(float(low), float(high))
