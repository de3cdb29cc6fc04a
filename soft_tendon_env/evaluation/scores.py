"""What happened in episodes, in numbers: errors, settling, tensions, violations, divergences, time per action.

`score` judges an `Episode`, `summarise` puts scores together. To add a number, add it to `EpisodeScore` and `score`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.checks import checked_number

FAST = 10.0
"""Frequency [Hz] above which changes of tension are chatter: no arm of this kind moves as fast."""
SETTLED = 0.01
"""Share of the rod's length below which the task's first error stays once an episode has settled: 10 mm on the paper's arm."""


@dataclass(frozen=True, eq=False)
class Episode:
    """What happened in an episode; sample 0 is what its reset left, sample k what its k-th step did.

    period [s]; length [m] of the rod; errors (1 + steps,) each, the first of them what is to settle; reward (steps,); tension
    (1 + steps, n_a) [N] as applied; violation (steps,), whether more was asked for than is allowed; seconds (steps,) that the policy
    took, with those of the model in its observation; reached: whether a goal was in the end (None: no goal); cause of its divergence
    (None: it lived).
    """

    seed: int
    period: float
    length: float
    errors: Mapping[str, Array]
    reward: Array
    tension: Array
    violation: NDArray[np.bool_]
    seconds: Array
    reached: bool | None = None
    cause: str | None = None


class ErrorScore(NamedTuple):
    """Root mean square and 95th percentile of an error, in its unit."""

    rms: float
    percentile_95: float


class ActionTime(NamedTuple):
    """Seconds that the policy took for an action."""

    median: float
    percentile_99: float


@dataclass(frozen=True)
class EpisodeScore:
    """An episode in numbers.

    Attributes:
        errors: of the samples from `skip` on, by name; NaN where an episode diverged before.
        settling_time: [s] from which the first error stays below SETTLED times the rod's length to the end; None if it never does.
        effort: [N] root mean square of the tensions applied over tendons and time.
        tension_rate: [N/s] root mean square of their change from one step to the next.
        chatter: [N] what of that change, in N a step, lies above FAST, see `chatter`.
        bound_violations: steps at which actions beyond [-1, 1] or tensions beyond their limits were asked for; neither is applied.
        total_reward: return of the episode.
        reached: whether Reach's goal was within the threshold at the end; None for the other tasks.
        diverged: cause of the divergence, None for an episode that lived to its end.
        action_seconds: of every call of `predict` but the first, which may load or compile, and of what it observes that is computed on
            the model, see Episodes.model_seconds.
    """

    seed: int
    steps: int
    errors: Mapping[str, ErrorScore]
    settling_time: float | None
    effort: float
    tension_rate: float
    chatter: float
    bound_violations: int
    total_reward: float
    reached: bool | None
    diverged: str | None
    action_seconds: tuple[float, ...]

    @property
    def action_time(self) -> ActionTime:
        """Median and 99th percentile over the episode's steps."""
        return action_time(self.action_seconds)


@dataclass(frozen=True)
class Summary:
    """Scores of several episodes together.

    Where an episode diverged, `diverged` counts it and `flagged` is true: what is beside them is that of the episodes that lived, NaN
    if none did, except for the mean return and violations, which are of all.

    Attributes:
        errors: `rms` over all samples of all episodes (these are alike in number), `percentile_95` the mean of the episodes'.
        worst: the largest `rms` of an episode, by error.
        settled: episodes that settled; settling_time: their median [s], None if none did.
        effort, tension_rate, chatter: root mean square over episodes [N], [N/s], [N].
        bound_violations: steps, of all episodes.
        mean_return: over all episodes; no reward follows a divergence.
        reached: share of all episodes that reached their goal; None for tasks without.
    """

    episodes: int
    diverged: int
    errors: Mapping[str, ErrorScore]
    worst: Mapping[str, float]
    settled: int
    settling_time: float | None
    effort: float
    tension_rate: float
    chatter: float
    bound_violations: int
    mean_return: float
    reached: float | None
    action_time: ActionTime

    @property
    def flagged(self) -> bool:
        """Whether any episode diverged."""
        return self.diverged > 0


def score(episode: Episode, skip: float = 1.0) -> EpisodeScore:
    """Judge an episode; errors count from `skip` [s] on. Raises TypeError, ValueError, also where the episode ended before that."""
    skip = checked_number("skip", skip, 0.0, "a number of seconds, at least 0")
    first, steps = math.ceil(skip / episode.period - 1e-9), len(episode.reward)
    if first > steps and episode.cause is None:
        raise ValueError(f"skip should be at most the episode's {steps * episode.period:g} s, not {skip:g} s")
    to_settle = next(iter(episode.errors.values()))
    settled = None if episode.cause is not None else settling_time(to_settle, episode.period, SETTLED * episode.length)
    return EpisodeScore(
        seed=episode.seed,
        steps=steps,
        errors={name: error_score(values[first:]) for name, values in episode.errors.items()},
        settling_time=settled,
        effort=root_mean_square(episode.tension[1:]),
        tension_rate=root_mean_square(np.diff(episode.tension, axis=0)) / episode.period,
        chatter=chatter(episode.tension[first:], episode.period),
        bound_violations=int(episode.violation.sum()),
        total_reward=float(episode.reward.sum()),
        reached=episode.reached,
        diverged=episode.cause,
        action_seconds=tuple(episode.seconds[1:].tolist()),
    )


def settling_time(error: Array, period: float, below: float) -> float | None:
    """Time [s] of the first of the samples (m,) from which on all are below a bound; None if the last is not."""
    outside = np.flatnonzero(~(error < below))
    first = outside[-1] + 1 if outside.size else 0
    return None if first == len(error) else float(first * period)


def error_score(error: Array) -> ErrorScore:
    """Of samples (m,); NaN without any."""
    return ErrorScore(root_mean_square(error), float(np.percentile(error, 95)) if len(error) else math.nan)


def action_time(seconds: Sequence[float]) -> ActionTime:
    """Of calls that took so long; NaN without any."""
    if not seconds:
        return ActionTime(math.nan, math.nan)
    return ActionTime(float(np.median(seconds)), float(np.percentile(seconds, 99)))


def chatter(tension: Array, period: float) -> float:
    """Change of tension above FAST [N]: root mean square, over time and tendons, of what lies above that frequency in the changes of
    tensions (m, n_a) [N] from one control period [s] to the next.

    By the Fourier transform under a Hann window. NaN for fewer than 8 changes, zero where the period is too long for such frequencies.
    """
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
    """Over all entries; NaN without any."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


def summarise(scores: Sequence[EpisodeScore]) -> Summary:
    """Episodes of one policy and task together. Raises ValueError without any."""
    if not scores:
        raise ValueError("scores should have at least one episode")
    lived = [score for score in scores if score.diverged is None]
    names = scores[0].errors
    times = [score.settling_time for score in lived if score.settling_time is not None]
    rms = {name: np.array([score.errors[name].rms for score in lived]) for name in names}
    high = {name: [score.errors[name].percentile_95 for score in lived] for name in names}
    reached = [score.reached for score in scores if score.reached is not None]
    return Summary(
        episodes=len(scores),
        diverged=len(scores) - len(lived),
        errors={name: ErrorScore(root_mean_square(rms[name]), float(np.mean(high[name])) if lived else math.nan) for name in names},
        worst={name: float(rms[name].max()) if lived else math.nan for name in names},
        settled=len(times),
        settling_time=float(np.median(times)) if times else None,
        effort=root_mean_square(np.array([score.effort for score in lived])),
        tension_rate=root_mean_square(np.array([score.tension_rate for score in lived])),
        chatter=root_mean_square(np.array([score.chatter for score in lived])),
        bound_violations=sum(score.bound_violations for score in scores),
        mean_return=float(np.mean([score.total_reward for score in scores])),
        reached=float(np.mean(reached)) if reached else None,
        action_time=action_time([seconds for score in scores for seconds in score.action_seconds]),
    )
