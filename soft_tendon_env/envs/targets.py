"""Target motions: what the arm is asked to do, drawn anew for every episode.

A target is a configuration class with a `draw` that settles what is random and returns a `Course`: the motion as a function of time,
bit for bit the same whatever other times are asked for with it. Targets made of tensions are pushed through the statics, so that the
arm can hold every one of their shapes: tensions that are given and cannot be held are refused, drawn ones are halved.
To add a target, add its class here and name it in `Target`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator
from scipy.interpolate import CubicSpline

from soft_tendon_env.envs.arms import Arms
from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.scene import Array, Positive
from soft_tendon_env.tools.checks import checked_array, shown_numbers
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, shown

FARTHEST = 1e6
"""Largest coordinate [m] of a target: a thousand kilometres, whose square is a number still."""
MOST_KNOTS = 10_000
"""Points that a random motion can be drawn with."""
HALVINGS = 40
"""How often drawn tensions that the arm cannot hold are halved."""
MARGIN = 1.03
"""Part of a drawn motion's coordinates that should have strains too: it may reach farther between places where they are looked for."""
LOOKS = 4
"""Places per knot at which strains are looked for along a motion."""
BETWEEN = 1.7e-4
"""Angle [rad] by which a spline through equilibria may be off those between two of them: it moves the tip by at most 1 / sqrt(3) of that,
a cantilever's under its end load, so by 1e-4 of the length."""
NEAR = 1e-2
"""Angle [rad] up to which an equilibrium counts as the one that was expected between two others."""
REFINEMENTS = 10
"""How often intervals between equilibria are halved before a motion counts as one that jumps."""

Distance = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]


class Setting(NamedTuple):
    """What targets are drawn for."""

    arms: Arms
    limits: Array  # (n_a, 2) [N]
    response: Array  # (n_a, n) that makes tensions the coordinates in which they hold the unloaded arm, to first order
    is_exact: bool  # whether that is so for all tensions, and no load comes to them: (34), without effects
    metric: Array  # (n, n) that makes changes of coordinates vectors whose length is the angle [rad] by which as much energy bends the arm


def make_setting(arms: Arms, limits: Array) -> Setting:
    """The setting of these arms."""
    model, is_implicit = arms.model, isinstance(arms.model.arm.strain, StaticsBased)
    unloaded = model.terms(np.zeros(model.coordinate_count), np.zeros(model.coordinate_count))
    if is_implicit:
        response = np.stack([model.rest_coordinates(unit) for unit in np.eye(model.tendon_count)])
    else:
        response = np.asarray(np.linalg.solve(unloaded.stiffness, unloaded.actuation).T, dtype=np.float64)
    metric = np.asarray(np.linalg.cholesky(unloaded.stiffness / model.bending_energy), dtype=np.float64)
    return Setting(arms, limits, response, is_implicit and not model.arm.effects, metric)


class NotHeld(ArithmeticError):
    """Tensions (n_a,) [N] along a motion that the arm cannot hold; the message says why, which is found out when it is asked for."""

    def __init__(self, tension: Array, reason: Callable[[], str]) -> None:
        super().__init__(tension)
        self._tension, self._reason = tension, reason

    def __str__(self) -> str:
        return f"{shown_numbers(self._tension)} N: {self._reason()}"


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
    radius: float = Field(default=0.25, gt=0, le=FARTHEST)
    centre: tuple[Distance, Distance, Distance] = (0.95, 0.0, 0.0)
    tilt: float = Field(default=37.8, ge=-90, le=90)
    period: Positive = 4.0

    @property
    def is_random(self) -> bool:
        """Whether episodes differ in it."""
        return False

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode."""
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
            R, r = g[:3, :3], g[:3, 3]
            is_rotation = np.abs(R).max() < 1.1 and np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0
            if not (is_rotation and (g[3] == [0, 0, 0, 1]).all() and np.abs(r).max() <= FARTHEST):
                allowed = f"a homogeneous matrix [[R, r], [0, 0, 0, 1]] with a rotation R and coordinates r within ±{FARTHEST:g} m"
                raise ConfigurationError([Problem(("pose",), f"is {shown(g.tolist())}: it should be {allowed}")])
        return self

    @property
    def is_random(self) -> bool:
        """Whether episodes differ in it."""
        return self.tension is None and self.pose is None

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm cannot hold the tensions."""
        if self.pose is not None:
            return FixedPose(np.array(self.pose))
        if self.tension is not None:
            return _given(self.tension, setting, Constant)
        return _drawn(1, self.fraction, generator, setting, lambda points: Constant(points[0]))


class Random(Configuration):
    """A smooth random motion: tensions along a closed cubic B-spline with a random point within `fraction` of their limits every
    `knot_period` [s], or a little less or more to make them a whole number of at least 4; it repeats after `period` [s]."""

    type: Literal["random"] = "random"
    fraction: float = Field(default=0.25, gt=0, le=1)
    knot_period: Positive = 1.0
    period: Positive = 10.0

    @model_validator(mode="after")
    def _enough_knots(self) -> "Random":
        if not 4 * self.knot_period <= self.period <= MOST_KNOTS * self.knot_period:
            allowed = f"{self.period / MOST_KNOTS:g} to {self.period / 4:g} s, for 4 to {MOST_KNOTS} in a period of {self.period:g} s"
            raise ConfigurationError([Problem(("knot_period",), f"is {self.knot_period:g}: it should be {allowed}")])
        return self

    @property
    def is_random(self) -> bool:
        """Whether episodes differ in it."""
        return True

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm can hold none."""
        count = round(self.period / self.knot_period)
        return _drawn(count, self.fraction, generator, setting, lambda points: ClosedSpline(points, self.period))


class Ramp(Configuration):
    """From rest to static tensions within `duration` [s], then held: the task of the paper's Section IV-A.

    `tension` (n_a) [N], by default random ones within `fraction` of their limits.
    """

    type: Literal["ramp"] = "ramp"
    duration: Positive = 2.5
    tension: tuple[float, ...] | None = None
    fraction: float = Field(default=0.25, gt=0, le=1)

    @property
    def is_random(self) -> bool:
        """Whether episodes differ in it."""
        return self.tension is None

    def draw(self, generator: np.random.Generator, setting: Setting) -> Course:
        """The motion of one episode. Raises ConfigurationError where the arm cannot hold the tensions, or those on the way."""
        start = nearest_to_zero(setting.limits)
        if self.tension is not None:
            return _given(self.tension, setting, lambda end: Rise(start, end, self.duration))
        return _drawn(1, self.fraction, generator, setting, lambda points: Rise(start, points[0], self.duration))


Target = Annotated[Circle | Hold | Random | Ramp, Field(discriminator="type")]


def nearest_to_zero(limits: Array) -> Array:
    """The tensions (n_a,) within limits (n_a, 2) that are nearest to zero."""
    return np.clip(0.0, limits[:, 0], limits[:, 1])


def _given(tension: tuple[float, ...], setting: Setting, motion: "Callable[[Array], Tensions]") -> "StaticCourse":
    """The course of a motion that given tensions make."""
    try:
        return StaticCourse(setting, motion(checked_array("target.tension", tension, (setting.arms.model.tendon_count,))))
    except NotHeld as error:
        text = f"is {shown(tension)}: it should be tensions that the arm can hold, not {error}"
        raise ConfigurationError([Problem(("target", "tension"), text)], "environment") from error


def _drawn(
    count: int, fraction: float, generator: np.random.Generator, setting: Setting, motion: "Callable[[Array], Tensions]"
) -> "StaticCourse":
    """The course of a motion that drawn tensions (count, n_a) make.

    They are uniform within a fraction of their limits around those nearest to zero, and halved towards these until the arm holds
    them: one draw, so that whatever is drawn next is the same for every arm.
    """
    middle = nearest_to_zero(setting.limits)
    reach = fraction * (setting.limits - middle[:, None])
    offset = generator.uniform(reach[:, 0], reach[:, 1], (count, middle.size))
    for halvings in range(HALVINGS + 1):
        part = 0.5**halvings
        try:
            return StaticCourse(setting, motion(middle + part * offset), is_drawn=True)
        except NotHeld as error:
            last = error
    text = f"is {fraction:g}: none of the tensions drawn, down to 1e-12 of it, is one that the arm can hold, not {last}"
    raise ConfigurationError([Problem(("target", "fraction"), text)], "environment")


class CircleCourse(PoseCourse):
    """The circle; its body twist follows from R(a) = Rx(a) R(0) Rx(-a), with a the angle and Rx turns about x."""

    def __init__(self, circle: Circle) -> None:
        self.circle = circle

    def sample(self, times: Array) -> Samples:
        rate = 2.0 * np.pi / self.circle.period
        angle = rate * np.mod(times, self.circle.period)
        c, s = np.cos(angle), np.sin(angle)
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


class Tensions(ABC):
    """Tensions as a function of time.

    knots: times (k,) [s] between which the motion is smooth, from its beginning at 0 to its end or to where it repeats.
    """

    knots: Array
    is_closed = False

    @abstractmethod
    def within(self, times: Array) -> Array:
        """The times (m,) between the first and the last knot at which the motion is what it is at `times`."""

    @abstractmethod
    def __call__(self, times: Array) -> tuple[Array, Array]:
        """Tensions [N] and their rates [N/s] at times (m,) [s], (m, n_a) each."""


class Constant(Tensions):
    """Tensions, or coordinates, that stay: `value`."""

    def __init__(self, value: Array) -> None:
        self.value, self.knots = value, np.zeros(1)

    def within(self, times: Array) -> Array:
        return 0.0 * times

    def __call__(self, times: Array) -> tuple[Array, Array]:
        return np.tile(self.value, (times.size, 1)), np.zeros((times.size, self.value.size))


class Rise(Tensions):
    """Tensions that go from `start` to `end` with the polynomial of least degree that is twice differentiable."""

    def __init__(self, start: Array, end: Array, duration: float) -> None:
        self.start, self.change, self.duration = start, end - start, duration
        self.knots = np.linspace(0.0, duration, 5)

    def within(self, times: Array) -> Array:
        return np.clip(times, 0.0, self.duration)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        x = (self.within(times) / self.duration)[:, None]
        part = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        rate = 30.0 * x * x * (1.0 - x) * (1.0 - x) / self.duration
        return self.start + part * self.change, rate * self.change


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
        near = [self.points[(index + j) % count] for j in range(4)]
        value = sum(w * p for w, p in zip(weights, near, strict=True)) / 6.0
        slope = sum(w * p for w, p in zip(slopes, near, strict=True)) * (count / (6.0 * self.period))
        return np.asarray(value), np.asarray(slope)


class StaticCourse(ShapeCourse):
    """Tensions pushed through the statics: at every time the shape in which they hold the arm.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions themselves (34). Otherwise they are
    a cubic spline through equilibria.
    """

    def __init__(self, setting: Setting, tension: Tensions, is_drawn: bool = False) -> None:
        """is_drawn: it could as well be another motion, and should keep clear of what the arm cannot hold. Raises NotHeld."""
        model, response = setting.arms.model, Response(tension, setting.response)
        self._tension = tension
        self._motion: Response | Constant | EquilibriumSpline
        if isinstance(tension, Constant) and not (is_drawn and setting.is_exact):
            self._motion = Constant(_rest(model, tension.value))
        elif setting.is_exact:
            self._motion = response
        else:
            self._motion = EquilibriumSpline(model, setting.metric, response)
        if is_drawn or not isinstance(tension, Constant):
            self._check(setting, MARGIN if is_drawn else 1.0)

    def _check(self, setting: Setting, margin: float) -> None:
        """Raises NotHeld where the motion, with its coordinates this much larger, comes near to where strains end."""
        times = _subdivided(self._tension.knots, LOOKS)
        for time in times[~setting.arms.are_firm(margin * self._motion(times)[0])][:1]:
            raise _giving_way(setting.arms.model, self._tension(np.array([time]))[0][0])

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        return self._motion(times)


class Response:
    """Coordinates as a function of time that are tensions mapped by `matrix` (n_a, n)."""

    def __init__(self, tension: Tensions, matrix: Array) -> None:
        self.tension, self.matrix = tension, matrix

    def __call__(self, times: Array) -> tuple[Array, Array]:
        u, u_dot = self.tension(times)
        return self._mapped(u), self._mapped(u_dot)

    def _mapped(self, values: Array) -> Array:
        """values (m, n_a) @ matrix, row by row: a product of matrices rounds a row otherwise when others stand beside it."""
        mapped = np.zeros((len(values), self.matrix.shape[1]))
        for column, row in zip(values.T, self.matrix, strict=True):
            mapped += column[:, None] * row
        return mapped


def _giving_way(model: Model, tension: Array) -> NotHeld:
    return NotHeld(tension, lambda: static_equilibrium(model, tension).reason or "the section is about to give way")


def _rest(model: Model, tension: Array) -> Array:
    """Coordinates (n,) in which tensions (n_a,) hold the arm. Raises NotHeld."""
    found = static_equilibrium(model, tension)
    if not found.converged:
        raise NotHeld(tension, lambda: found.reason)
    return found.q


def _subdivided(knots: Array, parts: int) -> Array:
    """Times of which `parts` to an interval lie evenly between knots (k,), the knots among them."""
    return np.interp(np.arange(parts * (knots.size - 1) + 1) / parts, np.arange(knots.size), knots)


class EquilibriumSpline:
    """Coordinates as a function of time: the equilibria under tensions that change with time, by a cubic spline through what loads add
    to the response to the tensions.

    At the knots they are those where a slowly loaded arm goes. In the middle between two knots an equilibrium is looked for near the
    spline and becomes a knot itself, until the spline through all of them is off those between by no more than BETWEEN. Where that
    does not come to an end the arm jumps from one shape to another under tensions that hardly differ.
    """

    def __init__(self, model: Model, metric: Array, response: Response) -> None:
        """metric: see Setting. Raises NotHeld where there are no equilibria, or where they jump."""
        tension = response.tension
        self._response, self._tension, self._duration = response, tension, float(tension.knots[-1])
        times = tension.knots
        q = np.stack([_rest(model, u) for u in tension(times[: times.size - tension.is_closed])[0]])
        q = np.concatenate([q, q[:1]]) if tension.is_closed else q
        rough, tolerance = np.ones(times.size - 1, dtype=bool), 16.0 * BETWEEN  # the error falls with the fourth power of an interval
        for _ in range(REFINEMENTS):
            self._pass_through(times, q)
            place = np.flatnonzero(rough)
            middles, found = 0.5 * (times[place] + times[place + 1]), []
            expected = self(middles)[0]
            for u, near in zip(tension(middles)[0], expected, strict=True):
                beside = static_equilibrium(model, u, near)
                is_near = beside.converged and np.linalg.norm((beside.q - near) @ metric) <= NEAR
                found.append(beside.q if is_near else _rest(model, u))
            astray = np.linalg.norm((np.stack(found) - expected) @ metric, axis=1)
            times, q = np.insert(times, place + 1, middles), np.insert(q, place + 1, found, axis=0)
            rough[place] = astray > tolerance
            tolerance = 4.0 * BETWEEN  # but perhaps not where it was large
            if not rough.any():
                self._pass_through(times, q)
                return
            rough = np.insert(rough, place, rough[place])  # both halves of each
            rough = rough | np.roll(rough, 1) | np.roll(rough, -1)  # and those beside them, where the spline was shaped by what was rough
        worst = middles[[np.argmax(astray)]]
        jump = f"the arm jumps from one shape to another near there, {worst[0]:.4g} s into the motion"
        raise NotHeld(tension(worst)[0][0], lambda: jump)

    def _pass_through(self, times: Array, q: Array) -> None:
        """Make the spline pass through q (k, n) at times (k,)."""
        added, ends = q - self._response(times)[0], "clamped"
        if self._tension.is_closed:
            added[-1], ends = added[0], "periodic"  # which differ by round-off
        self._spline = CubicSpline(times / self._duration, added, bc_type=ends)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        place = self._tension.within(times) / self._duration
        moves = self._tension.is_closed | ((times > 0.0) & (times < self._duration))
        q, q_dot = self._response(times)
        return q + self._spline(place), q_dot + self._spline(place, 1) * (moves / self._duration)[:, None]


DEFAULTS: dict[str, Circle | Hold | Random | Ramp] = {"circle": Circle(), "hold": Hold(), "random": Random(), "ramp": Ramp()}
"""The targets as their names alone give them."""
