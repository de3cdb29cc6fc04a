"""Reward terms: each between 0 and 1, so that no episode gains by ending early. The reward is their weighted mean.

An error e counts 1 / (1 + (e / scale)^2): 1 at none, 1/2 at `scale`, and flat from several times that on. With several scales it counts
as their mean: a small one, so that little errors matter, and larger ones, so that there is a slope from as far off as episodes begin.
A task's errors make terms, see tasks/base.py; those of every task are in TERMS.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag

from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among

ONE = np.ones(())
"""As an array: NumPy takes as long to make one of a number as to compute with it."""


class Performance(NamedTuple):
    """Errors, commands and changes of the action of a step, from which terms are computed."""

    errors: Mapping[str, Array]  # by name, each (rows,)
    command: Array  # (rows, n_a) as applied: tensions [N], or what effects make tensions of
    strongest: Array  # (n_a,) the largest of them that is allowed
    action_change: Array  # (rows, n_a), in [-2, 2]


Scale = Annotated[float, Field(gt=0, ge=1e-9)]


class Weight(Configuration):
    """Weight of a term, and the error that halves it (in the error's unit; not for effort and smoothness).

    Attributes:
        scale: of several, the term is the mean of what it is at each.
    """

    weight: float = Field(default=1.0, ge=0, le=1e9)
    scale: Annotated[
        Annotated[Scale, Tag("one")] | Annotated[tuple[Scale, ...], Field(min_length=1), Tag("several")],
        Discriminator(lambda value: "several" if isinstance(value, list | tuple) else "one"),
    ] | None = None


Scales = float | tuple[float, ...]


class Term(NamedTuple):
    """One term: what it is, its default scale (0: none), and its value (rows,)."""

    description: str
    scale: float
    value: Callable[[Performance, Scales], Array]


def closeness(error: Array, scale: Scales) -> Array:
    """1 / (1 + (error / scale)^2); of several scales the mean of these."""
    if isinstance(scale, tuple):
        return np.asarray(sum(closeness(error, one) for one in scale) / len(scale))
    part = error / scale
    return np.asarray(ONE / (ONE + part * part))


def error_term(name: str, description: str, scale: float) -> Term:
    """The term that falls with the error of this name: 1/2 at `scale`, in the error's unit."""
    return Term(description, scale, lambda performance, halves_at: closeness(performance.errors[name], halves_at))


def _smallness(squares: Array, most: float = 1.0) -> Array:
    """1 less the mean of squares (rows, m) as parts of the largest."""
    return np.asarray(ONE - np.add.reduce(squares, 1) / (most * squares.shape[1]))


def _economy(performance: Performance) -> Array:
    parts = performance.command / performance.strongest
    return _smallness(np.minimum(parts * parts, ONE))  # an actuator's error can exceed the limits


def _steadiness(performance: Performance) -> Array:
    return _smallness(performance.action_change * performance.action_change, 4.0)


TERMS: Mapping[str, Term] = {
    "effort": Term("mean square of the tensions as parts of their limits", 0.0, lambda performance, scale: _economy(performance)),
    "smoothness": Term("mean square change of the action", 0.0, lambda performance, scale: _steadiness(performance)),
}
"""The terms that every task has besides those of its errors, by the name that options use."""

CONTACT_TERMS: Mapping[str, Term] = {
    "penetration": error_term("penetration", "how deep the arm is in obstacles [m]", 0.001),
    "contact_force": error_term("contact_force", "sum of the sizes of all contact forces [N]", 1.0),
}
"""Those that every task has besides where the scene has obstacles."""


class Reward:
    """The chosen terms and their weights."""

    def __init__(self, weights: Mapping[str, Weight], available: Mapping[str, Term], source: str) -> None:
        """`available`: the task's terms. Raises ConfigurationError for others, and unless one has a weight above 0."""
        unknown = [name for name in weights if name not in available]
        if unknown:
            problems = [Problem(("reward", name), f"is no term of this task: {not_among(name, available)}") for name in unknown]
            raise ConfigurationError(problems, source)
        total = sum(weight.weight for weight in weights.values())
        if not total > 0.0:
            raise ConfigurationError([Problem(("reward",), "should give at least one term a weight above 0")], source)
        self._terms = [
            (name, np.asarray(weight.weight / total), weight.scale or available[name].scale, available[name].value)
            for name, weight in weights.items()
        ]

    def of(self, performance: Performance) -> tuple[dict[str, Array], Array]:
        """The terms (rows,), unweighted, by name, and the reward (rows,), in [0, 1]; new arrays."""
        terms: dict[str, Array] = {}
        total: Any = 0.0
        for name, weight, scale, value in self._terms:
            terms[name] = term = value(performance, scale)
            total = weight * term + total
        return terms, total
