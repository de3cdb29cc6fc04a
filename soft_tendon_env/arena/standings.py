"""Standings of the benchmark: interquartile means with bootstrap intervals over seeds of training and episodes, and comparisons of pairs.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 2021. A controller has one member, an
agent one per seed of its training; all play the same episodes. Resamples draw members and episodes anew, with replacement, so that both
what training leaves to chance and the choice of episodes is in the intervals; episodes are paired between the policies of a comparison.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.arena.protocol import Cell
from soft_tendon_env.evaluation.statistics import bootstrap_interval, interquartile_mean
from soft_tendon_env.scene.scene import Array

Condition = tuple[str, str, str]  # regime, setting, difficulty


class Mean(NamedTuple):
    """Interquartile mean of a number, and the ends of its interval."""

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """An entrant against another under a condition: the probability that it is better on the same episode, the ends of its interval, and
    whether the intervals of both means are apart."""

    probability: float
    low: float
    high: float
    separated: bool


class Standing:
    """All results of an entrant under one condition: records by member."""

    def __init__(self, records: Sequence[Sequence[Mapping[str, Any]]]) -> None:
        self.records = records

    def values(self, key: str) -> Array:
        """A number of every episode (members, episodes); infinite where an episode diverged or did not get there."""
        found = [[record[key] for record in of_member] for of_member in self.records]
        return np.array([[np.inf if value is None else float(value) for value in row] for row in found])

    def mean(self, key: str) -> Mean:
        """Interquartile mean over all episodes of all members."""
        values = self.values(key)
        return Mean(float(interquartile_mean(values.ravel())), *map(float, bootstrap_interval(values, axes=2)))

    @property
    def bad(self) -> float:
        """Share of bad episodes."""
        return float(np.mean(self.values("bad")))

    @property
    def settled(self) -> float:
        """Share of episodes that settled."""
        return float(np.mean(np.isfinite(self.values("settling_time"))))

    @property
    def violations(self) -> int:
        """Steps that asked for more than is allowed, of all episodes."""
        return int(self.values("violations").sum())


def standings(cells: Iterable[Cell], results: Iterable[Mapping[str, Any]]) -> dict[Condition, dict[str, Standing]]:
    """By condition, then by entrant."""
    found: dict[Condition, dict[str, list[Any]]] = {}
    for cell, result in zip(cells, results, strict=True):
        if cell.kind == "episodes":
            found.setdefault(cell.condition, {}).setdefault(cell.entrant, []).append(result["episodes"])
    return {condition: {name: Standing(records) for name, records in of.items()} for condition, of in found.items()}


def compared(one: Standing, other: Standing, key: str) -> Comparison:
    """Whether `one` has less of a number than `other`. Raises ValueError unless both played the same episodes."""
    if [record["seed"] for record in one.records[0]] != [record["seed"] for record in other.records[0]]:
        raise ValueError("both should have played the same episodes")
    mine, theirs = one.values(key), other.values(key)
    better = (mine[:, None] < theirs[None]) + 0.5 * (mine[:, None] == theirs[None])  # (members, members of the other, episodes)
    low, high = bootstrap_interval(better, axes=3, statistic=np.mean)
    ours, others = one.mean(key), other.mean(key)
    return Comparison(float(better.mean()), float(low), float(high), ours.high < others.low or others.high < ours.low)
