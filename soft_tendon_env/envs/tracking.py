"""Tracking errors of an arm beside its target, their display units, and the rewards that fall with
them.

Reward terms are between 0 and 1, so that no episode gains by ending early; the reward is their
weighted mean. An error e counts 1 / (1 + (e / scale)^2): 1 at none, 1/2 at `scale`. With several
scales it counts as their mean: a small one, so that little errors matter, and larger ones, so that
there is a slope from as far off as episodes begin. A task's errors make two terms each, of one
scale and of GRADES of it; those of every task are in TERMS, and a user's own are functions of the
tracking, see `register_reward_term`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field

from soft_tendon_env.envs.arms import Arms, Indices
from soft_tendon_env.envs.kernels import EFFORT, SMOOTHNESS, TermTable, closeness, reward_terms
from soft_tendon_env.envs.targets import TargetSamples
from soft_tendon_env.mechanics.motion.batch import Reading
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_among,
    shown,
)
from soft_tendon_env.tools.types import Array

GoalReward = Literal["sparse", "dense"]
GRADES = (
    4.0,
    0.4,
    0.04,
    # scales of graded terms, in that of the error: returns then order policies as errors do, large
    # and small
)
HALF = 5.0  # thresholds that are the scale of the dense reward
Scales = Annotated[tuple[Annotated[float, Field(gt=0, ge=1e-9)], ...], Field(min_length=1)]


class Weight(Configuration):
    """Weight of a term, and the error that halves it, in its unit; of several scales, the term is
    the mean of what it is at each."""

    weight: float = Field(default=1.0, ge=0, le=1e9)
    scale: Annotated[
        Scales | None,
        BeforeValidator(lambda scale: scale if isinstance(scale, tuple | None) else (scale,)),
    ] = None


def weights_of(table: Mapping[str, Any]) -> dict[str, Weight]:
    """Weights by term of numbers and tables. Raises ConfigurationError."""
    weights, problems = dict[str, Weight](), list[Problem]()
    for name, value in table.items():
        try:
            weights[name] = (
                value
                if isinstance(value, Weight)
                else Weight(**value if isinstance(value, dict) else {"weight": value})
            )
        except ConfigurationError as error:
            problems += [Problem((name, *key), text) for key, text in error.problems]
    if problems:
        raise ConfigurationError(problems)
    return weights


class Term(NamedTuple):
    """A reward term."""

    of: (
        str | int | Callable[[Any], Array]
    )  # name of its error; EFFORT or SMOOTHNESS; or a function of the Tracking, a user's own
    scale: tuple[float, ...] = ()  # by default; (): none
    of_length: bool = False  # whether the scales are shares of the rod's length


TERMS: Mapping[str, Term] = {"effort": Term(EFFORT), "smoothness": Term(SMOOTHNESS)}
"""The terms that every task has besides those of its errors: mean square tension, as a part of the
limits, and change of the action."""

OWN_TERMS: dict[str, Term] = {}
"""The terms of `register_reward_term`, by name, which every task has too."""


class Reward:
    """Chosen reward terms and their weights."""

    def __init__(
        self,
        weights: Mapping[str, Weight],
        available: Mapping[str, Term],
        strongest: Array,
        length: float,
    ) -> None:
        """`available`: the task's terms; strongest: (n_a,) the largest commands that are allowed;
        length: [m] of the rod.

        Raises ConfigurationError for other terms, and unless one has a weight above 0.
        """
        total = sum(weight.weight for weight in weights.values())
        unknown = [name for name in weights if name not in available]
        problems = [
            Problem(
                ("reward", name), f"is no term of this environment: {not_among(name, available)}"
            )
            for name in unknown
        ]
        scaled = [name for name, term in available.items() if isinstance(term.of, str)]
        for name, weight in weights.items():
            if weight.scale is not None and name in available and name not in scaled:
                text = (
                    f"is {', '.join(map(shown, weight.scale))}: this term has a weight alone; those"
                    f" with a scale are {', '.join(scaled)}"
                )
                problems.append(Problem(("reward", name, "scale"), text))
        problems += (
            []
            if total > 0.0
            else [Problem(("reward",), "should give at least one term a weight above 0")]
        )
        if problems:
            raise ConfigurationError(problems, "environment")
        functions: dict[str, Any] = {
            name: available[name].of for name in weights if callable(available[name].of)
        }
        self._shares, self._functions = (
            {name: weight.weight / total for name, weight in weights.items()},
            functions,
        )
        compiled = self._compiled = {
            name: available[name] for name in weights if name not in functions
        }
        self._errors = [term.of for term in compiled.values() if isinstance(term.of, str)]
        codes = [
            self._errors.index(term.of) if isinstance(term.of, str) else term.of
            for term in compiled.values()
        ]
        usual = {
            name: np.array(term.scale) * (length if term.of_length else 1.0)
            for name, term in compiled.items()
        }
        scales = [np.array(weights[name].scale or usual[name]) for name in compiled]
        shares = np.array([self._shares[name] for name in compiled], dtype=np.float64)
        first, scale = np.cumsum([0, *map(len, scales)]), np.concatenate([np.empty(0), *scales])
        of, most = np.array(codes, dtype=np.int64), np.full(strongest.size, 2.0)
        self._table = TermTable(
            of=of, first=first, scale=scale, weight=shares, strongest=strongest, most_change=most
        )

    def of(self, errors: Mapping[str, Array], tracking: Any) -> tuple[dict[str, Array], Array]:
        """Terms (rows,), unweighted, by name, and the reward (rows,), in [0, 1], of errors (rows,)
        by name and a Tracking; new arrays.

        Raises ValueError where a user's own term has values of another shape, or beyond 0 and 1.
        """
        rows = len(tracking.command)
        found, values, reward = (
            np.empty((rows, len(self._errors))),
            np.empty((len(self._compiled), rows)),
            np.empty(rows),
        )
        for i, name in enumerate(self._errors):
            found[:, i] = errors[name]
        reward_terms(self._table, found, tracking.command, tracking.action_change, values, reward)
        terms = dict(zip(self._compiled, values, strict=True))
        for name, function in self._functions.items():
            terms[name] = value = np.array(function(tracking), dtype=np.float64)
            if value.shape != (rows,) or not ((value >= 0.0) & (value <= 1.0)).all():
                raise ValueError(
                    f"the reward term {name!r} should have values of shape ({rows},) between 0 and"
                    f" 1, not {shown(value)}"
                )
            reward += self._shares[name] * value
        return terms, reward


def goal_distance(achieved: ArrayLike, desired: ArrayLike) -> Array:
    """Distances (...) [m] of goals (..., 3), component by component so that one goal and many give
    the same bits. Raises ValueError."""
    shapes = np.shape(achieved), np.shape(desired)
    if shapes[0] != shapes[1] or shapes[0][-1:] != (3,):
        raise ValueError(
            f"achieved_goal and desired_goal should have the same shape (..., 3), not {shapes[0]}"
            f" and {shapes[1]}"
        )
    way = np.asarray(achieved, dtype=np.float64) - np.asarray(desired, dtype=np.float64)
    x, y, z = way[..., 0], way[..., 1], way[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def goal_reward(achieved: ArrayLike, desired: ArrayLike, threshold: float, dense: bool) -> Array:
    """Rewards (...) of goals (..., 3) [m]: 1 within the threshold [m], else 0; if dense graded, of
    HALF thresholds. Raises ValueError."""
    distance = goal_distance(achieved, desired)
    if dense:
        return np.asarray(
            sum(closeness(distance, grade * HALF * threshold) for grade in GRADES) / len(GRADES)
        )
    return np.asarray(distance <= threshold, dtype=np.float64)


class Tracking(NamedTuple):
    """The arm and its target now, rows first, without noise: of which tracking errors and reward
    terms are functions.

    A time limit lies around the environment, so how many steps are left is not known here: a term
    that counts towards the end of episodes compares `time` or `step_count` with a number of its
    own.
    """

    arms: Arms
    # of the arms, such as `tip_twist` (rows, 6), `tendon_length` (rows, n_a) [m], and `strain` at
    # the sensors
    reading: Reading
    error: Array  # (rows, 6) SE(3) logarithm from tip to target
    distance: Array  # (rows,) [m] from tip to target
    angle: Array  # (rows,) [rad], likewise
    # (rows, 1 + previews, ..) now and at each preview time, its backbone (rows, 1 + previews,
    # stations, 3) [m]
    target: TargetSamples
    command: (
        Array  # (rows, n_a) as applied, tensions [N] or what the scene's effects make tensions of
    )
    action_change: Array  # (rows, n_a) change of the action, in [-2, 2]
    step_count: Indices  # (rows,) control periods since the episode began, 0 after its reset

    @property
    def time(self) -> Array:
        """Time (rows,) [s] since the episode began."""
        return np.asarray(self.arms.period * self.step_count, dtype=np.float64)

    @property
    def tip_pose(self) -> Array:
        """Poses of the tips (rows, 4, 4)."""
        return self.reading.tip_pose

    @property
    def target_pose(self) -> Array:
        """Target poses (rows, 4, 4)."""
        return self.target.tip_pose[:, 0]

    @property
    def q(self) -> Array:
        """Coordinates (rows, n) that the scene's material would have for the same shape."""
        return self.arms.shape


@dataclass(frozen=True)
class TrackingError:
    """A tracking error: `name` in `info`, the reward `term` that falls with it, and the `scale` of
    the error that halves that term; of graded_<term> it is the unit of the scales.

    value: (rows,) from the arm and its target, in SI units. of_length: whether `scale` is a share
    of the rod's length.
    """

    name: str
    term: str
    description: str
    scale: float
    value: Callable[[Tracking], Array]
    of_length: bool = False

    @property
    def terms(self) -> dict[str, Term]:
        """The reward terms of the error, by name."""
        scales = {
            self.term: (self.scale,),
            f"graded_{self.term}": tuple(grade * self.scale for grade in GRADES),
        }
        return {term: Term(self.name, scale, self.of_length) for term, scale in scales.items()}


def norm(vectors: Array) -> Array:
    """Euclidean norms (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(np.add.reduce(vectors * vectors, -1)))


def _backbone_distance(t: Tracking) -> Array:
    return np.asarray(
        np.sqrt(
            np.mean(norm(t.target.backbone[:, 0] - t.reading.backbone[..., :3, 3]) ** 2, axis=1)
        )
    )


POSITION = TrackingError(
    "position_error",
    "position",
    "tip position error [m]",
    0.05,
    lambda t: t.distance,
    of_length=True,
)
ANGLE = TrackingError(
    "angle_error",
    "angle",
    "angle between the tip's and the target's frame [rad]",
    0.5,
    lambda t: t.angle,
)
_ROOT_MEAN_SQUARE = "root mean square distance between backbone and target [m]"
BACKBONE = TrackingError(
    "backbone_error", "backbone", _ROOT_MEAN_SQUARE, 0.05, _backbone_distance, of_length=True
)
COORDINATES = TrackingError(
    "coordinate_error",
    "coordinates",
    "norm of the coordinates' error, newton for tensions",
    10.0,
    lambda t: norm(t.target.q[:, 0] - t.q),
)


def register_reward_term(function: Callable[[Tracking], Array]) -> Callable[[Tracking], Array]:
    """Function decorator: make a reward term available to every task and to the option `reward`, by
    the function's name.

    It takes a Tracking and returns values (rows,) between 0 and 1, 1 the best, so that no episode
    gains by ending early. A second function of the same name replaces the first. Raises ValueError
    for a name that a term of the package has.
    """
    if (name := function.__name__) in {
        *TERMS,
        *(term for error in (POSITION, ANGLE, BACKBONE, COORDINATES) for term in error.terms),
    }:
        raise ValueError(f"the reward term {name!r} is taken: choose another name")
    OWN_TERMS[name] = Term(function)
    return function


class ErrorUnit(NamedTuple):
    """Label and unit symbol of an error in plots and tables, and the factor from SI units to that
    unit."""

    label: str
    symbol: str = ""  # empty where the error's unit depends on the scene
    factor: float = 1.0

    @property
    def heading(self) -> str:
        """Label without the word "error", and its unit."""
        label = self.label.removesuffix(" error")
        return f"{label} [{self.symbol}]" if self.symbol else label

    def text(self, value: float) -> str:
        """Text of a value given in SI units, in the display unit."""
        return f"{self.factor * value:.3g} {self.symbol}".rstrip()


SYMBOLS = {
    "position_error": ("mm", 1e3),
    "backbone_error": ("mm", 1e3),
    "angle_error": ("deg", 57.29577951308232),
}


def error_unit(name: str) -> ErrorUnit:
    """Display unit of an error by its name; one that is not known keeps SI units."""
    return ErrorUnit(name.replace("_", " "), *SYMBOLS.get(name, ()))
