"""What the arm is asked to do: target motions, drawn anew for every episode.

A target is a configuration class with a `draw` that settles what is random and returns a `Course`: the motion as a function of time.
Targets made of tensions are pushed through the statics, so that the arm can hold every one of their shapes.
To add a target, add its class here and name it in `Target`.
"""

from collections.abc import Callable
from typing import Annotated, Literal, NamedTuple, Protocol

import numpy as np
from pydantic import Field, model_validator
from scipy.interpolate import CubicSpline

from soft_tendon_env.checks import checked_array
from soft_tendon_env.configuration import Configuration
from soft_tendon_env.envs.arms import motion_reading
from soft_tendon_env.mechanics.rows import Places
from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.model import Model
from soft_tendon_env.scene import Array, Positive
from soft_tendon_env.statics import static_equilibrium

SHRINKINGS = 20
"""How often drawn tensions that no strain balances are halved."""


class Setting(NamedTuple):
    """What targets are drawn for."""

    model: Model
    places: Places
    limits: Array  # (n_a, 2) [N]
    rest: Array  # (n,) where the arm rests under the tensions nearest to zero


class Samples(NamedTuple):
    """A target at m times. Targets that are poses alone have coordinates, lengths and backbone of size 0."""

    tip_pose: Array  # (m, 4, 4)
    tip_twist: Array  # (m, 6) body twist
    q: Array  # (m, n)
    tendon_length: Array  # (m, n_a)
    backbone: Array  # (m, stations, 4, 4)


class Course(Protocol):
    """A target motion; the same times give the same samples."""

    def sample(self, times: Array) -> Samples: ...


class Circle(Configuration):
    """The tip runs along a circle parallel to the y-z plane, its x axis leaning outward: the task of the paper's Section IV-B.

    `radius` [m], `centre` [m], `tilt` [degrees]; `period` [s] of one turn, which the paper does not give.
    """

    type: Literal["circle"] = "circle"
    radius: Positive = 0.25
    centre: tuple[float, float, float] = (0.95, 0.0, 0.0)
    tilt: float = Field(default=37.8, ge=-90, le=90)
    period: Positive = 4.0

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        return CircleCourse(self)


class Hold(Configuration):
    """One pose to reach and hold: the pose at which `tension` (n_a) [N] holds the arm, a given `pose` (4 x 4), or by default one
    from random tensions within `fraction` of their limits."""

    type: Literal["hold"] = "hold"
    tension: tuple[float, ...] | None = None
    pose: tuple[tuple[float, float, float, float], ...] | None = Field(default=None, min_length=4, max_length=4)
    fraction: float = Field(default=0.25, gt=0, le=1)

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        if self.pose is not None:
            if self.tension is not None:
                raise ValueError("should give tension or pose, not both")
            g = np.array(self.pose)
            if not (np.allclose(g[:3, :3] @ g[:3, :3].T, np.eye(3), atol=1e-6) and np.linalg.det(g[:3, :3]) > 0 and (g[3] == [0, 0, 0, 1]).all()):
                raise ValueError("pose should be a homogeneous matrix [[R, r], [0, 0, 0, 1]] with a rotation R")
        return self

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        if self.pose is not None:
            return FixedPose(np.array(self.pose))
        return StaticCourse(setting, Constant(_given_or_drawn(self.tension, self.fraction, generator, setting)))


class Random(Configuration):
    """A smooth random motion: tensions along a closed cubic B-spline with a random point within `fraction` of their limits every
    `knot_period` [s]; it repeats after `period` [s]."""

    type: Literal["random"] = "random"
    fraction: float = Field(default=0.25, gt=0, le=1)
    knot_period: Positive = 1.0
    period: Positive = 10.0

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        count = max(4, round(self.period / self.knot_period))
        points = np.stack([_drawn(self.fraction, generator, setting) for _ in range(count)])
        return StaticCourse(setting, ClosedSpline(points, self.period))


class Ramp(Configuration):
    """From rest to static tensions within `duration` [s], then held: the task of the paper's Section IV-A.

    `tension` (n_a) [N], by default random ones within `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    tension: tuple[float, ...] | None = None
    fraction: float = Field(default=0.25, gt=0, le=1)

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        end = _given_or_drawn(self.tension, self.fraction, generator, setting)
        return StaticCourse(setting, Rise(nearest_to_zero(setting.limits), end, self.duration))


Target = Annotated[Circle | Hold | Random | Ramp, Field(discriminator="type")]


def nearest_to_zero(limits: Array) -> Array:
    """The tensions (n_a,) within limits (n_a, 2) that are nearest to zero."""
    return np.clip(0.0, limits[:, 0], limits[:, 1])


def _drawn(fraction: float, generator: np.random.Generator, setting: Setting) -> Array:
    """Tensions (n_a,) that a strain balances, uniformly within a fraction of their limits around those nearest to zero."""
    middle = nearest_to_zero(setting.limits)
    reach = fraction * (setting.limits - middle[:, None])
    offset = generator.uniform(reach[:, 0], reach[:, 1])
    if isinstance(setting.model.arm.strain, StaticsBased):
        for _ in range(SHRINKINGS):
            q = setting.model.rest_coordinates(middle + offset)[None]
            if motion_reading(setting.model, setting.places, q, 0.0 * q)[1]:
                break
            offset = 0.5 * offset
    return middle + offset


def _given_or_drawn(tension: tuple[float, ...] | None, fraction: float, generator: np.random.Generator, setting: Setting) -> Array:
    if tension is None:
        return _drawn(fraction, generator, setting)
    return checked_array("target.tension", tension, (setting.model.tendon_count,))


class CircleCourse:
    """The circle; its body twist follows from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx turns about x."""

    def __init__(self, circle: Circle) -> None:
        self.circle = circle

    def sample(self, times: Array) -> Samples:
        rate = 2.0 * np.pi / self.circle.period
        c, s = np.cos(rate * times), np.sin(rate * times)
        lean = np.radians(self.circle.tilt)
        outward = np.stack([0.0 * c, c, s], axis=-1)
        x_axis = np.cos(lean) * np.array([1.0, 0.0, 0.0]) + np.sin(lean) * outward
        radial = np.cos(lean) * outward - np.sin(lean) * np.array([1.0, 0.0, 0.0])
        across = np.stack([0.0 * c, -s, c], axis=-1)
        pose = np.tile(np.eye(4), (times.size, 1, 1))
        pose[:, :3, 0] = x_axis
        pose[:, :3, 1] = c[:, None] * radial - s[:, None] * across  # no roll: the axes of the base, carried by the shortest turn
        pose[:, :3, 2] = s[:, None] * radial + c[:, None] * across
        pose[:, :3, 3] = np.array(self.circle.centre) + self.circle.radius * outward
        rotation = pose[:, :3, :3]
        angular = rate * (rotation[:, 0, :] - np.array([1.0, 0.0, 0.0]))
        linear = (rotation * (rate * self.circle.radius * across)[:, :, None]).sum(axis=1)
        return _poses_alone(pose, np.concatenate([angular, linear], axis=1))


class FixedPose:
    """A pose that stays."""

    def __init__(self, pose: Array) -> None:
        self.pose = pose

    def sample(self, times: Array) -> Samples:
        return _poses_alone(np.tile(self.pose, (times.size, 1, 1)), np.zeros((times.size, 6)))


def _poses_alone(pose: Array, twist: Array) -> Samples:
    m = len(pose)
    return Samples(pose, twist, np.empty((m, 0)), np.empty((m, 0)), np.empty((m, 0, 4, 4)))


class Constant:
    """Tensions that stay."""

    def __init__(self, tension: Array) -> None:
        self.tension = tension
        self.knots, self.period = np.array([0.0]), None

    def __call__(self, times: Array) -> tuple[Array, Array]:
        return np.tile(self.tension, (times.size, 1)), np.zeros((times.size, self.tension.size))


class Rise:
    """Tensions that go from `start` to `end` with the polynomial of least degree that is twice differentiable."""

    def __init__(self, start: Array, end: Array, duration: float) -> None:
        self.start, self.change, self.duration = start, end - start, duration
        self.knots, self.period = np.linspace(0.0, duration, 9), None

    def __call__(self, times: Array) -> tuple[Array, Array]:
        x = np.clip(times / self.duration, 0.0, 1.0)[:, None]
        part = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / self.duration
        return self.start + part * self.change, rate * self.change


class ClosedSpline:
    """A closed uniform cubic B-spline with control points (k, n_a): it stays within their bounds."""

    def __init__(self, points: Array, period: float) -> None:
        self.points, self.period = points, period
        self.knots = np.linspace(0.0, period, 2 * len(points) + 1)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        count = len(self.points)
        place = times / self.period * count
        first = np.floor(place)
        f, index = (place - first)[:, None], first.astype(int)
        g = 1.0 - f
        weights = (g * g * g, 4.0 - 6.0 * f * f + 3.0 * f * f * f, 4.0 - 6.0 * g * g + 3.0 * g * g * g, f * f * f)
        slopes = (-3.0 * g * g, 9.0 * f * f - 12.0 * f, 12.0 * g - 9.0 * g * g, 3.0 * f * f)
        near = [self.points[(index + j) % count] for j in range(4)]
        value = sum(w * p for w, p in zip(weights, near, strict=True)) / 6.0
        slope = sum(w * p for w, p in zip(slopes, near, strict=True)) * (count / (6.0 * self.period))
        return np.asarray(value), np.asarray(slope)


class StaticCourse:
    """Tensions pushed through the statics.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions themselves (34). Otherwise they are
    a cubic spline through the equilibria at the knots.
    """

    def __init__(self, setting: Setting, tension: Constant | Rise | ClosedSpline) -> None:
        self.setting, self.tension = setting, tension
        exact = isinstance(setting.model.arm.strain, StaticsBased) and not setting.model.arm.effects
        self._coordinates = self._statics if exact else self._through_equilibria()

    def _statics(self, times: Array) -> tuple[Array, Array]:
        rest = np.stack([self.setting.model.rest_coordinates(unit) for unit in np.eye(self.setting.model.tendon_count)])
        u, u_dot = self.tension(times)
        return u @ rest, u_dot @ rest

    def _through_equilibria(self) -> Callable[[Array], tuple[Array, Array]]:
        q, knots, period = [self.setting.rest], self.tension.knots, self.tension.period
        for u in self.tension(knots)[0]:
            found = static_equilibrium(self.setting.model, u, q[-1])
            q.append(found.q if found.converged else q[-1])
        if len(knots) == 1:
            return lambda times: (np.tile(q[-1], (times.size, 1)), np.zeros((times.size, q[-1].size)))
        if period is not None:
            q[-1] = q[1]
        spline = CubicSpline(knots, np.stack(q[1:]), bc_type="clamped" if period is None else "periodic")
        if period is not None:
            return lambda times: (spline(times % period), spline(times % period, 1))
        end = knots[-1]
        return lambda times: (spline(np.minimum(times, end)), spline(np.minimum(times, end), 1) * (times < end)[:, None])

    def sample(self, times: Array) -> Samples:
        q, q_dot = self._coordinates(times)
        reading, good = motion_reading(self.setting.model, self.setting.places, q, q_dot)
        if good < times.size:  # no strain between two knots: wait where there was one
            for values in (q, reading.tip_pose, reading.tendon_length, reading.backbone):
                values[good:] = values[max(good - 1, 0)]
            reading.tip_twist[good:] = 0.0
        return Samples(reading.tip_pose, reading.tip_twist, q, reading.tendon_length, reading.backbone)


DEFAULTS: dict[str, Circle | Hold | Random | Ramp] = {"circle": Circle(), "hold": Hold(), "random": Random(), "ramp": Ramp()}
"""The targets as their names alone give them."""
