"""A user's own cost of predictive control: objectives, effort and smoothness in one list."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from soft_tendon_env.control.objectives import LinearError, Objective, Posture, checked_weight
from soft_tendon_env.control.protocol import Reference
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.checks import checked_number
from soft_tendon_env.tools.configuration import shown
from soft_tendon_env.tools.types import Array

SHIPPED = "TipPose, TipPosition, TipDirection, Shape, Avoidance, Effort, Smoothness"
ALLOWED = (
    f"it should be {SHIPPED}, an object with linear_error(posture), or a class or function of the"
    " model that makes one"
)


@dataclass(frozen=True)
class Effort:
    """Weight of the squares of the tensions, against what they do to the other objectives."""

    weight: float  # in the place of `Tuning.effort`

    def __post_init__(self) -> None:
        checked_weight(self.weight)


@dataclass(frozen=True)
class Smoothness:
    """Weight of the squares of the tensions' changes, against what they do to other objectives."""

    weight: float  # in the place of `Tuning.smoothness`

    def __post_init__(self) -> None:
        checked_number("weight", self.weight, 0.0, "a number, at least 0")


Given = Objective | Effort | Smoothness | Callable[[Model], Objective]
"""Entry of a list of objectives: one, or a class or function of the model that makes one."""


class OwnCost(NamedTuple):
    """Objectives of predictive control, and the parameters that a list sets besides."""

    objectives: tuple[Objective, ...]
    parameters: Mapping[str, float]


def own_cost(objectives: Any, model: Model, told: Sequence[str]) -> OwnCost:
    """Returns the cost that a list of objectives describes, once it is checked.

    Args:
        objectives: a sequence of Given.
        model: of the controller.
        told: fields of a Reference that the task tells.

    Returns:
        The objectives, made for the model, and weights of effort and smoothness by name.

    Raises:
        TypeError: for entries that are no objectives.
        ValueError: where the task does not tell what one follows, where one has errors or a
            Jacobian of another shape or that are not finite, or where none is left.
    """
    if isinstance(objectives, str) or not isinstance(objectives, Sequence):
        raise TypeError(f"objectives is {shown(objectives)}: it should be a list; each {ALLOWED}")
    errors = list[Objective]()
    parameters = dict[str, float]()
    for place, entry in enumerate(objectives):
        where = f"objectives[{place}]"
        if isinstance(entry, Effort | Smoothness):
            name = type(entry).__name__.lower()
            if name in parameters:
                raise ValueError(f"{where} is a second {type(entry).__name__}: there should be one")
            parameters[name] = entry.weight
            continue
        objective = _made(entry, model, where)
        _check_reference(objective, told, where)
        _check_shapes(objective, model, told, where)
        errors.append(objective)
    if not errors:
        raise ValueError(
            f"objectives is {shown(list(objectives))}: it should have an error besides Effort and"
            " Smoothness, such as TipPosition()"
        )
    return OwnCost(tuple(errors), parameters)


def _made(entry: Any, model: Model, where: str) -> Objective:
    """The objective of an entry. Raises TypeError."""
    objective = entry
    if isinstance(entry, type) or not hasattr(entry, "linear_error"):
        if not callable(entry):
            raise TypeError(f"{where} is {shown(entry)}: {ALLOWED}")
        try:
            objective = entry(model)
        except TypeError as error:
            raise TypeError(
                f"{where} is {shown(entry)}, which makes no objective of a model alone ({error}):"
                f" {ALLOWED}"
            ) from error
    if not hasattr(objective, "linear_error"):
        raise TypeError(f"{where} makes {shown(objective)}: {ALLOWED}")
    made: Objective = objective
    return made


def _check_reference(objective: Objective, told: Sequence[str], where: str) -> None:
    """Raises ValueError where an objective follows what a task does not tell."""
    follows = getattr(objective, "follows", ())
    if follows and not set(follows) & set(told):
        raise ValueError(
            f"{where} is {type(objective).__name__}, which follows the target's"
            f" {' or '.join(follows)}: this environment tells {', '.join(told)} alone"
        )


def _check_shapes(objective: Objective, model: Model, told: Sequence[str], where: str) -> None:
    """Raises ValueError where the error at rest, or its Jacobian, has no usable shape."""
    q = np.zeros(model.coordinate_count)
    terms = model.terms(q, q)
    fields: dict[str, Array] = {}
    if "tip_pose" in told:
        fields["tip_pose"] = terms.tip_pose[None]
    if "tip_position" in told:
        fields["tip_position"] = terms.tip_pose[None, :3, 3]
    if "q" in told:
        fields["q"] = q[None]
    reference = Reference(np.zeros(1), **fields)
    posture = Posture(q, terms.tip_pose, terms.tip_jacobian, reference, 0.0, 0.0)
    linear: LinearError = objective.linear_error(posture)
    shapes = [np.shape(values) for values in linear]
    rows = shapes[0]
    is_pair = len(shapes) == 2 and len(rows) == 1
    if not is_pair or shapes[1] != (*rows, q.size):
        raise ValueError(
            f"{where} is {type(objective).__name__}, whose linear_error has the shapes {shapes}: it"
            f" should be LinearError(error (k,), jacobian (k, {q.size}))"
        )
    if not all(np.isfinite(values).all() for values in linear):
        raise ValueError(
            f"{where} is {type(objective).__name__}, whose linear_error at rest is {linear}: it"
            " should be finite"
        )
