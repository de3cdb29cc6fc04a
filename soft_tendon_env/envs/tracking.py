"""Tracking errors of an arm beside its target, their display units and the rewards of them.

Reward terms are between 0 and 1, so that no episode gains by ending early; the reward is their
weighted mean. An error e counts 1 / (1 + (e / scale)^2): 1 at none, 1/2 at `scale`. With several
scales it counts as their mean: a small one, so that little errors matter, and larger ones, so that
there is a slope from as far off as episodes begin. A task's errors make two terms each, of one
scale and of GRADES of it; those of every task are in TERMS. A user's own are functions of the
tracking under `@register("reward_term", "name")`, see `examples/own_reward.py`.
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
from soft_tendon_env.tools.registry import Registry, register
from soft_tendon_env.tools.types import Array

GoalReward = Literal["sparse", "dense"]

GRADES = (4.0, 0.4, 0.04)
"""Scales of graded terms, in that of the error: returns then order policies as errors do, large
and small."""

HALF = 5.0
"""Thresholds that are the scale of the dense reward."""

Scale = Annotated[float, Field(gt=0, ge=1e-9)]
Scales = Annotated[tuple[Scale, ...], Field(min_length=1)]


def _as_scales(scale: Any) -> Any:
    """A tuple of scales, also where there is one number; None stays."""
    if scale is None or isinstance(scale, tuple):
        return scale
    return (scale,)


class Weight(Configuration):
    """Weight of a term, and the error that halves it, in its unit.

    Of several scales, the term is the mean of what it is at each.
    """

    weight: float = Field(default=1.0, ge=0, le=1e9)
    scale: Annotated[Scales | None, BeforeValidator(_as_scales)] = None


def weights_of(table: Mapping[str, Any]) -> dict[str, Weight]:
    """Weights by term of numbers and tables.

    Args:
        table: by term a `Weight`, a table with its fields, or the weight alone.

    Returns:
        The weights by term, in the order of the table.

    Raises:
        ConfigurationError: of all entries that are no weights.
    """
    weights = dict[str, Weight]()
    problems = list[Problem]()
    for name, value in table.items():
        try:
            weights[name] = _weight_of(value)
        except ConfigurationError as error:
            for key, text in error.problems:
                whole_key = (name, *key)
                problems.append(Problem(whole_key, text))
    if problems:
        raise ConfigurationError(problems)
    return weights


def _weight_of(value: Any) -> Weight:
    """A weight of itself, a table or a number.

    Raises ConfigurationError.
    """
    if isinstance(value, Weight):
        return value
    if isinstance(value, dict):
        return Weight(**value)
    return Weight(weight=value)


class Term(NamedTuple):
    """A reward term."""

    # name of its error; EFFORT or SMOOTHNESS; or a user's own function of the Tracking
    source: str | int | Callable[[Any], Array]
    scale: tuple[float, ...] = ()  # by default; (): none
    of_length: bool = False  # whether the scales are shares of the rod's length

    def scales(self, weight: Weight, length: float) -> Array:
        """Errors that halve the term, those of its weight or the default ones, of a rod [m]."""
        if weight.scale is not None:
            return np.array(weight.scale)
        if self.of_length:
            unit = length
        else:
            unit = 1.0
        return np.array(self.scale) * unit


def _checked_term(name: str, function: Any) -> Term:
    """Term of a function of the Tracking with values (rows,) between 0 and 1, 1 the best.

    No episode gains by ending early then. Raises TypeError, ValueError.
    """
    for error in ERRORS:
        if name in error.terms:
            raise ValueError(f"the reward term {name!r} is taken: choose another name")
    if isinstance(function, Term):
        return function
    if not callable(function):
        raise TypeError(
            f"the reward term {name!r} should be a function of the Tracking, not {shown(function)}"
        )
    return Term(function)


TERMS: Registry[Term] = Registry("reward_term", _checked_term)
"""The terms that every task has besides those of its errors."""


class Reward:
    """Chosen reward terms and their weights.

    Attributes:
        functions: terms of users by name, which are not compiled.
        errors: names of the tracking errors that terms need.
        table: of the compiled terms.
    """

    def __init__(
        self,
        weights: Mapping[str, Weight],
        available: Mapping[str, Term],
        strongest: Array,
        length: float,
    ) -> None:
        """Choose terms by their weights.

        Args:
            weights: of the chosen terms, by name.
            available: the task's terms, by name.
            strongest: (n_a,) the largest commands that are allowed.
            length: [m] of the rod.

        Raises:
            ConfigurationError: for other terms, and unless one has a weight above 0.
        """
        values = (weight.weight for weight in weights.values())
        total = sum(values)
        _check_terms(weights, available, total)
        self._shares = {name: weight.weight / total for name, weight in weights.items()}
        self.functions: dict[str, Callable[[Any], Array]] = {}
        self._compiled: list[str] = []
        self.errors: list[str] = []
        sources: list[int] = []
        scales: list[Array] = [np.empty(0)]
        # a user's own terms are functions, the others are compiled
        for name, weight in weights.items():
            term = available[name]
            if callable(term.source):
                self.functions[name] = term.source
                continue
            self._compiled.append(name)
            sources.append(self._number_of(term.source))
            scales.append(term.scales(weight, length))
        counts = [scale.size for scale in scales]
        shares = [self._shares[name] for name in self._compiled]
        self.table = TermTable(
            source=np.array(sources, dtype=np.int64),
            first=np.cumsum(counts, dtype=np.int64),
            scale=np.concatenate(scales),
            weight=np.array(shares, dtype=np.float64),
            strongest=strongest,
            most_change=np.full(strongest.size, 2.0),
        )

    def _number_of(self, source: str | int) -> int:
        """Number of an error among those that terms need, which it joins; codes are their own."""
        if isinstance(source, int):
            return source
        if source not in self.errors:
            self.errors.append(source)
        return self.errors.index(source)

    def evaluate(
        self, errors: Mapping[str, Array], tracking: Any
    ) -> tuple[dict[str, Array], Array]:
        """Reward terms and reward of every row, new arrays.

        Args:
            errors: (rows,) by name.
            tracking: the Tracking of now.

        Returns:
            Terms (rows,) by name, unweighted, and the reward (rows,), in [0, 1].

        Raises:
            ValueError: where a user's own term has values of another shape, or beyond 0 and 1.
        """
        # terms that are compiled
        rows = len(tracking.command)
        shape = (rows, len(self.errors))
        error_table = np.empty(shape)
        for i, name in enumerate(self.errors):
            error_table[:, i] = errors[name]
        shape = (len(self._compiled), rows)
        values = np.empty(shape)
        reward = np.empty(rows)
        command = tracking.command
        change = tracking.action_change
        reward_terms(
            self.table,
            error_table,
            command,
            change,
            values,
            reward,
        )
        terms = dict(zip(self._compiled, values, strict=True))
        # terms of users, whose values are looked at
        for name, function in self.functions.items():
            value = np.array(function(tracking), dtype=np.float64)
            is_within = (value >= 0.0) & (value <= 1.0)
            if value.shape != (rows,) or not is_within.all():
                raise ValueError(
                    f"the reward term {name!r} should have values of shape ({rows},) between 0 and"
                    f" 1, not {shown(value)}"
                )
            terms[name] = value
            reward += self._shares[name] * value
        return terms, reward


def _check_terms(
    weights: Mapping[str, Weight], available: Mapping[str, Term], total: float
) -> None:
    """Raise an error for weights that do not fit the terms.

    Raises ConfigurationError for weights of other terms, for scales of terms that have none, and
    unless the total of all weights is above 0.
    """
    problems = list[Problem]()
    for name in weights:
        if name not in available:
            text = f"is no term of this environment: {not_among(name, available)}"
            problems.append(Problem(("reward", name), text))
    scaled = [name for name, term in available.items() if isinstance(term.source, str)]
    for name, weight in weights.items():
        if weight.scale is not None and name in available and name not in scaled:
            numbers = ", ".join(map(shown, weight.scale))
            text = (
                f"is {numbers}: this term has a weight alone; those with a scale are"
                f" {', '.join(scaled)}"
            )
            problems.append(Problem(("reward", name, "scale"), text))
    if not total > 0.0:
        text = "should give at least one term a weight above 0"
        problems.append(Problem(("reward",), text))
    if problems:
        raise ConfigurationError(problems, "environment")


def goal_distance(achieved: ArrayLike, desired: ArrayLike) -> Array:
    """Distances (...) [m] of goals (..., 3), the same bits for one goal and for many.

    Args:
        achieved: positions (..., 3) [m].
        desired: likewise, of the same shape.

    Returns:
        Distances (...) [m].

    Raises:
        ValueError: for other shapes.
    """
    shape = np.shape(achieved)
    desired_shape = np.shape(desired)
    is_of_positions = shape[-1:] == (3,)
    if shape != desired_shape or not is_of_positions:
        raise ValueError(
            "achieved_goal and desired_goal should have the same shape (..., 3), not"
            f" {shape} and {desired_shape}"
        )
    reached = np.asarray(achieved, dtype=np.float64)
    goal = np.asarray(desired, dtype=np.float64)
    way = reached - goal
    # component by component: a sum over an axis may round otherwise for one goal than for many
    x = way[..., 0]
    y = way[..., 1]
    z = way[..., 2]
    in_plane = x * x + y * y
    square = in_plane + z * z
    return np.asarray(np.sqrt(square))


def goal_reward(
    achieved: ArrayLike,
    desired: ArrayLike,
    threshold: float,
    dense: bool,
) -> Array:
    """Rewards (...) of goals (..., 3) [m].

    Args:
        achieved: positions (..., 3) [m].
        desired: likewise, of the same shape.
        threshold: distance [m] within which a goal is reached.
        dense: graded rewards, of HALF thresholds, in place of 1 for a reached goal and else 0.

    Returns:
        Rewards (...) between 0 and 1.

    Raises:
        ValueError: for other shapes.
    """
    distance = goal_distance(achieved, desired)
    if not dense:
        return np.asarray(distance <= threshold, dtype=np.float64)
    widths = [grade * HALF * threshold for grade in GRADES]
    grades = [closeness(distance, width) for width in widths]
    mean_grade = sum(grades) / len(GRADES)
    return np.asarray(mean_grade)


class Tracking(NamedTuple):
    """The arm and its target now, without noise, rows first.

    Tracking errors and reward terms are functions of it.

    A time limit lies around the environment, so how many steps are left is not known here: a term
    that counts towards the end of episodes compares `time` or `step_count` with a number of its
    own.
    """

    arms: Arms
    # of the arms: `tip_twist` (rows, 6), `tendon_length` (rows, n_a) [m], `strain` at the sensors
    reading: Reading
    error: Array  # (rows, 6) SE(3) logarithm from tip to target
    distance: Array  # (rows,) [m] from tip to target
    angle: Array  # (rows,) [rad], likewise
    # (rows, 1 + previews, ..) now and at each preview time, its backbone (rows, 1 + previews,
    # stations, 3) [m]
    target: TargetSamples
    # (rows, n_a) as applied, tensions [N] or what the scene's effects make tensions of
    command: Array
    action_change: Array  # (rows, n_a) change of the action, in [-2, 2]
    step_count: Indices  # (rows,) control periods since the episode began, 0 after its reset

    @property
    def time(self) -> Array:
        """Time (rows,) [s] since the episode began."""
        seconds = self.arms.period * self.step_count
        return np.asarray(seconds, dtype=np.float64)

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
    """A tracking error of a task, and the reward terms that fall with it.

    Attributes:
        name: as in `info`.
        term: the reward term that falls with it.
        description: what it is, with its unit.
        scale: of the error, that halves that term; of graded_<term> the unit of the scales.
        value: (rows,) from the arm and its target, in SI units.
        of_length: whether `scale` is a share of the rod's length.
    """

    name: str
    term: str
    description: str
    scale: float
    value: Callable[[Tracking], Array]
    of_length: bool = False

    @property
    def terms(self) -> dict[str, Term]:
        """The reward terms of the error, by name: one of one scale, one of GRADES of it."""
        scales = (grade * self.scale for grade in GRADES)
        graded_scales = tuple(scales)
        return {
            self.term: Term(self.name, (self.scale,), self.of_length),
            f"graded_{self.term}": Term(self.name, graded_scales, self.of_length),
        }


def norm(vectors: Array) -> Array:
    """Euclidean norms (...) of vectors (..., k)."""
    squares = np.add.reduce(vectors * vectors, -1)
    return np.asarray(np.sqrt(squares))


def _distance(tracking: Tracking) -> Array:
    return tracking.distance


POSITION = TrackingError(
    "position_error", "position", "tip position error [m]", 0.05, _distance, of_length=True
)


def _angle(tracking: Tracking) -> Array:
    return tracking.angle


ANGLE_TEXT = "angle between the tip's and the target's frame [rad]"
ANGLE = TrackingError("angle_error", "angle", ANGLE_TEXT, 0.5, _angle)


def _backbone_distance(tracking: Tracking) -> Array:
    """Root mean square distances (rows,) [m] of the stations from those of the target."""
    stations = tracking.reading.backbone[..., :3, 3]
    target = tracking.target.backbone[:, 0]
    differences = target - stations
    distances = norm(differences)
    mean_square = np.mean(distances**2, axis=1)
    return np.asarray(np.sqrt(mean_square))


BACKBONE_TEXT = "root mean square distance between backbone and target [m]"
BACKBONE = TrackingError(
    "backbone_error", "backbone", BACKBONE_TEXT, 0.05, _backbone_distance, of_length=True
)


def _coordinate_distance(tracking: Tracking) -> Array:
    target = tracking.target.q[:, 0]
    return norm(target - tracking.q)


COORDINATES_TEXT = "norm of the coordinates' error, newton for tensions"
COORDINATES = TrackingError(
    "coordinate_error", "coordinates", COORDINATES_TEXT, 10.0, _coordinate_distance
)

ERRORS = (POSITION, ANGLE, BACKBONE, COORDINATES)
"""Errors of the package, whose terms no other may be called."""

# mean square tension, as a part of the limits, and change of the action
register("reward_term", "effort", Term(EFFORT))
register("reward_term", "smoothness", Term(SMOOTHNESS))


class ErrorUnit(NamedTuple):
    """Label and unit symbol of an error in plots and tables, and the factor from SI units."""

    label: str
    symbol: str = ""  # empty where the error's unit depends on the scene
    factor: float = 1.0

    @property
    def heading(self) -> str:
        """Label without the word "error", and its unit."""
        label = self.label.removesuffix(" error")
        if not self.symbol:
            return label
        return f"{label} [{self.symbol}]"

    def text(self, value: float) -> str:
        """Text of a value in SI units, in the display unit."""
        number = self.factor * value
        return f"{number:.3g} {self.symbol}".rstrip()


SYMBOLS = {
    "position_error": ("mm", 1e3),
    "backbone_error": ("mm", 1e3),
    "angle_error": ("deg", 57.29577951308232),
}
"""Display units of errors by their names: symbol, and factor from SI units."""


def error_unit(name: str) -> ErrorUnit:
    """Display unit of an error by its name; one that is not known keeps SI units."""
    label = name.replace("_", " ")
    if name not in SYMBOLS:
        return ErrorUnit(label)
    symbol, factor = SYMBOLS[name]
    return ErrorUnit(label, symbol, factor)
