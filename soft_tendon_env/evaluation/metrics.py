"""Metrics of episodes, each defined once: errors, settling, effort, chatter, time per action.

`score` judges an `Episode`; summaries.py puts scores together. `register("metric", "name",
Metric(...))` adds a metric: tables and files follow.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.registry import Registry, register
from soft_tendon_env.tools.types import Array

FAST = 10.0  # [Hz] above which changes of tension are chatter: no arm of this kind moves as fast
# share of the rod's length below which the task's first error stays once an episode has settled
SETTLED = 0.01
STAY = 1.0  # [s] for which it has to stay there, up to the end of the episode
BAD = 0.02  # share of the rod's length above which the first error makes an episode a bad one


@dataclass(frozen=True, eq=False)
class Episode:
    """Course of an episode; sample 0 is what its reset left, sample k what its k-th step did.

    period [s]; length [m] of the rod; errors (1 + steps,) each, the first of them what is to
    settle; reward (steps,); tension (1 + steps, n_a) [N] as applied; tip_position and
    target_position (1 + steps, 3) [m], both of the tip; seconds (steps,) that the policy took;
    jumped: whether a stepwise target jumped in the last step; reached: whether a goal was in the
    end (None: no goal); cause of its divergence (None: it lived).
    """

    seed: int
    period: float
    length: float
    errors: Mapping[str, Array]
    reward: Array
    tension: Array
    tip_position: Array
    target_position: Array
    seconds: Array
    jumped: bool = False
    reached: bool | None = None
    cause: str | None = None


class Metric(NamedTuple):
    """Number of an episode, with its heading in tables.

    The heading has the unit; the function is of the episode and the first sample that counts, in SI
    units. factor: from these to the heading's unit. Of several episodes it is the root mean square.
    NaN: the episode has none.
    """

    heading: str  # of its column, with the unit
    of_episode: Callable[[Episode, int], float]  # of an episode and the first sample that counts
    factor: float = 1.0  # from SI units to the heading's


class ErrorScore(NamedTuple):
    """Root mean square and 95th percentile, in the error's unit; NaN where there is none."""

    rms: float
    percentile_95: float

    @classmethod
    def of(cls, error: Array) -> "ErrorScore":
        return cls(
            root_mean_square(error), float(np.percentile(error, 95)) if error.size else math.nan
        )


@dataclass(frozen=True)
class EpisodeScore:
    """Scores of an episode.

    Attributes:
        errors: scores of the samples from `skip` on, by name; NaN where an episode diverged before.
        settled: whether the first error stays below SETTLED times the rod's length to the end, for
            STAY at least.
        metrics: values of METRICS by name: `effort`, `chatter`, and your own.
        total_reward: return of the episode.
        reached: whether Reach's goal was within the threshold at the end; None for the other tasks.
        diverged: cause of the divergence, None for an episode that lived to its end.
        action_time: median time of the calls of `predict` [s], but the first, which may load or
            compile.
        length: [m] of the rod.
    """

    seed: int
    steps: int
    errors: Mapping[str, ErrorScore]
    settled: bool
    metrics: Mapping[str, float]
    total_reward: float
    reached: bool | None
    diverged: str | None
    action_time: float
    length: float

    @property
    def bad(self) -> bool:
        """Whether the episode diverged, or its first error is large.

        It is large as root mean square above BAD times the rod's length.
        """
        return (
            self.diverged is not None
            or not next(iter(self.errors.values())).rms <= BAD * self.length
        )

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers that have an interquartile mean over episodes, by name.

        They are NaN where an episode has no such number, but infinite errors and chatter where it
        diverged.
        """
        numbers = dict[str, float]()
        for name, error in self.errors.items():
            numbers[f"{name}_rms"] = error.rms
            numbers[f"{name}_percentile_95"] = error.percentile_95
        lost = [*numbers, "chatter"]  # by an episode that diverged
        numbers |= self.metrics
        numbers["return"] = self.total_reward
        numbers["seconds"] = self.action_time
        if self.diverged is not None:
            lost_names = numbers.keys() & lost
            numbers |= dict.fromkeys(lost_names, math.inf)
        return numbers


def record(score: Any) -> dict[str, Any]:
    """Plain values of an EpisodeScore or a Summary by name, for JSON."""
    return {
        **vars(score),
        "errors": {name: error._asdict() for name, error in score.errors.items()},
    }


def score_from(saved: Mapping[str, Any]) -> EpisodeScore:
    """Score from its `record`.

    Raises KeyError, TypeError for another.
    """
    saved_errors = saved["errors"].items()
    errors = {name: ErrorScore(**error) for name, error in saved_errors}
    return EpisodeScore(**{**saved, "errors": errors})


def score(episode: Episode, skip: float = 1.0) -> EpisodeScore:
    """Score of an episode; errors count from `skip` [s] on.

    Raises TypeError, ValueError, also where the episode ended before that.
    """
    skip = checked_number("skip", skip, 0.0, "a number of seconds, at least 0")
    periods = skip / episode.period
    first = math.ceil(periods - 1e-9)
    steps = len(episode.reward)
    seconds = episode.seconds[1:]
    # an episode that diverged before has errors of no sample: NaN
    if first > steps and episode.cause is None:
        raise ValueError(
            f"skip should be at most the episode's {steps * episode.period:g} s, not {skip:g} s"
        )
    to_settle = next(iter(episode.errors.values()))
    if episode.jumped:
        to_settle = to_settle[:-1]  # nobody has acted on a jump in the last step
    size = SETTLED * episode.length
    settled = has_settled(to_settle, episode.period, size)
    return EpisodeScore(
        seed=episode.seed,
        steps=steps,
        errors={name: ErrorScore.of(error[first:]) for name, error in episode.errors.items()},
        settled=episode.cause is None and settled,
        metrics={name: metric.of_episode(episode, first) for name, metric in METRICS.items()},
        total_reward=float(episode.reward.sum()),
        reached=episode.reached,
        diverged=episode.cause,
        action_time=float(np.median(seconds)) if len(seconds) else math.nan,
        length=episode.length,
    )


def has_settled(
    error: Array,
    period: float,
    below: float,
) -> bool:
    """Whether all of the last samples (m,) are below a bound, for STAY at least."""
    outside = np.flatnonzero(~(error < below))
    if outside.size:
        first = outside[-1] + 1
    else:
        first = 0
    periods = len(error) - 1 - first
    duration = periods * period
    return bool(duration >= STAY - 1e-9)


def chatter(tension: Array, period: float) -> float:
    """Chatter: root mean square [N], over time and tendons, of fast changes of tensions.

    Fast is what lies above FAST in the changes of tensions (m, n_a) [N] from one control period [s]
    to the next: by the Fourier transform under a Hann window. Zero where the period is too long for
    such frequencies, else NaN for fewer than 8 changes.
    """
    if 2.0 * FAST * period >= 1.0:
        return 0.0
    change = np.diff(tension, axis=0)
    steps = len(change)
    if steps < 8:
        return math.nan
    hann = np.hanning(steps + 2)
    window = hann[1:-1, None]
    spectrum = np.fft.rfft(window * change, axis=0)
    power = np.abs(spectrum) ** 2
    frequency = np.fft.rfftfreq(steps, period)
    # the same at negative frequencies, but at Nyquist's
    is_paired = frequency * period < 0.5 - 1e-9
    factors = np.where(is_paired, 2.0, 1.0)
    twice = factors[:, None]
    fast_power = (twice * power)[frequency > FAST]
    fast = fast_power.sum(axis=0)
    power_of_window = steps * np.sum(window**2)
    per_sample = fast.mean() / power_of_window
    return float(np.sqrt(per_sample))


def root_mean_square(values: Array) -> float:
    """Root mean square of all entries; NaN without any."""
    if values.size:
        mean_square = np.mean(np.square(values))
        return float(np.sqrt(mean_square))
    return math.nan


OTHER_NUMBERS = ("return", "seconds")
"""Names of numbers of a score that are no metrics."""


def _checked_metric(name: str, metric: Any) -> Metric:
    """The metric itself. Raises TypeError, ValueError where it lacks something."""
    if not isinstance(metric, Metric):
        raise TypeError(f"the metric {name!r} should be a Metric, not {shown(metric)}")
    if not callable(metric.of_episode):
        raise TypeError(
            f"the metric {name!r} has of_episode = {shown(metric.of_episode)}: it should be a"
            " function of an episode and the first sample that counts"
        )
    if name in OTHER_NUMBERS:
        raise ValueError(f"the metric's name {name!r} is taken, by a number of every score")
    return metric


METRICS: Registry[Metric] = Registry("metric", _checked_metric)
"""Metrics by name: tensions applied over tendons and time, and what of their changes lies above
FAST."""

register(
    "metric",
    "effort",
    Metric("effort [N]", lambda episode, first: root_mean_square(episode.tension[1:])),
)
register(
    "metric",
    "chatter",
    Metric("chatter [N]", lambda episode, first: chatter(episode.tension[first:], episode.period)),
)
