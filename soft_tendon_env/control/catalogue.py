"""Controllers by task and name: those that come with the package, and those that `register_controller` adds.

A controller is made from a model, which is what it believes of the arm, and from what the actuators can do.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

from soft_tendon_env.control.feedforward import ReferenceGovernor, StaticFeedforward
from soft_tendon_env.control.objectives import Objective, Shape, TipPose, TipPosition
from soft_tendon_env.control.paper_laws import PaperShape, PaperTipPose
from soft_tendon_env.control.predictive import DEFAULT, Predictive, Tuning
from soft_tendon_env.control.protocol import Controller
from soft_tendon_env.control.shape_tracking import ShapeFeedforward, ShapeTracking
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.model.model import Model
from soft_tendon_env.tools.types import Array

LOOKS_AHEAD = 2
"""Control periods ahead for which laws of feedback need the reference: the velocity at the end of this one."""
INTEGRAL_TIME = 0.5  # [s] of the tip trackers
ROBUST = "; tuned on arms that differ from the model, under noise"
ROBUST_TUNING = DEFAULT._replace(settling_time=0.41, effort=1e-3, smoothness=1.13)
ROBUST_GAINS = {"settling_time": 0.8, "damping": 1.5, "integral_time": 0.4}
"""Tuning of the predictive and gains of the tracking controller, as a search like that of configs/tune_predictive.toml found them, but
for the smoothness, which fell with the default one when linearisations became more accurate."""
LONG_HORIZON = "; half a second ahead, for arms that answer late"
LONG_HORIZON_TUNING = DEFAULT._replace(settling_time=0.4, horizon=12, hold=2, smoothness=1.5)
"""Tried in water, where six periods end before the arm has moved: horizons of 0.12, 0.24 and 0.48 s have 66, 33 and 22 mm there."""
TIGHT = 0.1  # of the greatest tension: what co-contraction keeps


@dataclass(frozen=True)
class Entry:
    """A controller of the catalogue.

    make: from a model, limits (n_a, 2) [N] and the control period [s]. looks_ahead: control periods ahead for which it needs the
    reference, besides now. parameters: numbers that can be tuned, by name. change: the entry with other parameters, as keyword arguments.
    """

    description: str
    make: Callable[[Model, Array, float], Controller]
    looks_ahead: int = LOOKS_AHEAD
    parameters: Mapping[str, float] = field(default_factory=dict)
    change: Callable[..., "Entry"] | None = None

    def with_parameters(self, parameters: Mapping[str, float]) -> "Entry":
        """The controller with some of its `parameters` changed."""
        return self.change(**parameters) if self.change is not None and parameters else self


def entry_of(description: str, make: Callable[..., Controller], looks_ahead: int = LOOKS_AHEAD) -> Entry:
    """An entry whose parameters are the keyword arguments of `make` that are numbers by default."""
    arguments = [*inspect.signature(make).parameters.values()][3:]
    parameters = {argument.name: argument.default for argument in arguments if type(argument.default) in (int, float)}
    return Entry(description, make, looks_ahead, parameters, lambda **changed: entry_of(description, partial(make, **changed), looks_ahead))


def tip_pose_objective(model: Model) -> TipPose:
    """Position and angle, of which a radian is worth a tenth of the rod's length."""
    return TipPose(0.1 * model.length)


def _tip_position(model: Model) -> TipPosition:
    return TipPosition()


def _statics(objective: Callable[[Model], Objective]) -> Entry:
    return Entry(
        "inverse statics along the target, nothing measured",
        lambda model, limits, period: StaticFeedforward(model, limits, period, objective(model)),
    )


def tracking_entry(objective: Callable[[Model], Objective], description: str = "", **changed: float) -> Entry:
    """Tip tracking with a reference governor. changed: its parameters, see TipTracking, and `tight`, see StaticFeedforward."""

    def make(
        model: Model,
        limits: Array,
        period: float,
        *,
        settling_time: float = 0.2,
        damping: float = 1.0,
        integral_time: float = INTEGRAL_TIME,
        tight: float = 0.0,
    ) -> Controller:
        aim = objective(model)
        tracking = TipTracking(model, limits, period, aim, settling_time=settling_time, damping=damping, integral_time=integral_time)
        return ReferenceGovernor(StaticFeedforward(model, limits, period, aim, tight=tight), tracking)

    numbers: Any = changed
    return entry_of("(39) at the control period, within limits, with integral" + description, partial(make, **numbers))


def predictive_entry(objective: Callable[[Model], Objective], tuning: Tuning = DEFAULT, description: str = "") -> Entry:
    """Model-predictive control of the tip with a reference governor. Its parameters are those of the tuning."""

    def make(model: Model, limits: Array, period: float, tuning: Tuning) -> Controller:
        aim = objective(model)
        return ReferenceGovernor(StaticFeedforward(model, limits, period, aim), Predictive(model, limits, period, aim, tuning))

    return _predictive(make, tuning, description)


def _predictive(make: Callable[[Model, Array, float, Tuning], Controller], tuning: Tuning, description: str = "") -> Entry:
    return Entry(
        "model-predictive control" + description,
        lambda model, limits, period: make(model, limits, period, tuning),
        tuning.looks_ahead,
        tuning._asdict(),
        lambda **changed: _predictive(make, tuning._replace(**changed), description),
    )


CONTROLLERS: dict[str, dict[str, Entry]] = {
    "TipPose": {
        "paper": Entry("(39) as printed, kp = 10,000 and kd = 1,000", PaperTipPose),
        "feedforward": _statics(tip_pose_objective),
        "tracking": tracking_entry(tip_pose_objective),
        "tracking_position": tracking_entry(_tip_position, "; the position alone"),
        "tracking_co_contraction": tracking_entry(tip_pose_objective, "; tendons kept tight", tight=TIGHT),
        "predictive": predictive_entry(tip_pose_objective),
        "robust_tracking": tracking_entry(tip_pose_objective, ROBUST, **ROBUST_GAINS),
        "robust_predictive": predictive_entry(tip_pose_objective, ROBUST_TUNING, ROBUST),
        "long_horizon_predictive": predictive_entry(tip_pose_objective, LONG_HORIZON_TUNING, LONG_HORIZON),
    },
    "Shape": {
        "paper": Entry("(37) or (38) as printed, kp = 1,000 and kd = 100", PaperShape),
        "feedforward": Entry("u = q_a_bar, nothing measured", ShapeFeedforward),
        "tracking": entry_of("(37) or (38) at the control period, within limits", ShapeTracking),
        "predictive": _predictive(lambda model, limits, period, tuning: Predictive(model, limits, period, Shape(model), tuning), DEFAULT),
    },
    "Reach": {
        "feedforward": _statics(_tip_position),
        "tracking": tracking_entry(_tip_position),
        "predictive": predictive_entry(_tip_position),
        "robust_tracking": tracking_entry(_tip_position, ROBUST, **ROBUST_GAINS),
        "robust_predictive": predictive_entry(_tip_position, ROBUST_TUNING, ROBUST),
        "long_horizon_predictive": predictive_entry(_tip_position, LONG_HORIZON_TUNING, LONG_HORIZON),
    },
}
"""Controllers by the name of their task, then by their own."""

Factory = TypeVar("Factory", bound=Callable[[Model, Array, float], Controller])


def register_controller(name: str, tasks: Iterable[str], description: str, looks_ahead: int = LOOKS_AHEAD) -> Callable[[Factory], Factory]:
    """Decorator of a class or function (model, limits (n_a, 2) [N], control period [s]) that makes a controller: the name by which
    `make_policy` and comparisons find it for these tasks ("TipPose", ...). looks_ahead: see Entry.

    Registering what has the same module and name again replaces it, as in a notebook. Raises ValueError for a name that is taken.
    """

    def add(make: Factory) -> Factory:
        for task in tasks:
            entries = CONTROLLERS.setdefault(task, {})
            present = entries[name].make if name in entries else make
            if (present.__module__, getattr(present, "__qualname__", "")) != (make.__module__, getattr(make, "__qualname__", "")):
                raise ValueError(f"the controller {name!r} of {task} is registered twice: {present.__module__}, {make.__module__}")
            entries[name] = entry_of(description, make, looks_ahead)
        return make

    return add
