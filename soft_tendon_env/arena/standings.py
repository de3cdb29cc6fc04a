"""Standings of the benchmark: interquartile means with bootstrap intervals over seeds of training and episodes, beside what these means
leave out, and comparisons of pairs.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021. A controller has one member, an
agent one per seed of its training, which play all episodes, or each a share of them. Resamples draw members and episodes anew, with
replacement, so that both what training leaves to chance and the choice of episodes is in the intervals; episodes are paired between the
policies of a comparison.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.arena.protocol import Condition, Label, Protocol
from soft_tendon_env.evaluation.conditions import DIFFICULTIES
from soft_tendon_env.evaluation.entrants import LEARNED, Kind, policy_kind
from soft_tendon_env.evaluation.experiment import Experiment
from soft_tendon_env.evaluation.metrics import BAD, EpisodeScore, flat
from soft_tendon_env.evaluation.summaries import HIGH, Tails, bootstrap_interval, interquartile_mean
from soft_tendon_env.tools.types import Array


class Mean(NamedTuple):
    """Interquartile mean of a number, and the ends of its interval."""

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """An entrant beside another under a condition, on the same episodes: the difference of their interquartile means (SI units, negative
    where the first has less error), and the probability that the first has less error in an episode."""

    difference: Mean
    probability: Mean

    @property
    def verdict(self) -> str:
        """Word for the first entrant: "ahead" or "behind" where the interval of the difference leaves out zero, else "not separated"."""
        return "ahead" if self.difference.high < 0.0 else "behind" if self.difference.low > 0.0 else "not separated"


class Standing(NamedTuple):
    """Results of an entrant under one condition: scores of its members' episodes.

    greatest: share of the rod's length above which an episode counts as bad, see `EpisodeScore.is_bad`.
    """

    scores: Sequence[Sequence[EpisodeScore]]
    greatest: float = BAD

    def values(self, key: str) -> Array:
        """A number of every episode (members, episodes), see `EpisodeScore.numbers`."""
        return np.array([[score.numbers[key] for score in of_member] for of_member in self.scores])

    def mean(self, key: str) -> Mean:
        """Interquartile mean over all episodes of all members."""
        values = self.values(key)
        return Mean(float(interquartile_mean(values.ravel())), *map(float, bootstrap_interval(values, axes=2)))

    def tails(self, key: str) -> Tails:
        """Mean and percentile HIGH over all episodes of all members."""
        return Tails.of(self.values(key))

    @property
    def episodes(self) -> list[EpisodeScore]:
        """Scores of all members together."""
        return [score for of_member in self.scores for score in of_member]

    @property
    def bad(self) -> float:
        """Share of episodes that are bad."""
        return float(np.mean([score.is_bad(self.greatest) for score in self.episodes]))

    @property
    def settled(self) -> float:
        """Share of episodes that settled."""
        return float(np.mean([score.settling_time is not None for score in self.episodes]))

    @property
    def violations(self) -> int:
        """Number of steps that asked for more than is allowed, of all episodes."""
        return sum(score.bound_violations for score in self.episodes)


class Standings(NamedTuple):
    """Results of a protocol, by condition and entrant; `kinds` of the entrants; commits that they come from."""

    protocol: Protocol
    kinds: Mapping[str, Kind]
    of: Mapping[Condition, Mapping[str, Standing]]
    commits: tuple[str, ...]

    @property
    def error(self) -> str:
        """Name of the task's first error."""
        return next(iter(next(iter(next(iter(self.of.values())).values())).episodes[0].errors))

    @property
    def key(self) -> str:
        """Name of the number by which entrants are ranked: the root mean square of the task's first error."""
        return f"{self.error}_rms"

    def regimes(self) -> list[str]:
        """Regimes that anybody played in."""
        return [regime for regime in self.protocol.regimes if any(condition.regime == regime for condition in self.of)]

    def best(self, condition: Condition, learned: bool | None = None) -> str | None:
        """Entrant with the least error under a condition, among those that have learned or that have not; None: nobody plays there."""
        names = [name for name in self.of[condition] if learned is None or (self.kinds[name] in LEARNED) == learned]
        return min(names, key=lambda name: self.of[condition][name].mean(self.key).value, default=None)

    def duels(self) -> Iterator[tuple[Condition, str, str, Comparison]]:
        """Under every condition where both kinds play: the best that has learned, the best that is model-based, and how they compare."""
        for condition, standings in self.of.items():
            learned, other = self.best(condition, True), self.best(condition, False)
            if learned is not None and other is not None:
                yield condition, learned, other, compared(standings[learned], standings[other], self.key)


def kinds_of(protocol: Protocol) -> dict[str, Kind]:
    """Kinds of a protocol's entrants by their names. Raises ValueError, OSError for what is no policy."""
    return {entrant.label: policy_kind(next(iter(entrant.members(protocol.task).values()))) for entrant in protocol.entrants}


def standings_of(protocol: Protocol, experiment: Experiment[Label]) -> Standings:
    """Standings of an experiment that was played. Raises ValueError, OSError."""
    scores: dict[Condition, dict[str, list[list[EpisodeScore]]]] = {}
    commits: dict[str, None] = {}
    for label in experiment.cells:
        commits[str(experiment.result(label)["commit"])] = None
        scores.setdefault(label.condition, {}).setdefault(label.entrant, []).append(experiment.scores(label))

    def standing(condition: Condition, name: str) -> Standing:
        return Standing(scores[condition][name], DIFFICULTIES[condition.difficulty].bad)

    of = {condition: {name: standing(condition, name) for name in names} for condition, names in scores.items()}
    return Standings(protocol, kinds_of(protocol), of, tuple(commits))


def compared(one: Standing, other: Standing, key: str) -> Comparison:
    """Comparison of an entrant with another that is a single member. Raises ValueError unless that one played all episodes of the first."""
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
    return Comparison(apart, Mean(float(better.mean()), *map(float, bootstrap_interval(better, axes=2, statistic=np.mean))))


def csv_records(found: Standings) -> list[dict[str, Any]]:
    """Every number of every entrant under every condition, SI units, with the bounds of its interval; None where it is not finite."""
    records = []
    for condition, standings in found.of.items():
        for name, standing in standings.items():
            counts = {"members": len(standing.scores), "episodes": len(standing.episodes)}
            record: dict[str, Any] = {**condition._asdict(), "entrant": name, "kind": found.kinds[name], **counts}
            for key in [*flat(standing.episodes[0].errors), "chatter", "effort", "seconds"]:
                mean = standing.mean(key)
                tails = zip((f"{key}_mean", f"{key}_p{HIGH}"), standing.tails(key), strict=True)
                record |= {key: mean.value, f"{key}_low": mean.low, f"{key}_high": mean.high, **dict(tails)}
            record |= {"settled": standing.settled, "bad": standing.bad, "violations": standing.violations}
            records.append({key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in record.items()})
    return records
