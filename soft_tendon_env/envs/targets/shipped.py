"""Targets that ship: poses or shapes to hold, the paper's circle and ramp, random motions.

The circle and the ramp of tensions are those of its Section IV.
"""

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
)
from soft_tendon_env.envs.targets.statics import Tensions, shape_course
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.types import Array, Positive

Angle = Annotated[float, Field(ge=-90, le=90)]

MOST_KNOTS = 10_000
"""Points that a random motion can be drawn with."""

Row = tuple[float, float, float, float]


@register("target", "hold")
class Hold(GivenShapes):
    """One pose to reach and hold, by default one from random tensions within `fraction` of limits.

    Others are the pose at which `tension` (n_a) [N] holds the arm, a given `pose` (4 x 4), and for
    Reach a given `position` (3) [m] alone.
    """

    type: Literal["hold"] = "hold"
    pose: tuple[Row, ...] | None = Field(default=None, min_length=4, max_length=4)
    position: tuple[Distance, Distance, Distance] | None = None

    @field_validator("pose", mode="before")
    @classmethod
    def _rows(cls, pose: Any) -> Any:
        if not isinstance(pose, tuple):
            return pose
        return tuple(tuple(row) if isinstance(row, list) else row for row in pose)

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        kinds = {"tension": self.tension, "pose": self.pose, "position": self.position}
        chosen = [name for name, value in kinds.items() if value is not None]
        if len(chosen) > 1:
            message = f"should give {chosen[0]} or {chosen[1]}, not both"
            raise ValueError(message)
        if self.pose is not None:
            g = np.array(self.pose)
            if not _is_pose(g):
                allowed = (
                    "a homogeneous matrix [[R, r], [0, 0, 0, 1]] with a rotation R and coordinates"
                    f" r within ±{FARTHEST:g} m"
                )
                text = f"is {shown(g.tolist())}: it should be {allowed}"
                raise ConfigurationError([Problem(("pose",), text)])
        return self

    @property
    def given_pose(self) -> Array | None:
        """Given pose (4, 4), of a position alone with the world's axes; None of tensions."""
        if self.pose is not None:
            return np.array(self.pose)
        if self.position is None:
            return None
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
        pose = self.given_pose
        if pose is not None:
            return FixedPose(pose)
        return shape_course(self, generator, setting)


def _is_pose(g: Array) -> bool:
    """Whether a matrix (4, 4) is of a rotation and of coordinates that are not too large."""
    R = g[:3, :3]
    r = g[:3, 3]
    # entries first: of huge ones the products overflow
    is_rotation = (
        np.abs(R).max() < 1.1
        and np.allclose(R @ R.T, np.eye(3), atol=1e-6)
        and np.linalg.det(R) > 0
    )
    is_last_row = g[3] == [0, 0, 0, 1]
    is_homogeneous = is_last_row.all()
    is_near = np.abs(r).max() <= FARTHEST
    return bool(is_rotation and is_homogeneous and is_near)


class FixedPose(PoseCourse):
    """A pose that stays."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose

    def sample(self, times: Array) -> TargetSamples:
        shape = (times.size, 1, 1)
        pose = np.tile(self.pose, shape)
        no_twist = np.zeros((times.size, 6))
        return pose_samples(pose, no_twist)


def _drawn_shape(
    target: DrawnShapes,
    generator: np.random.Generator,
    setting: Setting,
) -> Array:
    """Coordinates (n,) of a shape that a target draws."""
    course = shape_course(target, generator, setting)
    q, _ = course.coordinates(np.zeros(1))
    return q[0]


@register("target", "out_of_reach")
class OutOfReach(DrawnShapes):
    """A pose to hold that the arm cannot reach.

    It is drawn as for "hold", and moved away from the base to `beyond` times the rod's length.
    """

    type: Literal["out_of_reach"] = "out_of_reach"
    beyond: Positive = 1.2

    @property
    def gives_shapes(self) -> bool:
        return False  # no shape has its pose

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        model = setting.model
        shape = _drawn_shape(self, generator, setting)
        pose = model.tip_pose(shape)
        base = np.array(model.scene.base.position)
        away = pose[:3, 3] - base
        distance = self.beyond * model.length
        share = distance / np.linalg.norm(away)
        pose[:3, 3] = base + away * share
        return FixedPose(pose)


@register("target", "steps")
class Steps(DrawnShapes):
    """`count` set points, each for `duration` [s], over and over.

    They are shapes at rest under random tensions within `fraction` of their limits.
    """

    type: Literal["steps"] = "steps"
    duration: Positive = 2.0
    count: int = Field(default=5, ge=2, le=1_000)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        shapes = [_drawn_shape(self, generator, setting) for _ in range(self.count)]
        return Stepped(np.array(shapes), self.duration)


class Stepped(ShapeCourse):
    """Shapes (k, n) that are held one after another, over and over."""

    def __init__(self, held: Array, duration: float) -> None:
        self._held = held
        self._duration = duration

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        # times are whole control periods up to round-off, which should not fall below a border
        intervals = times / self._duration + 1e-9
        steps = np.floor(intervals).astype(int)
        places = steps % len(self._held)
        q = self._held[places]
        return q, np.zeros_like(q)


@register("target", "circle")
class Circle(Target):
    """The tip runs along a circle across the base's x axis, its own x axis leaning outward.

    It is the task of the paper's Section IV-B.

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
        length = setting.arms.model.length
        base_pose = setting.model.scene.base.pose
        return CircleCourse(self, length, base_pose)


class CircleCourse(PoseCourse):
    """Poses along a circle, and their body twists.

    These follow from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx turns about x.
    """

    def __init__(
        self,
        circle: Circle,
        length: float = 1.0,
        base: Array | None = None,
    ) -> None:
        """Place a circle.

        Args:
            circle: its numbers.
            length: [m] of the rod, by default of the paper's.
            base: its pose (4, 4), by default the world's origin.
        """
        if base is None:
            base = np.eye(4)
        self.circle = circle
        self._axes = base[:3, :3]
        if circle.radius is None:
            self.radius = 0.25 * length
        else:
            self.radius = circle.radius
        if circle.centre is None:
            forward = 0.95 * length * base[:3, 0]
            self.centre = base[:3, 3] + forward
        else:
            self.centre = np.array(circle.centre)

    def sample(self, times: Array) -> TargetSamples:
        rate = 2.0 * np.pi / self.circle.period
        time = np.mod(times, self.circle.period)
        angle = rate * time
        c = np.cos(angle)
        s = np.sin(angle)
        none = np.zeros_like(times)
        # in the base's frame: its x axis, from the centre to the tip, and along the circle
        ahead = np.array([1.0, 0.0, 0.0])
        outward_parts = [none, c, s]
        outward = np.stack(outward_parts, axis=-1)
        across_parts = [none, -s, c]
        across = np.stack(across_parts, axis=-1)
        R = self._rotation(
            c[:, None],
            s[:, None],
            ahead,
            outward,
            across,
        )
        # the body twist in the tip's own frame
        velocity = rate * self.radius * across
        turn = R[:, 0] - ahead
        angular = rate * turn
        products = R * velocity[:, :, None]
        linear = products.sum(axis=1)
        twist = np.concatenate([angular, linear], axis=1)
        shape = (times.size, 1, 1)
        pose = np.tile(np.eye(4), shape)
        pose[:, :3, :3] = self._axes @ R
        circle = self.radius * outward
        around = circle @ self._axes.T
        pose[:, :3, 3] = self.centre + around
        return pose_samples(pose, twist)

    def _rotation(
        self,
        c: Array,
        s: Array,
        ahead: Array,
        outward: Array,
        across: Array,
    ) -> Array:
        """Orientations (m, 3, 3) of the tip in the base's frame, by cosines and sines (m, 1)."""
        lean = np.radians(self.circle.tilt)
        c_lean = np.cos(lean)
        s_lean = np.sin(lean)
        first = c_lean * ahead + s_lean * outward
        radial = c_lean * outward - s_lean * ahead
        # no roll: the axes of the base, carried by the shortest turn
        second = c * radial - s * across
        third = s * radial + c * across
        columns = [first, second, third]
        return np.stack(columns, axis=-1)


@register("target", "circles")
class Circles(Target):
    """A circle that every episode draws, see `Circle`.

    It has ranges of its `radius` and of the `distance` of its centre from the base, both in lengths
    of the rod, of `tilt` [degrees] and `period` [s]. The paper's arm can hold the positions of most
    and the orientations of few.
    """

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
        radius = drawn(self.radius, generator)
        distance = drawn(self.distance, generator)
        tilt = drawn(self.tilt, generator)
        period = drawn(self.period, generator)
        length = setting.arms.model.length
        base = setting.model.scene.base.pose
        forward = distance * length * base[:3, 0]
        centre = base[:3, 3] + forward
        circle = Circle(
            radius=radius * length,
            centre=tuple(centre.tolist()),
            tilt=tilt,
            period=period,
        )
        return CircleCourse(circle, length, base)


@register("target", "either")
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
        periods = [target.repeats for target in self.of if target.repeats is not None]
        return max(periods, default=None)

    @property
    def kinds(self) -> int:
        return len(self.of)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        drawn_number = generator.integers(len(self.of))
        number = int(drawn_number)
        return self.of[number].draw(generator, setting)


@register("target", "ramp")
class Ramp(GivenShapes):
    """From rest to static tensions within `duration` [s], then held.

    It is the task of the paper's Section IV-A. `tension` (n_a) [N], by default random ones within
    `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    begins_at_rest: ClassVar[bool] = True

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        def rise(points: Array) -> Rise:
            return Rise(setting.tension, points[0], self.duration)

        return shape_course(self, generator, setting, rise)


class Rise(Tensions):
    """Tensions that go from `start` to `end` along a polynomial.

    It is that of least degree that is twice differentiable.
    """

    def __init__(
        self,
        start: Array,
        end: Array,
        duration: float,
    ) -> None:
        self.start = start
        self.change = end - start
        self.duration = duration
        self.knots = np.linspace(0.0, duration, 5)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        share = self.within(times) / self.duration
        x = share[:, None]
        factor = 10.0 + x * (6.0 * x - 15.0)
        part = x * x * x * factor
        left = 1.0 - x
        rate_of_share = 30.0 * x * x * left * left
        rate = rate_of_share / self.duration
        change = part * self.change
        value = self.start + change
        value_rate = rate * self.change
        return value, value_rate


@register("target", "random")
class Random(DrawnShapes):
    """A smooth random motion: tensions along a closed cubic B-spline.

    Its control points are random tensions within `fraction` of their limits, one about every
    `knot_period` [s], which may be a range; at least 4 of them fill the `period` [s], after which
    the motion repeats.
    """

    type: Literal["random"] = "random"
    knot_period: Amount = 1.0
    period: Positive = 10.0

    @model_validator(mode="after")
    def _enough_knots(self) -> "Random":
        least = self.period / MOST_KNOTS
        greatest = self.period / 4
        shortest = np.min(self.knot_period)
        longest = np.max(self.knot_period)
        if not least <= shortest <= longest <= greatest:
            if isinstance(self.knot_period, tuple):
                number = shown(self.knot_period)
            else:
                number = f"{self.knot_period:g}"
            text = (
                f"is {number}: it should be {least:g} to {greatest:g} s, for 4 to {MOST_KNOTS} in a"
                f" period of {self.period:g} s"
            )
            raise ConfigurationError([Problem(("knot_period",), text)])
        return self

    @property
    def repeats(self) -> float:
        return self.period

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        def spline(points: Array) -> ClosedSpline:
            return ClosedSpline(points, self.period)

        knot_period = drawn(self.knot_period, generator)
        count = round(self.period / knot_period)
        return shape_course(
            self,
            generator,
            setting,
            spline,
            count,
        )


class ClosedSpline(Tensions):
    """A closed uniform cubic B-spline, which stays within the bounds of its points (k, n_a)."""

    is_closed = True

    def __init__(self, points: Array, period: float) -> None:
        self.points = points
        self.period = period
        knot_count = len(points) + 1
        self.knots = np.linspace(0.0, period, knot_count)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        count = len(self.points)
        share = self.within(times) / self.period
        place = share * count
        first = np.floor(place).astype(int)
        # shares of the way from one knot to the next, and the rest of it
        f = place - first
        g = 1.0 - f
        # weights of the four points about a place, and their rates
        sixfold_weights = [
            g * g * g,
            4.0 - 6.0 * f * f + 3.0 * f * f * f,
            4.0 - 6.0 * g * g + 3.0 * g * g * g,
            f * f * f,
        ]
        weights = np.stack(sixfold_weights) / 6.0
        doubled_slopes = [
            -g * g,
            3.0 * f * f - 4.0 * f,
            4.0 * g - 3.0 * g * g,
            f * f,
        ]
        factor = 0.5 * count / self.period
        slopes = np.stack(doubled_slopes) * factor
        next_numbers = first + np.arange(4)[:, None]
        numbers = next_numbers % count
        near = self.points[numbers]
        weighted = weights[:, :, None] * near
        tension = weighted.sum(axis=0)
        weighted_slopes = slopes[:, :, None] * near
        rate = weighted_slopes.sum(axis=0)
        return tension, rate
