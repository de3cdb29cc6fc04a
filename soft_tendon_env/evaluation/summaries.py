"""Summaries of episodes: root mean squares, interquartile means, their intervals, comparisons of pairs.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021. Interquartile means hide what a
few bad episodes do: `Tails` stand beside them. NaN, a run without a number, counts as larger than every number, as fits errors. That,
infinite errors of episodes that diverged, and drawing along several axes at once are what `scipy.stats` does not do.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.evaluation.metrics import ActionTime, EpisodeScore, ErrorScore, WithMetrics, root_mean_square
from soft_tendon_env.tools.types import Array

WORST = 0.1
"""Error, as a share of the rod's length, that an episode counts as at most where parameters are tuned; those that diverge count as much."""
CHATTER_COST = 0.01
"""Error, as a share of the rod's length, that 1 N of chatter counts as where parameters are tuned."""
HIGH = 90
"""Percentile that says, beside the mean, what an interquartile mean leaves out."""
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


class Tails(NamedTuple):
    """Mean of all values, and their percentile HIGH, which show the bad ones that an interquartile mean leaves out."""

    mean: float
    high: float

    @classmethod
    def of(cls, values: ArrayLike) -> Self:
        """Tails of values of any shape, which may be infinite; NaN without any."""
        given = np.ravel(np.asarray(values, dtype=float))
        if not given.size:
            return cls(math.nan, math.nan)
        with np.errstate(invalid="ignore"):
            high = np.percentile(given, HIGH)
        return cls(float(given.mean()), float(np.percentile(given, HIGH, method="lower") if np.isnan(high) else high))


def bootstrap_interval(
    values: ArrayLike,
    axes: int = 1,
    statistic: Callable[..., Any] = interquartile_mean,
    confidence: float = CONFIDENCE,
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
    rng = np.random.default_rng(0)
    drawn = [rng.integers(count, size=(resamples, count)) for count in counts]
    index = tuple(np.expand_dims(own, tuple(1 + k for k in range(axes) if k != axis)) for axis, own in enumerate(drawn))
    found = np.sort(np.asarray(statistic(given[index].reshape(resamples, -1, *rest), axis=1)), axis=0)
    tail = (1.0 - confidence) / 2.0
    low, high = (found[math.ceil(share * resamples) - 1] for share in (tail, 1.0 - tail))
    return Interval(low, high) if found.ndim > 1 else Interval(float(low), float(high))


@dataclass(frozen=True)
class Summary(WithMetrics):
    """Scores of several episodes together.

    Where an episode diverged, `diverged` counts it and `flagged` is true: the other numbers are those of the episodes that lived, NaN if
    none did, except for the mean return and violations, which are of all.

    Attributes:
        errors: `rms` over all samples of all episodes (these are alike in number), the others means of the episodes'.
        settled: episodes that settled; settling_time: their median [s], None if none did.
        metrics: root mean square over episodes of every metric, by name.
        bound_violations: steps, of all episodes.
        mean_return: over all episodes; no reward follows a divergence.
        reached: share of all episodes that reached their goal; None for tasks without.
        action_time: medians of the episodes'.
    """

    episodes: int
    diverged: int
    errors: Mapping[str, ErrorScore]
    settled: int
    settling_time: float | None
    metrics: Mapping[str, float]
    bound_violations: int
    mean_return: float
    reached: float | None
    action_time: ActionTime

    @property
    def flagged(self) -> bool:
        """True if any episode diverged."""
        return self.diverged > 0


def summarise(scores: Sequence[EpisodeScore]) -> Summary:
    """Summary of episodes of one policy and task. Raises ValueError without any."""
    if not scores:
        raise ValueError("scores should have at least one episode")
    lived = [score for score in scores if score.diverged is None]
    names = scores[0].errors
    times = [score.settling_time for score in lived if score.settling_time is not None]
    rms = {name: root_mean_square(np.array([score.errors[name].rms for score in lived])) for name in names}
    others = {name: [score.errors[name][1:] for score in lived] or [(math.nan,) * 2] for name in names}
    reached = [score.reached for score in scores if score.reached is not None]
    known = [score.action_time for score in scores if math.isfinite(score.action_time.median)]
    return Summary(
        episodes=len(scores),
        diverged=len(scores) - len(lived),
        errors={name: ErrorScore(rms[name], *np.mean(others[name], axis=0).tolist()) for name in names},
        settled=len(times),
        settling_time=float(np.median(times)) if times else None,
        metrics={name: root_mean_square(np.array([score.metrics[name] for score in lived])) for name in scores[0].metrics},
        bound_violations=sum(score.bound_violations for score in scores),
        mean_return=float(np.mean([score.total_reward for score in scores])),
        reached=float(np.mean(reached)) if reached else None,
        action_time=ActionTime(*np.median(known, axis=0).tolist()) if known else ActionTime(math.nan, math.nan),
    )


def tracking_cost(scores: Sequence[EpisodeScore]) -> float:
    """Cost [m] by which parameters are tuned: mean over episodes of the first error's root mean square and CHATTER_COST times the chatter,
    at most WORST, which is that of an episode that diverged, both times the rod's length."""

    def cost(score: EpisodeScore) -> float:
        error, worst = next(iter(score.errors.values())).rms, WORST * score.length
        shaken = CHATTER_COST * score.length * float(np.nan_to_num(score.metrics["chatter"]))  # of too few samples it is not known
        return worst if score.diverged is not None else min(error + shaken, worst)

    return float(np.mean([cost(score) for score in scores]))


class Mean(NamedTuple):
    """Interquartile mean of a number, and the ends of its interval."""

    value: float
    low: float
    high: float


class Standing(NamedTuple):
    """Scores of a policy's episodes by member: a controller is one, an agent has one per seed of its training."""

    scores: Sequence[Sequence[EpisodeScore]]

    @property
    def episodes(self) -> list[EpisodeScore]:
        """Scores of all members together."""
        return [score for of_member in self.scores for score in of_member]

    def values(self, key: str) -> Array:
        """A number of every episode (members, episodes), see `EpisodeScore.numbers`."""
        return np.array([[score.numbers[key] for score in of_member] for of_member in self.scores])

    def mean(self, key: str) -> Mean:
        """Interquartile mean over all episodes of all members; members and episodes are drawn anew for its interval."""
        values = self.values(key)
        return Mean(float(interquartile_mean(values.ravel())), *map(float, bootstrap_interval(values, axes=2)))

    @property
    def error(self) -> str:
        """Name of the task's first error, by whose root mean square policies are ranked."""
        return next(iter(self.episodes[0].errors))

    @property
    def bad(self) -> float:
        """Share of episodes that are bad."""
        return float(np.mean([score.bad for score in self.episodes]))


class Duel(NamedTuple):
    """A policy beside another on the same episodes: the difference of their interquartile means (SI units, negative where the first has
    less error), and the probability that the first has less error in an episode."""

    difference: Mean
    probability: Mean

    @property
    def verdict(self) -> str:
        """Word for the first: "ahead" or "behind" where the interval of the difference leaves out zero, else "not separated"."""
        return "ahead" if self.difference.high < 0.0 else "behind" if self.difference.low > 0.0 else "not separated"


def compared(one: Standing, other: Standing, key: str) -> Duel:
    """Paired bootstrap of a policy and another of a single member. Raises ValueError unless that one played all episodes of the first."""
    theirs = {score.seed: score.numbers[key] for score in other.episodes}
    if len(other.scores) > 1 or any(score.seed not in theirs for score in one.episodes):
        raise ValueError("the other should be a single member, which has played the same episodes")
    pairs = np.array([[(score.numbers[key], theirs[score.seed]) for score in of_member] for of_member in one.scores], dtype=float)

    def difference(drawn: Array, axis: int = 0) -> Array:
        ours, others = np.moveaxis(np.asarray(interquartile_mean(drawn, axis)), -1, 0)
        with np.errstate(invalid="ignore"):  # NaN where both means are infinite
            return np.asarray(ours - others)

    better = (pairs[..., 0] < pairs[..., 1]) + 0.5 * (pairs[..., 0] == pairs[..., 1])
    apart = Mean(float(difference(pairs.reshape(-1, 2))), *map(float, bootstrap_interval(pairs, axes=2, statistic=difference)))
    return Duel(apart, Mean(float(better.mean()), *map(float, bootstrap_interval(better, axes=2, statistic=np.mean))))


Standings = Mapping[tuple[str, str], Standing]
"""Standings by policy and condition."""
