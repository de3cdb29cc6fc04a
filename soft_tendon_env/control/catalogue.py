"""Every controller that comes with the package, by task and name. To add one, add its entry here.

A controller of the catalogue is made from a model, which is what it believes of the arm, and from what the actuators can do.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from soft_tendon_env.control.feedforward import StaticFeedforward
from soft_tendon_env.control.objectives import Shape, TipPose, TipPosition
from soft_tendon_env.control.predictive import Predictive
from soft_tendon_env.control.protocol import Controller
from soft_tendon_env.control.shape_tracking import ShapeFeedforward, ShapeTracking
from soft_tendon_env.control.tip_tracking import TipTracking
from soft_tendon_env.model import Model
from soft_tendon_env.scene import Array

INTEGRAL_TIME = 0.5  # [s] of the tip trackers
CO_CONTRACTION = 0.1  # of the greatest tension
NULL_SPACE = 1e-2  # weight of effort where the null space of the task is used


@dataclass(frozen=True)
class Entry:
    """A controller by name.

    make: from a model, limits (n_a, 2) [N] and the control period [s]. looks_ahead: control periods for which it wants to see the
    target, besides now.
    """

    description: str
    make: Callable[[Model, Array, float], Controller]
    looks_ahead: int = 2


def _tip_pose(model: Model) -> TipPose:
    return TipPose(0.1 * model.length)


CONTROLLERS: Mapping[str, Mapping[str, Entry]] = {
    "TipPose": {
        "feedforward": Entry(
            "inverse statics along the target, nothing measured",
            lambda model, limits, period: StaticFeedforward(model, limits, period, _tip_pose(model)),
        ),
        "tracking": Entry(
            "(39) at the control period, within limits, with integral",
            lambda model, limits, period: TipTracking(model, limits, period, _tip_pose(model), integral_time=INTEGRAL_TIME),
        ),
        "tracking_least_effort": Entry(
            "the same, the null space used for small tensions",
            lambda model, limits, period: TipTracking(
                model, limits, period, _tip_pose(model), integral_time=INTEGRAL_TIME, effort=NULL_SPACE
            ),
        ),
        "tracking_co_contraction": Entry(
            "the same, the null space used to keep all tendons tight",
            lambda model, limits, period: TipTracking(
                model,
                limits,
                period,
                _tip_pose(model),
                integral_time=INTEGRAL_TIME,
                effort=NULL_SPACE,
                preferred=CO_CONTRACTION * np.maximum(limits[:, 1], 0.0),
            ),
        ),
        "predictive": Entry(
            "model-predictive control",
            lambda model, limits, period: Predictive(model, limits, period, _tip_pose(model)),
            looks_ahead=7,
        ),
    },
    "Shape": {
        "feedforward": Entry("u = q_a_bar, nothing measured", ShapeFeedforward),
        "tracking": Entry("(37) or (38) at the control period, within limits", ShapeTracking),
        "predictive": Entry(
            "model-predictive control",
            lambda model, limits, period: Predictive(model, limits, period, Shape(model)),
            looks_ahead=7,
        ),
    },
    "Reach": {
        "feedforward": Entry(
            "inverse statics, nothing measured",
            lambda model, limits, period: StaticFeedforward(model, limits, period, TipPosition()),
        ),
        "tracking": Entry(
            "(39) for the position, at the control period, within limits, with integral",
            lambda model, limits, period: TipTracking(model, limits, period, TipPosition(), integral_time=INTEGRAL_TIME),
        ),
        "predictive": Entry(
            "model-predictive control of the position",
            lambda model, limits, period: Predictive(model, limits, period, TipPosition()),
            looks_ahead=7,
        ),
    },
}
"""By the name of the task, then by its own."""
