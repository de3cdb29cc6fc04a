"""What the arm is asked to do: target motions, drawn anew for every episode.

A target is a configuration class with a `draw` that settles what is random and returns a `Course`: the motion as a function of time.
Targets made of tensions are pushed through the statics, so that the arm can hold every one of their shapes.
To add a target, add its class here and name it in `Target`.
"""

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator
from scipy.interpolate import CubicSpline

from soft_tendon_env.checks import checked_array
from soft_tendon_env.configuration import Configuration
from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.scene import Array, Positive
from soft_tendon_env.statics import static_equilibrium

SHRINKINGS = 20
"""How often drawn tensions that no strain balances are halved."""


class Setting(NamedTuple):
    """What targets are drawn for."""

    arms: Arms
    limits: Array  # (n_a, 2) [N]
    rest: Array  # (n,) where the arm rests under the tensions nearest to zero
    rest_matrix: Array | None  # (n_a, n) that makes tensions the coordinates at rest (34); None where loads or the strain forbid it


def make_setting(arms: Arms, limits: Array, rest: Array) -> Setting:
    """The setting of these arms."""
    model = arms.model
    if model.arm.effects or not isinstance(model.arm.strain, StaticsBased):
        return Setting(arms, limits, rest, None)
    return Setting(arms, limits, rest, np.stack([model.rest_coordinates(unit) for unit in np.eye(model.tendon_count)]))


class Samples(NamedTuple):
    """A target at m times. Targets that are poses alone have coordinates, lengths and backbone of size 0."""

    tip_pose: Array  # (m, 4, 4)
    tip_twist: Array  # (m, 6) body twist
    q: Array  # (m, n)
    tendon_length: Array  # (m, n_a)
    backbone: Array  # (m, stations, 4, 4)


class PoseCourse(ABC):
    """A motion of the tip alone."""

    @abstractmethod
    def sample(self, times: Array) -> Samples:
        """The target at times (m,) [s]."""


class ShapeCourse(ABC):
    """A motion of the whole arm, which its coordinates describe."""

    @abstractmethod
    def coordinates(self, times: Array) -> tuple[Array, Array]:
        """q and q_dot, (m, n) each, at times (m,) [s]."""


Course = PoseCourse | ShapeCourse


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

    @field_validator("pose", mode="before")
    @classmethod
    def _rows(cls, pose: Any) -> Any:
        return tuple(tuple(row) if isinstance(row, list) else row for row in pose) if isinstance(pose, tuple) else pose

    @model_validator(mode="after")
    def _one_of(self) -> "Hold":
        if self.pose is not None:
            if self.tension is not None:
                raise ValueError("should give tension or pose, not both")
            g = np.array(self.pose)
            R = g[:3, :3]
            if not (np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0 and (g[3] == [0, 0, 0, 1]).all()):
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
        return StaticCourse(setting, ClosedSpline(_drawn(count, self.fraction, generator, setting), self.period))


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


def _drawn(count: int, fraction: float, generator: np.random.Generator, setting: Setting) -> Array:
    """Tensions (count, n_a), uniform within a fraction of their limits around those nearest to zero; halved until strains balance them."""
    middle = nearest_to_zero(setting.limits)
    reach = fraction * (setting.limits - middle[:, None])
    offset = generator.uniform(reach[:, 0], reach[:, 1], (count, middle.size))
    if setting.rest_matrix is not None:
        for _ in range(SHRINKINGS):
            q = (middle + offset) @ setting.rest_matrix
            if setting.arms.read_motions(q[None], 0.0 * q[None], 0.0)[1] == count:
                break
            offset = 0.5 * offset
    return np.asarray(middle + offset)


def _given_or_drawn(tension: tuple[float, ...] | None, fraction: float, generator: np.random.Generator, setting: Setting) -> Array:
    if tension is None:
        return _drawn(1, fraction, generator, setting)[0]
    return checked_array("target.tension", tension, (setting.arms.model.tendon_count,))


class CircleCourse(PoseCourse):
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


class FixedPose(PoseCourse):
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
        self.knots, self.period = np.array([0.0, 1.0]), None

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


class StaticCourse(ShapeCourse):
    """Tensions pushed through the statics.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions themselves (34). Otherwise they are
    a cubic spline through the equilibria at the knots.
    """

    def __init__(self, setting: Setting, tension: Constant | Rise | ClosedSpline) -> None:
        self._tension, self._matrix = tension, setting.rest_matrix
        self._spline = _through_equilibria(setting, tension) if self._matrix is None else None

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        if self._spline is not None:
            end, period = self._tension.knots[-1], self._tension.period
            within = np.minimum(times, end) if period is None else times % period
            moving = np.ones(times.size) if period is not None else (times < end).astype(np.float64)
            return self._spline(within), self._spline(within, 1) * moving[:, None]
        assert self._matrix is not None
        u, u_dot = self._tension(times)
        return u @ self._matrix, u_dot @ self._matrix


def _through_equilibria(setting: Setting, tension: Constant | Rise | ClosedSpline) -> CubicSpline:
    """Coordinates as a function of time, through the equilibria at the knots."""
    q = [setting.rest]
    for u in tension(tension.knots)[0]:
        found = static_equilibrium(setting.arms.model, u, q[-1])
        q.append(found.q if found.converged else q[-1])
    if tension.period is None:
        return CubicSpline(tension.knots, np.stack(q[1:]), bc_type="clamped")
    return CubicSpline(tension.knots, np.stack([*q[1:-1], q[1]]), bc_type="periodic")


DEFAULTS: dict[str, Circle | Hold | Random | Ramp] = {"circle": Circle(), "hold": Hold(), "random": Random(), "ramp": Ramp()}
"""The targets as their names alone give them."""
