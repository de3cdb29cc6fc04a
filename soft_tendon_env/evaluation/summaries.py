"""Summaries of episodes: root mean squares, interquartile means, intervals, differences.

Differences are of pairs.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice",
NeurIPS 2021. `tails` say what the middle half hides. NaN, a run without a number, counts as larger
than every number, as fits errors.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.evaluation.metrics import EpisodeScore, ErrorScore, root_mean_square
from soft_tendon_env.tools.types import Array

WORST = 0.1
"""Error, as a share of the rod's length, that an episode counts as at most where parameters are
tuned; those that diverge count as much."""
CHATTER_COST = 0.01
"""Error, as a share of the rod's length, that 1 N of chatter counts as where parameters are
tuned."""
HIGH = 90  # percentile that shows the bad ones
CUT = 0.25  # of the values, at either end
RESAMPLES = 5000
CONFIDENCE = 0.95


def interquartile_mean(values: ArrayLike, axis: int = 0) -> float | Array:
    """Mean of the middle half along an axis, NaN where no value remains that is one.

    A quarter of the count is cut at either end, rounded down. Raises ValueError without any.
    """
    array = np.asarray(values, dtype=float)
    by_sample = np.moveaxis(array, axis, 0)
    ordered = np.sort(by_sample, axis=0)
    if not len(ordered):
        raise ValueError("values should have at least one run")
    cut = int(CUT * len(ordered))
    last = len(ordered) - cut
    middle = ordered[cut:last]
    mean = middle.mean(axis=0)
    if mean.ndim:
        return mean
    return float(mean)


def tails(values: ArrayLike) -> tuple[float, float]:
    """Mean of all values, of any shape, and their percentile HIGH.

    Values may be infinite, and there is at least one.
    """
    array = np.asarray(values, dtype=float)
    flat = np.ravel(array)
    ordered = np.sort(flat)  # NaN last
    places = np.arange(ordered.size)
    scaled = HIGH * (ordered.size - 1)
    place = scaled / 100
    percentile = np.interp(place, places, ordered)
    return float(ordered.mean()), float(percentile)


def bootstrap_interval(
    values: ArrayLike,
    axes: int = 1,
    statistic: Callable[..., Any] = interquartile_mean,
) -> tuple[Any, Any]:
    """Interval of a statistic at CONFIDENCE by the percentile bootstrap.

    values (n_1, ..., n_axes, ...): along each of the first `axes` (seeds of training, episodes)
    entries are drawn again as a whole, with replacement; statistic(drawn, axis=1) is of all that
    was drawn (RESAMPLES, n_1 * ... * n_axes, ...). The bounds are among the values that the
    resamples have. Raises ValueError where there is nothing to draw.
    """
    runs = np.asarray(values, dtype=float)
    counts = runs.shape[:axes]
    rest = runs.shape[axes:]
    if not all(counts):
        raise ValueError("values should have at least one run")
    rng = np.random.default_rng(0)
    index = []
    for axis, count in enumerate(counts):
        chosen = rng.integers(count, size=(RESAMPLES, count))
        # each axis has a dimension of its own, after that of the resamples
        others = tuple(1 + other for other in range(axes) if other != axis)
        index.append(np.expand_dims(chosen, others))
    resampled = runs[tuple(index)]
    drawn = resampled.reshape(RESAMPLES, -1, *rest)
    statistics = np.asarray(statistic(drawn, axis=1))
    ordered = np.sort(statistics, axis=0)
    tail = (1.0 - CONFIDENCE) / 2.0
    place = math.ceil(tail * RESAMPLES) - 1
    low = ordered[place]
    count_above = math.ceil((1.0 - tail) * RESAMPLES)
    place_above = count_above - 1
    high = ordered[place_above]
    if ordered.ndim > 1:
        return (low, high)
    return (float(low), float(high))


@dataclass(frozen=True)
class Summary:
    """Summary of the scores of several episodes.

    Where some diverged, the numbers are those of the others, NaN if none lived; but for the mean
    return, the goals reached and the time, which are of all.

    Attributes:
        errors: `rms` over all samples of all episodes (these are alike in number), the others means
            of the episodes'.
        settled: number of episodes that settled.
        metrics: root mean square over episodes of every metric, by name.
        mean_return: over all episodes; no reward follows a divergence.
        reached: share of all episodes that reached their goal; None for tasks without.
        action_time: median of the episodes' [s].
    """

    episodes: int
    diverged: int
    errors: Mapping[str, ErrorScore]
    settled: int
    metrics: Mapping[str, float]
    mean_return: float
    reached: float | None
    action_time: float


def summarise(scores: Sequence[EpisodeScore]) -> Summary:
    """Summarises the scores of episodes of one policy and task.

    Args:
        scores: of the episodes, at least one.

    Returns:
        Errors, metrics, returns and times of all of them together.

    Raises:
        ValueError: without scores.
    """
    if not scores:
        raise ValueError("scores should have at least one episode")
    # errors and metrics are of the episodes that lived
    lived = [score for score in scores if score.diverged is None]
    errors = dict[str, ErrorScore]()
    metrics = dict[str, float]()
    for name in scores[0].errors:
        errors_of_lived = [score.errors[name] for score in lived]
        of_lived = errors_of_lived or [ErrorScore(math.nan, math.nan)]
        values = [error.rms for error in of_lived]
        rms = root_mean_square(np.array(values))
        percentiles = [error.percentile_95 for error in of_lived]
        percentile = float(np.mean(percentiles))
        errors[name] = ErrorScore(rms, percentile)
    for name in scores[0].metrics:
        values = [score.metrics[name] for score in lived]
        array = np.array(values)
        metrics[name] = root_mean_square(array)
    reached = [score.reached for score in scores if score.reached is not None]
    known = [score.action_time for score in scores if math.isfinite(score.action_time)]
    return Summary(
        episodes=len(scores),
        diverged=len(scores) - len(lived),
        errors=errors,
        settled=sum(score.settled for score in scores),
        metrics=metrics,
        mean_return=float(np.mean([score.total_reward for score in scores])),
        reached=float(np.mean(reached)) if reached else None,
        action_time=float(np.median(known)) if known else math.nan,
    )


def tracking_cost(scores: Sequence[EpisodeScore]) -> float:
    """Cost [m] by which parameters are tuned.

    It is the mean over episodes of the first error's root mean square and CHATTER_COST times the
    chatter, at most WORST, which is that of an episode that diverged, both times the rod's length.
    """

    def cost(score: EpisodeScore) -> float:
        worst = WORST * score.length
        if score.diverged is not None:
            return worst
        errors = iter(score.errors.values())
        error = next(errors).rms
        lived_chatter = score.metrics["chatter"]
        chatter = float(np.nan_to_num(lived_chatter))  # NaN of too few samples
        chatter_cost = CHATTER_COST * score.length * chatter
        return min(error + chatter_cost, worst)

    costs = [cost(score) for score in scores]
    return float(np.mean(costs))


class Mean(NamedTuple):
    """Interquartile mean of a number, and the ends of its interval."""

    value: float
    low: float
    high: float


class Standing(NamedTuple):
    """Scores of a policy's episodes by member.

    A controller is one, an agent has one per seed of its training.
    """

    scores: Sequence[Sequence[EpisodeScore]]

    @property
    def episodes(self) -> list[EpisodeScore]:
        """Scores of all members together."""
        return [score for of_member in self.scores for score in of_member]

    @property
    def error(self) -> str:
        """Name of the task's first error, by whose root mean square policies are ranked."""
        first = self.scores[0][0]
        return next(iter(first.errors))

    def values(self, key: str) -> Array:
        """A number of every episode (members, episodes), see `EpisodeScore.numbers`."""
        numbers = [[score.numbers[key] for score in of_member] for of_member in self.scores]
        return np.array(numbers)

    def mean(self, key: str) -> Mean:
        """Interquartile mean over all episodes of all members, with its interval.

        Members and episodes are drawn anew for the interval.
        """
        values = self.values(key)
        return Mean(
            float(interquartile_mean(values.ravel())),
            *map(float, bootstrap_interval(values, axes=2)),
        )


def difference(
    first: Standing,
    other: Standing,
    key: str,
) -> Mean:
    """Difference of interquartile means of two policies, and its interval.

    It is the mean of a policy less that of another of a single member, its interval by the paired
    bootstrap: negative where the first has less error. Raises ValueError unless the other has
    played all episodes of the first.
    """
    theirs = {score.seed: score.numbers[key] for score in other.episodes}
    has_more = len(other.scores) > 1
    are_known = all(score.seed in theirs for score in first.episodes)
    if has_more or not are_known:
        raise ValueError("the other should be a single member, which has played the same episodes")
    pairs = np.array(
        [
            [(score.numbers[key], theirs[score.seed]) for score in of_member]
            for of_member in first.scores
        ],
        dtype=float,
    )

    def apart(drawn: Array, axis: int = 0) -> Any:
        with np.errstate(invalid="ignore"):  # NaN where both means are infinite
            differences = np.diff(interquartile_mean(drawn, axis))
            return -differences[..., 0]

    return Mean(
        float(apart(pairs.reshape(-1, 2))),
        *map(float, bootstrap_interval(pairs, axes=2, statistic=apart)),
    )


Standings = Mapping[tuple[str, str], Standing]
"""Standings by policy and condition."""
