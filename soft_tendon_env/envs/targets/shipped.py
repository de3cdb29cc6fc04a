"""Targets that ship: poses or shapes to hold, a circle and a ramp of tensions as in the paper's
Section IV, and random motions."""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from soft_tendon_env.envs.targets import (
    FARTHEST,
    Amount,
    Course,
    Distance,
    DrawnShapes,
    GivenShapes,
    NamedTarget,
    PoseCourse,
    Setting,
    ShapeCourse,
    Target,
    TargetSamples,
    drawn,
    pose_samples,
    register_target,
)
from soft_tendon_env.envs.targets.statics import Tensions, shape_course
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array, Positive

Angle = Annotated[float, Field(ge=-90, le=90)]
MOST_KNOTS = 10_000  # points that a random motion can be drawn with


@register_target
class Hold(GivenShapes):
    """One pose to reach and hold: the pose at which `tension` (n_a) [N] holds the arm, a given
    `pose` (4 x 4), for Reach a given `position` (3) [m] alone, or by default a pose from random
    tensions within `fraction` of their limits."""

    type: Literal["hold"] = "hold"
    pose: tuple[tuple[float, float, float, float], ...] | None = Field(
        default=None, min_length=4, max_length=4
    )
    position: tuple[Distance, Distance, Distance] | None = None

    @field_validator("pose", mode="before")
    @classmethod
    def _rows(cls, pose: Any) -> Any:
        return (
            tuple(tuple(row) if isinstance(row, list) else row for row in pose)
            if isinstance(pose, tuple)
            else pose
        )

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        given = [
            name for name in ("tension", "pose", "position") if getattr(self, name) is not None
        ]
        if len(given) > 1:
            raise ValueError(f"should give {given[0]} or {given[1]}, not both")
        if self.pose is not None:
            g = np.array(self.pose)
            R, r = g[:3, :3], g[:3, 3]
            is_rotation = (
                np.abs(R).max() < 1.1
                and np.allclose(R @ R.T, np.eye(3), atol=1e-6)
                and np.linalg.det(R) > 0
            )
            if not (is_rotation and (g[3] == [0, 0, 0, 1]).all() and np.abs(r).max() <= FARTHEST):
                allowed = (
                    "a homogeneous matrix [[R, r], [0, 0, 0, 1]] with a rotation R and coordinates"
                    f" r within ±{FARTHEST:g} m"
                )
                raise ConfigurationError(
                    [Problem(("pose",), f"is {shown(g.tolist())}: it should be {allowed}")]
                )
        return self

    @property
    def given(self) -> Array | None:
        """The given pose (4, 4), of a position alone with the world's axes; None where it is made
        of tensions."""
        if self.position is None:
            return None if self.pose is None else np.array(self.pose)
        pose = np.eye(4)
        pose[:3, 3] = self.position
        return pose

    @property
    def is_random(self) -> bool:
        return self.tension is None and self.gives_shapes

    @property
    def gives_shapes(self) -> bool:
        return self.pose is None and self.position is None

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return (
            shape_course(self, generator, setting) if self.given is None else FixedPose(self.given)
        )


class FixedPose(PoseCourse):
    """A pose that stays."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose

    def sample(self, times: Array) -> TargetSamples:
        return pose_samples(np.tile(self.pose, (times.size, 1, 1)), np.zeros((times.size, 6)))


@register_target
class OutOfReach(DrawnShapes):
    """A pose to hold that the arm cannot reach: drawn as for "hold", and moved away from the base
    to `beyond` times the rod's length."""

    type: Literal["out_of_reach"] = "out_of_reach"
    beyond: Positive = 1.2

    @property
    def gives_shapes(self) -> bool:
        return False  # no shape has its pose

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        pose = setting.model.tip_pose(
            shape_course(self, generator, setting).coordinates(np.zeros(1))[0][0]
        )
        base = np.array(setting.model.scene.base.position)
        away = pose[:3, 3] - base
        pose[:3, 3] = base + away * (self.beyond * setting.model.length / np.linalg.norm(away))
        return FixedPose(pose)


@register_target
class Steps(DrawnShapes):
    """`count` set points, each for `duration` [s], over and over: shapes at rest under random
    tensions within `fraction` of their limits."""

    type: Literal["steps"] = "steps"
    duration: Positive = 2.0
    count: int = Field(default=5, ge=2, le=1_000)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        held = [
            shape_course(self, generator, setting).coordinates(np.zeros(1))[0][0]
            for _ in range(self.count)
        ]
        return Stepped(np.array(held), self.duration)


class Stepped(ShapeCourse):
    """Shapes (k, n) that are held one after another, over and over."""

    def __init__(self, held: Array, duration: float) -> None:
        self._held, self._duration = held, duration

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        q = self._held[np.floor(times / self._duration + 1e-9).astype(int) % len(self._held)]
        return q, np.zeros_like(q)


@register_target
class Circle(Target):
    """The tip runs along a circle across the base's x axis, its own x axis leaning outward: the
    task of the paper's Section IV-B.

    `radius` [m], by default a quarter of the rod's length; `centre` [m] in the world, by default
    0.95 of it away along the base's x axis; `tilt` [degrees]; `period` [s] of one turn, which the
    paper does not give.
    """

    type: Literal["circle"] = "circle"
    radius: float | None = Field(default=None, gt=0, le=FARTHEST)
    centre: tuple[Distance, Distance, Distance] | None = None
    tilt: Angle = 37.8
    period: Positive = 4.0

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return CircleCourse(self, setting.arms.model.length, setting.model.scene.base.pose)


class CircleCourse(PoseCourse):
    """The circle; its body twist follows from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx
    turns about x."""

    def __init__(self, circle: Circle, length: float = 1.0, base: Array | None = None) -> None:
        """length: [m] of the rod, by default of the paper's; base: its pose (4, 4), by default the
        world's origin."""
        self.circle = circle
        base = np.eye(4) if base is None else base
        self._axes = base[:3, :3]
        self.radius = 0.25 * length if circle.radius is None else circle.radius
        self.centre = (
            base[:3, 3] + 0.95 * length * base[:3, 0]
            if circle.centre is None
            else np.array(circle.centre)
        )

    def sample(self, times: Array) -> TargetSamples:
        rate = 2.0 * np.pi / self.circle.period
        angle, lean = rate * np.mod(times, self.circle.period), np.radians(self.circle.tilt)
        c, s, none = np.cos(angle), np.sin(angle), np.zeros_like(times)
        ahead, outward, across = (
            np.array([1.0, 0.0, 0.0]),
            np.stack([none, c, s], axis=-1),
            np.stack([none, -s, c], axis=-1),
        )
        radial = np.cos(lean) * outward - np.sin(lean) * ahead
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, 0] = np.cos(lean) * ahead + np.sin(lean) * outward
        pose[:, :3, 1] = (
            c[:, None] * radial - s[:, None] * across
        )  # no roll: the axes of the base, carried by the shortest turn
        pose[:, :3, 2] = s[:, None] * radial + c[:, None] * across
        angular = rate * (pose[:, 0, :3] - ahead)
        linear = (pose[:, :3, :3] * (rate * self.radius * across)[:, :, None]).sum(axis=1)
        pose[:, :3, :3] = self._axes @ pose[:, :3, :3]
        pose[:, :3, 3] = self.centre + self.radius * outward @ self._axes.T
        return pose_samples(pose, np.concatenate([angular, linear], axis=1))


@register_target
class Circles(Target):
    """A circle that every episode draws, see `Circle`: ranges of its `radius` and of the `distance`
    of its centre from the base, both in lengths of the rod, of `tilt` [degrees] and `period` [s].
    The paper's arm can hold the positions of most and the orientations of few."""

    type: Literal["circles"] = "circles"
    radius: Amount = (0.05, 0.26)
    distance: Amount = (0.8, 0.95)
    tilt: tuple[Angle, Angle] = (0.0, 45.0)
    period: Amount = (2.0, 8.0)

    @field_validator("tilt")
    @classmethod
    def _ordered(cls, tilt: tuple[float, float]) -> tuple[float, float]:
        if tilt[0] > tilt[1]:
            raise ValueError("should be (least, greatest), least before greatest")
        return tilt

    @property
    def is_random(self) -> bool:
        return True

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        radius, distance, tilt, period = (
            drawn(of, generator) for of in (self.radius, self.distance, self.tilt, self.period)
        )
        length, base = setting.arms.model.length, setting.model.scene.base.pose
        centre = tuple((base[:3, 3] + distance * length * base[:3, 0]).tolist())
        return CircleCourse(
            Circle(radius=radius * length, centre=centre, tilt=tilt, period=period), length, base
        )


@register_target
class Either(Target):
    """One of several targets, `of`, that every episode draws, each as often."""

    type: Literal["either"] = "either"
    of: tuple[NamedTarget, ...] = Field(min_length=1)

    @property
    def is_random(self) -> bool:
        return True

    @property
    def gives_shapes(self) -> bool:
        return all(target.gives_shapes for target in self.of)

    @property
    def repeats(self) -> float | None:
        return max(
            (target.repeats for target in self.of if target.repeats is not None), default=None
        )

    @property
    def kinds(self) -> int:
        return len(self.of)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return self.of[int(generator.integers(len(self.of)))].draw(generator, setting)


@register_target
class Ramp(GivenShapes):
    """From rest to static tensions within `duration` [s], then held: the task of the paper's
    Section IV-A.

    `tension` (n_a) [N], by default random ones within `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    begins_at_rest: ClassVar[bool] = True

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return shape_course(
            self, generator, setting, lambda points: Rise(setting.tension, points[0], self.duration)
        )


class Rise(Tensions):
    """Tensions that go from `start` to `end` with the polynomial of least degree that is twice
    differentiable."""

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
    """A smooth random motion: tensions along a closed cubic B-spline with a random point within
    `fraction` of their limits every `knot_period` [s], which may be a range too, or a little less
    or more to make them a whole number of at least 4; it repeats after `period` [s]."""

    type: Literal["random"] = "random"
    knot_period: Amount = 1.0
    period: Positive = 10.0

    @model_validator(mode="after")
    def _enough_knots(self) -> "Random":
        least, greatest = self.period / MOST_KNOTS, self.period / 4
        if not least <= np.min(self.knot_period) <= np.max(self.knot_period) <= greatest:
            allowed = (
                f"{least:g} to {greatest:g} s, for 4 to {MOST_KNOTS} in a period of"
                f" {self.period:g} s"
            )
            given = (
                shown(self.knot_period)
                if isinstance(self.knot_period, tuple)
                else f"{self.knot_period:g}"
            )
            raise ConfigurationError(
                [Problem(("knot_period",), f"is {given}: it should be {allowed}")]
            )
        return self

    @property
    def repeats(self) -> float:
        return self.period

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        count = round(self.period / drawn(self.knot_period, generator))
        return shape_course(
            self, generator, setting, lambda points: ClosedSpline(points, self.period), count
        )


class ClosedSpline(Tensions):
    """A closed uniform cubic B-spline with control points (k, n_a): it stays within their
    bounds."""

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
        weights = (
            np.stack(
                [
                    g * g * g,
                    4.0 - 6.0 * f * f + 3.0 * f * f * f,
                    4.0 - 6.0 * g * g + 3.0 * g * g * g,
                    f * f * f,
                ]
            )
            / 6.0
        )
        slopes = np.stack([-g * g, 3.0 * f * f - 4.0 * f, 4.0 * g - 3.0 * g * g, f * f]) * (
            0.5 * count / self.period
        )
        near = self.points[(first + np.arange(4)[:, None]) % count]
        return (weights[:, :, None] * near).sum(axis=0), (slopes[:, :, None] * near).sum(axis=0)
