"""Smooth random trajectory: a closed B-spline of tensions, through shapes that the arm can hold."""

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs.targets.base import Course, DrawnShapes, Setting, register_target
from soft_tendon_env.envs.targets.statics import Tensions, drawn_course
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array, Positive

MOST_KNOTS = 10_000
"""Points that a random motion can be drawn with."""


@register_target
class Random(DrawnShapes):
    """A smooth random motion: tensions along a closed cubic B-spline with a random point within `fraction` of their limits every
    `knot_period` [s], or a little less or more to make them a whole number of at least 4; it repeats after `period` [s]."""

    type: Literal["random"] = "random"
    knot_period: float = Field(default=1.0, gt=0)
    period: Positive = 10.0

    @model_validator(mode="after")
    def _enough_knots(self) -> "Random":
        if not 4 * self.knot_period <= self.period <= MOST_KNOTS * self.knot_period:
            allowed = f"{self.period / MOST_KNOTS:g} to {self.period / 4:g} s, for 4 to {MOST_KNOTS} in a period of {self.period:g} s"
            raise ConfigurationError([Problem(("knot_period",), f"is {self.knot_period:g}: it should be {allowed}")])
        return self

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm can hold none."""
        count = round(self.period / self.knot_period)
        return drawn_course(count, self.fraction, generator, setting, lambda points: ClosedSpline(points, self.period))


class ClosedSpline(Tensions):
    """A closed uniform cubic B-spline with control points (k, n_a): it stays within their bounds."""

    is_closed = True

    def __init__(self, points: Array, period: float) -> None:
        self.points, self.period = points, period
        self.knots = np.linspace(0.0, period, len(points) + 1)

    def within(self, times: Array) -> Array:
        return np.mod(times, self.period)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        count = len(self.points)
        place = self.within(times) / self.period * count
        first = np.floor(place)
        f, index = (place - first)[:, None], first.astype(int)
        g = 1.0 - f
        weights = (g * g * g, 4.0 - 6.0 * f * f + 3.0 * f * f * f, 4.0 - 6.0 * g * g + 3.0 * g * g * g, f * f * f)
        slopes = (-3.0 * g * g, 9.0 * f * f - 12.0 * f, 12.0 * g - 9.0 * g * g, 3.0 * f * f)
        near = [self.points.take((index + j) % count, axis=0) for j in range(4)]
        value = sum(w * p for w, p in zip(weights, near, strict=True)) / 6.0
        slope = sum(w * p for w, p in zip(slopes, near, strict=True)) * (count / (6.0 * self.period))
        return np.asarray(value), np.asarray(slope)
