"""Controllers by task and name.

One is a class or function under `@register("controller", "name", task="Reach",
description="what it does")`, here or in a user's own file as `examples/own_controller.py`.

A controller is made from a model, which is what it believes of the arm, and from what the actuators
can do.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from soft_tendon_env.control.feedforward import ReferenceGovernor, StaticFeedforward
from soft_tendon_env.control.objectives import (
    Objective,
    Shape,
    TipPose,
    TipPosition,
    TrackedObjective,
)
from soft_tendon_env.control.own_cost import OwnCost
from soft_tendon_env.control.paper_laws import PaperShape, PaperTipPose
from soft_tendon_env.control.predictive import DEFAULT, Predictive, Tuning
from soft_tendon_env.control.protocol import Controller
from soft_tendon_env.control.shape_tracking import ShapeFeedforward, ShapeTracking
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.model.model import Model
from soft_tendon_env.registration import IDS
from soft_tendon_env.tools.configuration import not_among, not_registered, shown
from soft_tendon_env.tools.registry import Registry, register
from soft_tendon_env.tools.types import Array

# control periods ahead for which laws of feedback need the reference: the velocity at the end of
# this one
LOOKS_AHEAD = 2
# keyword argument of what makes controllers that take a cost of the user's own
OBJECTIVES = "objectives"


@dataclass(frozen=True)
class Entry:
    """Entry of the catalogue: a controller with its parameters.

    Attributes:
        description: one phrase, for lists of controllers.
        make: makes it from a model, limits (n_a, 2) [N] and the control period [s].
        looks_ahead: control periods ahead for which it needs the reference, besides now.
        parameters: numbers that can be tuned, by name, which `make` takes as keyword arguments.
    """

    description: str
    make: Callable[..., Controller]
    looks_ahead: int = LOOKS_AHEAD
    parameters: Mapping[str, float] = field(default_factory=dict)

    def with_parameters(self, parameters: Mapping[str, float]) -> "Entry":
        """Returns the controller with some of its parameters changed.

        Args:
            parameters: numbers by name, some of the entry's.

        Returns:
            The new entry.
        """
        numbers: dict[str, Any] = {**self.parameters, **parameters}
        looks_ahead = self.looks_ahead
        # predictive control looks as far ahead as its horizon
        if numbers.keys() == DEFAULT._asdict().keys():
            looks_ahead = Tuning(**numbers).looks_ahead
        make = partial(self.make, **parameters)
        return replace(
            self,
            make=make,
            looks_ahead=looks_ahead,
            parameters=numbers,
        )

    @property
    def takes_objectives(self) -> bool:
        """Whether `make` has a keyword argument `objectives`, for a cost of the user's own."""
        return OBJECTIVES in inspect.signature(self.make).parameters

    def with_cost(self, cost: OwnCost) -> "Entry":
        """Returns the controller with a cost of the user's own.

        Args:
            cost: its objectives, and parameters such as the weight of effort.

        Returns:
            The new entry.

        Raises:
            ValueError: the controller has no such parameter.
        """
        for name in cost.parameters:
            if name not in self.parameters:
                raise ValueError(
                    f"objectives has {name.capitalize()}, and the controller no parameter {name!r}:"
                    f" {not_among(name, self.parameters)}"
                )
        entry = self.with_parameters(cost.parameters) if cost.parameters else self
        return replace(entry, make=partial(entry.make, **{OBJECTIVES: cost.objectives}))


class ControllerRegistry(Registry[Entry]):
    """Registry of controllers: the entry "Reach/tracking" is `tracking` of the task Reach."""

    def add(self, name: str, thing: Any, module: str, **details: Any) -> Entry:
        """Add a controller of the task that the details name, see Registry."""
        if not name:
            raise TypeError("the name of a controller should be a text, not ''")
        task = details.get("task", "")
        return super().add(f"{task}/{name}", thing, module, **details)


def _checked_controller(
    name: str,
    make: Any,
    *,
    task: str,
    description: str,
    looks_ahead: int = LOOKS_AHEAD,
    parameters: Mapping[str, float] | None = None,
) -> Entry:
    """Makes an entry of the catalogue for a controller.

    Args:
        name: of the entry, TASK/NAME.
        make: a class or function (model, limits (n_a, 2) [N], control period [s]) that makes it.
        task: a registered one, which it is for.
        description: what it does.
        looks_ahead: control periods ahead for which it needs the reference.
        parameters: numbers that can be tuned, by name; None: those of the keyword arguments of
            `make` that are numbers by default.

    Returns:
        The entry.

    Raises:
        TypeError: `make` is no function of these three, or makes what has no method `act`.
        ValueError: there is no such task.
    """
    if task not in IDS:
        raise ValueError(
            f"the controller {name!r} has task = {shown(task)}: {not_registered(task, IDS)}"
        )
    if not callable(make):
        raise TypeError(f"the controller {name!r} should be a class or function, not {shown(make)}")
    if isinstance(make, type) and not hasattr(make, "act"):
        raise TypeError(
            f"the controller {name!r}, {make.__qualname__}, lacks a method act(now, memory)"
        )
    signature = inspect.signature(make)
    try:
        signature.bind(None, None, None)
    except TypeError as error:
        raise TypeError(
            f"the controller {name!r} should be made from a model, limits and the control period"
            f" alone: {error}"
        ) from error
    if parameters is None:
        parameters = _number_arguments(make)
    return Entry(description, make, looks_ahead, parameters)


CONTROLLERS: Registry[Entry] = ControllerRegistry("controller", _checked_controller)
"""Controllers by task and name, as "Reach/tracking"."""


def controllers_of(task: str) -> dict[str, Entry]:
    """Returns the controllers of a task by their names.

    Args:
        task: its name.

    Returns:
        The entries; none of a task that has none.
    """
    entries = {}
    for key, entry in CONTROLLERS.items():
        owner, _, name = key.partition("/")
        if owner == task:
            entries[name] = entry
    return entries


def valid_controllers(name: str, task: str) -> str:
    """Describes the valid controllers of a task, or that it has none: the end of a message.

    Args:
        name: of an unknown controller.
        task: that should have it.

    Returns:
        The end of the sentence.
    """
    entries = controllers_of(task)
    if entries:
        return not_registered(name, entries)
    return (
        f"the task {task} has none; register one by @register('controller', NAME, task={task!r},"
        " description=...)"
    )


def _number_arguments(make: Callable[..., Controller]) -> dict[str, float]:
    """Keyword arguments of a controller that are numbers, after model, limits and period."""
    signature = inspect.signature(make)
    arguments = [*signature.parameters.values()][3:]
    return {
        argument.name: argument.default
        for argument in arguments
        if type(argument.default) in (int, float)
    }


def _entry_of(description: str, make: Callable[..., Controller]) -> Entry:
    """Entry of a controller whose numbers by default are its parameters."""
    return Entry(description, make, parameters=_number_arguments(make))


# what descriptions of presets add
ROBUST = "; tuned on arms that differ from the model, under noise"
LATE = "; half a second ahead, for arms that answer late"
PRESETS: dict[str, tuple[str, str, dict[str, float]]] = {
    "robust_predictive": (
        "predictive",
        ROBUST,
        {"settling_time": 0.2, "horizon": 6, "smoothness": 1.1},
    ),
    "long_horizon_predictive": (
        "predictive",
        LATE,
        {"settling_time": 0.4, "horizon": 12, "hold": 2, "smoothness": 1.5},
    ),
}
"""Tuned controllers: which one, what its description adds, and its numbers. The robust one was
found by `soft-tendon tune predictive` on arms that differ from the model, the other is for water,
see benchmarks/scenes.toml."""


def tip_pose_objective(model: Model) -> TipPose:
    """Position and angle, of which a radian is worth a tenth of the rod's length."""
    return TipPose(0.1 * model.length)


def _tip_controllers(objective: Callable[[Model], TrackedObjective]) -> dict[str, Entry]:
    """Controllers of the tip with their presets."""

    def statics(model: Model, limits: Array, period: float) -> StaticFeedforward:
        return StaticFeedforward(model, limits, period, objective(model))

    def tracking(
        model: Model,
        limits: Array,
        period: float,
        settling_time: float = 0.2,
        damping: float = 1.0,
        integral_time: float = 0.5,
    ) -> Controller:
        controller = TipTracking(
            model,
            limits,
            period,
            objective(model),
            settling_time=settling_time,
            damping=damping,
            integral_time=integral_time,
        )
        return ReferenceGovernor(statics(model, limits, period), controller)

    def predictive(
        model: Model,
        limits: Array,
        period: float,
        objectives: Sequence[Objective] | None = None,
        **tuning: Any,
    ) -> Controller:
        # an own cost is minimised as it is: no governor moves its target within reach
        if objectives is not None:
            return Predictive(model, limits, period, objectives, Tuning(**tuning))
        controller = Predictive(model, limits, period, objective(model), Tuning(**tuning))
        return ReferenceGovernor(statics(model, limits, period), controller)

    entries = {
        "feedforward": _entry_of("inverse statics along the target, nothing measured", statics),
        "tracking": _entry_of("(39) at the control period, within limits, with integral", tracking),
        "predictive": Entry(
            "model-predictive control", predictive, DEFAULT.looks_ahead, DEFAULT._asdict()
        ),
    }
    for name, (base, added, numbers) in PRESETS.items():
        entry = entries[base]
        entries[name] = replace(
            entry.with_parameters(numbers), description=entry.description + added
        )
    return entries


def _shape_predictive(
    model: Model,
    limits: Array,
    period: float,
    objectives: Sequence[Objective] | None = None,
    **tuning: Any,
) -> Controller:
    """Predictive control of shapes, which tensions hold: they need no governor."""
    objective = objectives or Shape(model)
    return Predictive(model, limits, period, objective, Tuning(**tuning))


SHAPE = {"horizon": 8, "smoothness": 0.3}
"""Tuning of shapes where it differs: all coordinates answer at once, and errors of 12 periods are
2.8 times as large."""

OF_POSITION = _tip_controllers(lambda model: TipPosition())
_SHIPPED: dict[str, dict[str, Entry]] = {
    "TipPose": {
        "paper": Entry("(39) as printed, kp = 10,000 and kd = 1,000", PaperTipPose),
        **_tip_controllers(tip_pose_objective),
        "tracking_position": replace(
            OF_POSITION["tracking"], description="`tracking` for the position alone"
        ),
    },
    "Shape": {
        "paper": Entry("(37) or (38) as printed, kp = 1,000 and kd = 100", PaperShape),
        "feedforward": Entry("u = q_a_bar, nothing measured", ShapeFeedforward),
        "tracking": _entry_of("(37) or (38) at the control period, within limits", ShapeTracking),
        "predictive": replace(OF_POSITION["predictive"], make=_shape_predictive).with_parameters(
            SHAPE
        ),
    },
    "Reach": OF_POSITION,
}

for _task, _entries in _SHIPPED.items():
    for _name, _entry in _entries.items():
        register(
            "controller",
            _name,
            _entry.make,
            task=_task,
            description=_entry.description,
            looks_ahead=_entry.looks_ahead,
            parameters=_entry.parameters,
        )
