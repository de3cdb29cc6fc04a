"""Reward terms: each between 0 and 1, so that no episode gains by ending early. The reward is their weighted mean.

An error e counts 1 / (1 + (e / scale)^2): 1 at none, 1/2 at `scale`, and flat from several times that on. With several scales it counts
as their mean: a small one, so that little errors matter, and larger ones, so that there is a slope from as far off as episodes begin.
A task's errors make terms, see tasks/base.py; those of every task are in TERMS.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag

from soft_tendon_env.mechanics.motion.rewards import EFFORT, SMOOTHNESS, TermTable, reward_terms
from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among

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


class Term(NamedTuple):
    """One term: what it is, its default scale (0: none), and the name of its error, or EFFORT or SMOOTHNESS."""

    description: str
    scale: float
    of: str | int


def error_term(name: str, description: str, scale: float) -> Term:
    """The term that falls with the error of this name: 1/2 at `scale`, in the error's unit."""
    return Term(description, scale, name)


TERMS: Mapping[str, Term] = {
    "effort": Term("mean square of the tensions as parts of their limits", 0.0, EFFORT),
    "smoothness": Term("mean square change of the action", 0.0, SMOOTHNESS),
}
"""The terms that every task has besides those of its errors, by the name that options use."""

CONTACT_TERMS: Mapping[str, Term] = {
    "penetration": error_term("penetration", "how deep the arm is in obstacles [m]", 0.001),
    "contact_force": error_term("contact_force", "sum of the sizes of all contact forces [N]", 1.0),
}
"""Those that every task has besides where the scene has obstacles."""


class Reward:
    """The chosen terms and their weights."""

    def __init__(self, weights: Mapping[str, Weight], available: Mapping[str, Term], strongest: Array, source: str) -> None:
        """`available`: the task's terms; strongest: (n_a,) the largest commands that are allowed.

        Raises ConfigurationError for other terms, and unless one has a weight above 0.
        """
        unknown = [name for name in weights if name not in available]
        if unknown:
            problems = [Problem(("reward", name), f"is no term of this task: {not_among(name, available)}") for name in unknown]
            raise ConfigurationError(problems, source)
        total = sum(weight.weight for weight in weights.values())
        if not total > 0.0:
            raise ConfigurationError([Problem(("reward",), "should give at least one term a weight above 0")], source)
        chosen = [available[name] for name in weights]
        self._names, self._errors = list(weights), [term.of for term in chosen if isinstance(term.of, str)]
        scales = [np.atleast_1d(weight.scale or term.scale) for weight, term in zip(weights.values(), chosen, strict=True)]
        self._table = TermTable(
            of=np.array([self._errors.index(term.of) if isinstance(term.of, str) else term.of for term in chosen]),
            first=np.cumsum([0, *map(len, scales)]),
            scale=np.concatenate(scales).astype(np.float64),
            weight=np.array([weight.weight / total for weight in weights.values()]),
            strongest=strongest,
            most_change=np.full(strongest.size, 2.0),
        )

    def of(self, errors: Mapping[str, Array], command: Array, action_change: Array) -> tuple[dict[str, Array], Array]:
        """The terms (rows,), unweighted, by name, and the reward (rows,), in [0, 1]; new arrays.

        errors: by name, each (rows,); command: (rows, n_a) as applied, tensions [N] or what effects make tensions of; action_change:
        (rows, n_a), in [-2, 2].
        """
        rows = len(command)
        found, terms, reward = np.empty((rows, len(self._errors))), np.empty((len(self._names), rows)), np.empty(rows)
        for i, name in enumerate(self._errors):
            found[:, i] = errors[name]
        reward_terms(self._table, found, command, action_change, terms, reward)
        return dict(zip(self._names, terms, strict=True)), reward
