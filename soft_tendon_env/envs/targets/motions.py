"""Moving targets: a circle and a ramp of tensions, the tasks of the paper's Section IV, and smooth random trajectories."""

from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.envs.targets import (
    FARTHEST,
    Course,
    Distance,
    DrawnShapes,
    PoseCourse,
    Setting,
    Target,
    TargetSamples,
    pose_samples,
    register_target,
)
from soft_tendon_env.envs.targets.statics import Tensions, shape_course
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array, Positive

MOST_KNOTS = 10_000
"""Points that a random motion can be drawn with."""


@register_target
class Circle(Target):
    """The tip runs along a circle parallel to the y-z plane, its x axis leaning outward: the task of the paper's Section IV-B.

    `radius` [m], by default a quarter of the rod's length; `centre` [m], by default 0.95 of it away along x; `tilt` [degrees]; `period` [s]
    of one turn, which the paper does not give.
    """

    type: Literal["circle"] = "circle"
    radius: float | None = Field(default=None, gt=0, le=FARTHEST)
    centre: tuple[Distance, Distance, Distance] | None = None
    tilt: float = Field(default=37.8, ge=-90, le=90)
    period: Positive = 4.0

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return CircleCourse(self, setting.arms.model.length)


class CircleCourse(PoseCourse):
    """The circle; its body twist follows from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx turns about x."""

    def __init__(self, circle: Circle, length: float = 1.0) -> None:
        """length: [m] of the rod, by default of the paper's."""
        self.circle = circle
        self.radius = 0.25 * length if circle.radius is None else circle.radius
        self.centre = np.array((0.95 * length, 0.0, 0.0) if circle.centre is None else circle.centre)

    def sample(self, times: Array) -> TargetSamples:
        rate = 2.0 * np.pi / self.circle.period
        angle, lean = rate * np.mod(times, self.circle.period), np.radians(self.circle.tilt)
        c, s, none = np.cos(angle), np.sin(angle), np.zeros_like(times)
        ahead, outward, across = np.array([1.0, 0.0, 0.0]), np.stack([none, c, s], axis=-1), np.stack([none, -s, c], axis=-1)
        radial = np.cos(lean) * outward - np.sin(lean) * ahead
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, 0] = np.cos(lean) * ahead + np.sin(lean) * outward
        pose[:, :3, 1] = c[:, None] * radial - s[:, None] * across  # no roll: the axes of the base, carried by the shortest turn
        pose[:, :3, 2] = s[:, None] * radial + c[:, None] * across
        pose[:, :3, 3] = self.centre + self.radius * outward
        angular = rate * (pose[:, 0, :3] - ahead)
        linear = (pose[:, :3, :3] * (rate * self.radius * across)[:, :, None]).sum(axis=1)
        return pose_samples(pose, np.concatenate([angular, linear], axis=1))


@register_target
class Ramp(DrawnShapes):
    """From rest to static tensions within `duration` [s], then held: the task of the paper's Section IV-A.

    `tension` (n_a) [N], by default random ones within `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    tension: tuple[float, ...] | None = None

    @property
    def begins_at_rest(self) -> bool:
        return True

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm cannot hold the tensions, or those on the way."""
        return shape_course(self, generator, setting, lambda points: Rise(setting.tension, points[0], self.duration))


class Rise(Tensions):
    """Tensions that go from `start` to `end` with the polynomial of least degree that is twice differentiable."""

    def __init__(self, start: Array, end: Array, duration: float) -> None:
        self.start, self.change, self.duration = start, end - start, duration
        self.knots = np.linspace(0.0, duration, 5)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        x = (self.within(times) / self.duration)[:, None]
        part = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / self.duration
        return self.start + part * self.change, rate * self.change


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

    @property
    def repeats(self) -> float:
        return self.period

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        count = round(self.period / self.knot_period)
        return shape_course(self, generator, setting, lambda points: ClosedSpline(points, self.period), count)


class ClosedSpline(Tensions):
    """A closed uniform cubic B-spline with control points (k, n_a): it stays within their bounds."""

    is_closed = True

    def __init__(self, points: Array, period: float) -> None:
        self.points, self.period = points, period
        self.knots = np.linspace(0.0, period, len(points) + 1)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        count = len(self.points)
        place = self.within(times) / self.period * count
        first = np.floor(place).astype(int)
        f = place - first
        g = 1.0 - f
        weights = np.stack([g * g * g, 4.0 - 6.0 * f * f + 3.0 * f * f * f, 4.0 - 6.0 * g * g + 3.0 * g * g * g, f * f * f]) / 6.0
        slopes = np.stack([-g * g, 3.0 * f * f - 4.0 * f, 4.0 * g - 3.0 * g * g, f * f]) * (0.5 * count / self.period)
        near = self.points[(first + np.arange(4)[:, None]) % count]
        return (weights[:, :, None] * near).sum(axis=0), (slopes[:, :, None] * near).sum(axis=0)
