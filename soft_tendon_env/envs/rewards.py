"""Reward terms, each between 0 and 1, so that no episode gains by ending early, and their weighted mean, the reward; goals of tasks.

An error e counts 1 / (1 + (e / scale)^2): 1 at none, 1/2 at `scale`, and flat from several times that on. With several scales it counts
as their mean: a small one, so that little errors matter, and larger ones, so that there is a slope from as far off as episodes begin.
A task's errors make terms, see tasks/; those of every task are in TERMS, and a user's own are functions of the tracking, see
`register_reward_term`.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from soft_tendon_env.envs.kernels import EFFORT, SMOOTHNESS, TermTable, closeness, reward_terms
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, shown
from soft_tendon_env.tools.types import Array

GoalReward = Literal["sparse", "dense"]
HALF = 5.0
"""Thresholds at which the dense reward is 1/2: near enough that the last of them still counts."""
Scales = Annotated[tuple[Annotated[float, Field(gt=0, ge=1e-9)], ...], Field(min_length=1)]


class Weight(Configuration):
    """Weight of a term, and the error that halves it (in the error's unit; not for effort and smoothness).

    Attributes:
        scale: of several, the term is the mean of what it is at each.
    """

    weight: float = Field(default=1.0, ge=0, le=1e9)
    scale: Annotated[Scales | None, BeforeValidator(lambda own: own if isinstance(own, tuple | None) else (own,))] = None


def weights_of(table: Mapping[str, Any]) -> dict[str, Weight]:
    """Weights by term of numbers, and of tables with `weight` and `scale`. Raises ConfigurationError."""
    weights, problems = dict[str, Weight](), list[Problem]()
    for name, value in table.items():
        try:
            weights[name] = value if isinstance(value, Weight) else Weight(**value if isinstance(value, dict) else {"weight": value})
        except ConfigurationError as error:
            problems += [Problem((name, *key), text) for key, text in error.problems]
    if problems:
        raise ConfigurationError(problems)
    return weights


class Term(NamedTuple):
    """A reward term."""

    of: str | int | Callable[[Any], Array]  # name of its error; EFFORT or SMOOTHNESS; or a function of the Tracking, a user's own
    scale: float = 0.0  # by default; 0: none
    of_length: bool = False  # whether the scale is a share of the rod's length


TERMS: Mapping[str, Term] = {"effort": Term(EFFORT), "smoothness": Term(SMOOTHNESS)}
"""The terms that every task has besides those of its errors: mean square tension, as a part of the limits, and change of the action."""

OWN_TERMS: dict[str, Term] = {}
"""The terms of `register_reward_term`, by name, which every task has too."""


class Reward:
    """Chosen reward terms and their weights."""

    def __init__(self, weights: Mapping[str, Weight], available: Mapping[str, Term], strongest: Array, length: float) -> None:
        """`available`: the task's terms; strongest: (n_a,) the largest commands that are allowed; length: [m] of the rod.

        Raises ConfigurationError for other terms, scales of terms that have none, and unless one has a weight above 0.
        """
        total = sum(weight.weight for weight in weights.values())
        unknown = [name for name in weights if name not in available]
        problems = [Problem(("reward", name), f"is no term of this environment: {not_among(name, available)}") for name in unknown]
        own: dict[str, Any] = {name: available[name].of for name in weights if name in available and callable(available[name].of)}
        scaled = [name for name in own if weights[name].scale]
        problems += [Problem(("reward", name, "scale"), "is of a term that has no scale: leave it out") for name in scaled]
        problems += [] if total > 0.0 else [Problem(("reward",), "should give at least one term a weight above 0")]
        if problems:
            raise ConfigurationError(problems, "environment")
        self._shares, self._own = {name: weight.weight / total for name, weight in weights.items()}, own
        compiled = self._compiled = {name: available[name] for name in weights if name not in own}
        self._errors = [term.of for term in compiled.values() if isinstance(term.of, str)]
        codes = [self._errors.index(term.of) if isinstance(term.of, str) else term.of for term in compiled.values()]
        usual = {name: term.scale * (length if term.of_length else 1.0) for name, term in compiled.items()}
        scales = [np.atleast_1d(weights[name].scale or usual[name]) for name in compiled]
        shares = np.array([self._shares[name] for name in compiled], dtype=np.float64)
        first, scale = np.cumsum([0, *map(len, scales)]), np.concatenate([np.empty(0), *scales])
        of, most = np.array(codes, dtype=np.int64), np.full(strongest.size, 2.0)
        self._table = TermTable(of=of, first=first, scale=scale, weight=shares, strongest=strongest, most_change=most)

    def of(self, errors: Mapping[str, Array], tracking: Any) -> tuple[dict[str, Array], Array]:
        """Terms (rows,), unweighted, by name, and the reward (rows,), in [0, 1], of errors (rows,) by name and a Tracking; new arrays.

        Raises ValueError where a user's own term has values of another shape, or beyond 0 and 1.
        """
        rows = len(tracking.command)
        found, values, reward = np.empty((rows, len(self._errors))), np.empty((len(self._compiled), rows)), np.empty(rows)
        for i, name in enumerate(self._errors):
            found[:, i] = errors[name]
        reward_terms(self._table, found, tracking.command, tracking.action_change, values, reward)
        terms = dict(zip(self._compiled, values, strict=True))
        if not self._own:
            return terms, reward
        for name, function in self._own.items():
            terms[name] = value = _checked(name, function(tracking), rows)
            reward += self._shares[name] * value
        return {name: terms[name] for name in self._shares}, reward


def _checked(name: str, value: Any, rows: int) -> Array:
    """Values (rows,) of a user's own term, copied. Raises ValueError."""
    values = np.array(value, dtype=np.float64)
    if values.shape != (rows,) or not ((values >= 0.0) & (values <= 1.0)).all():
        raise ValueError(f"the reward term {name!r} should have values of shape ({rows},) between 0 and 1, not {shown(value)}")
    return values


def goal_distance(achieved: ArrayLike, desired: ArrayLike) -> Array:
    """Distances (...) [m] of goals (..., 3), component by component so that one goal and many give the same bits. Raises ValueError."""
    shapes = np.shape(achieved), np.shape(desired)
    if shapes[0] != shapes[1] or shapes[0][-1:] != (3,):
        raise ValueError(f"achieved_goal and desired_goal should have the same shape (..., 3), not {shapes[0]} and {shapes[1]}")
    way = np.asarray(achieved, dtype=np.float64) - np.asarray(desired, dtype=np.float64)
    x, y, z = way[..., 0], way[..., 1], way[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def goal_reward(distance: Array, dense: bool, threshold: float) -> Array:
    """Rewards (...) at distances (...) [m]: "sparse" 1 within the threshold [m], else 0; "dense" the closeness, 1/2 at 5 thresholds."""
    return np.asarray(closeness(distance, HALF * threshold) if dense else distance <= threshold, dtype=np.float64)
