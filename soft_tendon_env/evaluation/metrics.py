"""Metrics of episodes, each defined once: errors, steady-state errors, settling, effort, chatter, violations, time per action.

`score` judges an `Episode`; summaries.py puts scores together. To add a metric, add an entry to METRICS: tables and files follow.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.types import Array

FAST = 10.0  # [Hz] above which changes of tension are chatter: no arm of this kind moves as fast
SETTLED = 0.01  # share of the rod's length below which the task's first error stays once an episode has settled
STAY = 1.0  # [s] for which it has to stay there, up to the end of the episode
BAD = 0.02  # share of the rod's length above which the first error makes an episode a bad one
STILL = 1e-9  # greatest change of a target's pose [m, or of its rotation's entries] in a control period of a target that holds still


@dataclass(frozen=True, eq=False)
class Episode:
    """Course of an episode; sample 0 is what its reset left, sample k what its k-th step did.

    period [s]; length [m] of the rod; errors (1 + steps,) each, the first of them what is to settle; reward (steps,); tension
    (1 + steps, n_a) [N] as applied; violation (steps,), whether more was asked for than is allowed; seconds (steps,) that the policy
    took; moved (1 + steps,), whether the target is another than in the sample before (None: not known); reached: whether a goal was in
    the end (None: no goal); cause of its divergence (None: it lived).
    """

    seed: int
    period: float
    length: float
    errors: Mapping[str, Array]
    reward: Array
    tension: Array
    violation: NDArray[np.bool_]
    seconds: Array
    moved: NDArray[np.bool_] | None = None
    reached: bool | None = None
    cause: str | None = None

    @property
    def jumps(self) -> NDArray[np.int64]:
        """Samples at which a stepwise target jumps; none where the target holds still throughout, or moves on."""
        moved = np.zeros(1, dtype=bool) if self.moved is None else self.moved
        return np.flatnonzero(moved) if not (moved[1:] & moved[:-1]).any() else np.empty(0, dtype=np.int64)


class Metric(NamedTuple):
    """Number of an episode: its heading in tables, with the unit, and its function of the episode and the first sample that counts. Of
    several episodes it is the root mean square. `usual`: whether tables have it without `--all`."""

    heading: str
    of_episode: Callable[[Episode, int], float]
    usual: bool = True


class ErrorScore(NamedTuple):
    """Root mean square, 95th percentile and, of a stepwise target, steady-state error, in the error's unit; NaN where there is none."""

    rms: float
    percentile_95: float
    steady_state: float = math.nan


class ActionTime(NamedTuple):
    """Time of the policy for an action [s]."""

    median: float
    percentile_99: float


class WithMetrics:
    """Base of scores: a metric is an attribute too, `score.effort`; in a record errors have names, and metrics stand among the rest."""

    def __getattr__(self, name: str) -> float:
        found: Mapping[str, float] = self.__dict__.get("metrics", {})
        if name not in found:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return found[name]

    def record(self) -> dict[str, Any]:
        """Plain values by name, for JSON."""
        found = asdict(self)  # type: ignore[call-overload] # of a dataclass
        metrics, errors = found.pop("metrics"), {name: error._asdict() for name, error in found["errors"].items()}
        return {**found, "errors": errors, **metrics, "action_time": found["action_time"]._asdict()}


@dataclass(frozen=True)
class EpisodeScore(WithMetrics):
    """An episode in numbers.

    Attributes:
        errors: scores of the samples from `skip` on, by name; NaN where an episode diverged before.
        settling_time: [s] from which the first error stays below SETTLED times the rod's length to the end, for STAY at least; None if it
            does not.
        metrics: values of METRICS by name: `effort`, `tension_rate`, `chatter`, and your own.
        bound_violations: steps at which actions beyond [-1, 1] or tensions beyond their limits were asked for; neither is applied.
        total_reward: return of the episode.
        reached: whether Reach's goal was within the threshold at the end; None for the other tasks.
        diverged: cause of the divergence, None for an episode that lived to its end.
        action_time: of the calls of `predict` but the first, which may load or compile.
        length: [m] of the rod.
    """

    seed: int
    steps: int
    errors: Mapping[str, ErrorScore]
    settling_time: float | None
    metrics: Mapping[str, float]
    bound_violations: int
    total_reward: float
    reached: bool | None
    diverged: str | None
    action_time: ActionTime
    length: float

    @classmethod
    def restored(cls, saved: Mapping[str, Any]) -> Self:
        """Score from its `dataclasses.asdict`, read from JSON, where tuples have become lists."""
        errors = {name: ErrorScore(*error) for name, error in saved["errors"].items()}
        return cls(**{**saved, "errors": errors, "action_time": ActionTime(*saved["action_time"])})

    @property
    def bad(self) -> bool:
        """Whether the episode diverged, or its first error is above BAD: the steady-state error where the target is stepwise, else the root
        mean square."""
        first = next(iter(self.errors.values()))
        error = first.rms if math.isnan(first.steady_state) else first.steady_state
        return self.diverged is not None or not error <= BAD * self.length

    @property
    def numbers(self) -> dict[str, float]:
        """All that has an interquartile mean over episodes, by name; infinite where an episode has no such number, and errors and chatter
        where it diverged."""
        lost = {*flat(self.errors), "chatter"} if self.diverged is not None else set[str]()
        found = {**flat(self.errors), **self.metrics, "seconds": self.action_time.median}
        return {name: math.inf if name in lost or not math.isfinite(value) else value for name, value in found.items()}


def flat(errors: Mapping[str, ErrorScore]) -> dict[str, Any]:
    """Numbers of errors by `NAME_rms`, `NAME_percentile_95` and `NAME_steady_state`."""
    return {f"{name}_{kind}": value for name, of in errors.items() for kind, value in of._asdict().items()}


def score(episode: Episode, skip: float = 1.0) -> EpisodeScore:
    """Score of an episode; errors count from `skip` [s] on. Raises TypeError, ValueError, also where the episode ended before that."""
    skip = checked_number("skip", skip, 0.0, "a number of seconds, at least 0")
    first, steps, seconds = math.ceil(skip / episode.period - 1e-9), len(episode.reward), episode.seconds[1:]
    if first > steps and episode.cause is None:
        raise ValueError(f"skip should be at most the episode's {steps * episode.period:g} s, not {skip:g} s")
    to_settle, jumps = next(iter(episode.errors.values())), episode.jumps
    if jumps.size and jumps[-1] == steps:  # nobody has acted on this one
        to_settle = to_settle[:-1]
    return EpisodeScore(
        seed=episode.seed,
        steps=steps,
        errors={name: error_score(values, first, jumps) for name, values in episode.errors.items()},
        settling_time=None if episode.cause is not None else settling_time(to_settle, episode.period, SETTLED * episode.length),
        metrics={name: metric.of_episode(episode, first) for name, metric in METRICS.items()},
        bound_violations=int(episode.violation.sum()),
        total_reward=float(episode.reward.sum()),
        reached=episode.reached,
        diverged=episode.cause,
        action_time=ActionTime(*np.percentile(seconds, (50, 99)).tolist()) if len(seconds) else ActionTime(math.nan, math.nan),
        length=episode.length,
    )


def settling_time(error: Array, period: float, below: float) -> float | None:
    """Time [s] of the first of the samples (m,) from which on all are below a bound; None if they are not for STAY, to the last."""
    outside = np.flatnonzero(~(error < below))
    first = outside[-1] + 1 if outside.size else 0
    return float(first * period) if (len(error) - 1 - first) * period >= STAY - 1e-9 else None


def error_score(error: Array, first: int, jumps: NDArray[np.int64]) -> ErrorScore:
    """Score of samples (m,) from the `first` on, of a target that jumps at these; NaN without any."""
    counted = error[first:]
    high = float(np.percentile(counted, 95)) if counted.size else math.nan
    return ErrorScore(root_mean_square(counted), high, steady_state_error(error, first, jumps))


def steady_state_error(error: Array, first: int, jumps: NDArray[np.int64]) -> float:
    """Steady-state error of samples (m,) from the `first` on: mean over the holds between jumps, each over its second half.

    The last hold counts where it lasts as long as the shortest of the others. NaN without jumps.
    """
    borders = [0, *jumps.tolist(), len(error)]
    least = min(np.diff(borders)[:-1], default=math.inf)
    halves = [error[max(first, (start + end + 1) // 2) : end] for start, end in pairwise(borders) if end - start >= least]
    means = [float(half.mean()) for half in halves if half.size]
    return float(np.mean(means)) if means else math.nan


def chatter(tension: Array, period: float) -> float:
    """Change of tension above FAST [N]: root mean square, over time and tendons, of what lies above that frequency in the changes of
    tensions (m, n_a) [N] from one control period [s] to the next.

    By the Fourier transform under a Hann window. Zero where the period is too long for such frequencies, else NaN for fewer than 8 changes.
    """
    if 2.0 * FAST * period >= 1.0:
        return 0.0
    change = np.diff(tension, axis=0)
    steps = len(change)
    if steps < 8:
        return math.nan
    window = np.hanning(steps + 2)[1:-1, None]
    power = np.abs(np.fft.rfft(window * change, axis=0)) ** 2
    frequency = np.fft.rfftfreq(steps, period)
    twice = np.where(frequency * period < 0.5 - 1e-9, 2.0, 1.0)[:, None]  # the same at negative frequencies, but at Nyquist's
    return float(np.sqrt((twice * power)[frequency > FAST].sum(axis=0).mean() / (steps * np.sum(window**2))))


def root_mean_square(values: Array) -> float:
    """Root mean square of all entries; NaN without any."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


METRICS: dict[str, Metric] = {
    "effort": Metric("effort [N]", lambda episode, first: root_mean_square(episode.tension[1:]), usual=False),
    "tension_rate": Metric(
        "rate [N/s]", lambda episode, first: root_mean_square(np.diff(episode.tension, axis=0)) / episode.period, usual=False
    ),
    "chatter": Metric("chatter [N]", lambda episode, first: chatter(episode.tension[first:], episode.period)),
}
"""Metrics by name: tensions applied over tendons and time, their change from one step to the next, and what of it lies above FAST."""
