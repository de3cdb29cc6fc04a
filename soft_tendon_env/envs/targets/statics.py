"""Quasi-static trajectories: the shapes in which tensions that change with time hold the arm at
rest."""

from collections.abc import Callable
from functools import partial

import numpy as np

from soft_tendon_env.envs.targets import DrawnShapes, Setting, ShapeCourse, drawn
from soft_tendon_env.mechanics.workspace import Workspace
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import LoadPath
from soft_tendon_env.model.statics import rests_at_tensions, static_equilibrium
from soft_tendon_env.model.tension_limits import warn_beyond_limits
from soft_tendon_env.tools.checks import shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array

HALVINGS = 40  # how often drawn tensions that the arm cannot hold are halved
# part of a drawn motion's coordinates that should have strains too: it may reach farther between
# places
MARGIN = 1.03
# how far forces may be off between the places of a spline, see `At.residual`; usual motions have
# 1e-6 to 5e-5
BETWEEN = 2e-4
PER_KNOT = 4
"""Places per knot of the tensions at which a motion is looked at. The spline through four
equilibria moves the tip of a loaded arm by up to 1e-4 of its length off those between, through two
by up to 2e-3."""
NEAR, CLOSE = 0.2, 0.01
"""Angles [rad] from where an equilibrium is expected: within which it is taken, else tensions
change by half as much at a time; and within which one that is not stable is the end."""
SAME = 1e-6  # angle [rad] between shapes that count as one
SHORTER = 8  # how often changes of tensions are halved before the arm is said to jump
JUMPS = "the arm jumps from one shape to another near there"


class NoEquilibrium(ArithmeticError):
    """Tensions (n_a,) [N] that the arm cannot hold, and why."""

    def __init__(self, tension: Array, reason: str) -> None:
        super().__init__(f"{shown_numbers(tension)} N: {reason}")


class Tensions:
    """Tensions as a function of time; by itself, tensions that stay: the first of points (1, n_a).

    knots: times (k,) [s] between which the motion is smooth, from its beginning at 0 to its end or,
    if `is_closed`, to where it repeats.
    """

    knots = np.zeros(1)
    is_closed = False

    def __init__(self, points: Array) -> None:
        self.points = points

    def within(self, times: Array) -> Array:
        """The times (m,) between the first and the last knot at which the motion is what it is at
        `times`."""
        end = self.knots[-1]
        return np.mod(times, end) if self.is_closed else np.clip(times, 0.0, end)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        """Tensions [N] and their rates [N/s] at times (m,) [s], (m, n_a) each."""
        tension = self.points[:1].repeat(times.size, axis=0)
        return tension, np.zeros_like(tension)


def shape_course(
    target: DrawnShapes,
    generator: np.random.Generator,
    setting: Setting,
    motion: Callable[[Array], Tensions] = Tensions,
    count: int = 1,
) -> "StaticCourse":
    """The course of a motion that tensions (count, n_a) make, given ones or drawn ones clear of
    obstacles; of one shape by default.

    Given ones are taken as they are, beyond their limits with a TensionLimitWarning. Drawn ones are
    uniform within a fraction of their limits around those nearest to zero, and halved towards these
    until the arm holds them: one draw, so that whatever is drawn next is the same for every arm.
    Raises ConfigurationError where the arm holds none.
    """
    if (given := getattr(target, "tension", None)) is not None:
        return _given_course(np.array([given]), setting, motion)
    middle, share, free = setting.tension, drawn(target.fraction, generator), setting.free
    reach = share * (setting.limits - middle[:, None])
    offset = generator.uniform(reach[:, 0], reach[:, 1], (count, middle.size))
    for halvings in range(HALVINGS + 1):
        try:
            course = StaticCourse(setting, motion(middle + 0.5**halvings * offset), MARGIN)
            if free is None or free.holds(course.coordinates(course.places)[0]).all():
                return course
            reason = "the arm would touch an obstacle"
        except NoEquilibrium as error:
            reason = str(error)
    text = (
        f"is {share:g}: none of the tensions drawn, down to 1e-12 of it, is one that the arm can"
        f" hold, not {reason}"
    )
    raise ConfigurationError([Problem(("target", "fraction"), text)], "environment")


def _given_course(
    points: Array, setting: Setting, motion: Callable[[Array], Tensions]
) -> "StaticCourse":
    warn_beyond_limits(setting.limits.tolist(), points[0])
    setting = setting._replace(model=setting.arms.model)
    try:
        return StaticCourse(setting, motion(points))
    except NoEquilibrium as error:
        reason = static_equilibrium(setting.model, points[0]).reason
        why = f"{shown_numbers(points[0])} N: {reason}" if reason else str(error)
        text = (
            f"is {shown(points[0].tolist())}: it should be tensions that the arm can hold, not"
            f" {why}"
        )
        raise ConfigurationError([Problem(("target", "tension"), text)], "environment") from error


def _still(value: Array, times: Array, order: int = 0) -> Array:
    """A value (1, n) at times (m,), or its derivative: (m, n)."""
    return (1.0 - order) * value.repeat(len(times), axis=0)


class StaticCourse(ShapeCourse):
    """Tensions pushed through the statics: at every time the shape in which they hold the arm.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions
    themselves (34). Otherwise a cubic spline goes through what loads add to that, at fixed places.
    """

    def __init__(self, setting: Setting, tension: Tensions, margin: float = 1.0) -> None:
        """margin: part of the coordinates that should have a strain too, above 1 for drawn ones.
        Raises NoEquilibrium."""
        self.tension, self._response = tension, setting.response
        self._added = None if rests_at_tensions(setting.model) else self._loaded(setting)
        pulls = (
            margin > 1.0 and setting.limits.min() >= 0.0
        )  # so that there is a strain, and one alone, between knots too
        places = tension.knots if pulls else self.places
        if not (firm := setting.arms.have_margin(margin * self.coordinates(places)[0])).all():
            raise NoEquilibrium(
                tension(places[~firm][:1])[0][0], "the section is about to give way"
            )

    @property
    def places(self) -> Array:
        """Times (m,) [s] at which the motion is looked at."""
        knots = self.tension.knots
        return np.interp(
            np.arange(PER_KNOT * (knots.size - 1) + 1) / PER_KNOT, np.arange(knots.size), knots
        )

    def _loaded(self, setting: Setting) -> Callable[..., Array]:
        """Function of time and of the order of its derivative: what loads add to the response to
        the tensions. Raises NoEquilibrium."""
        places = self.places
        tension = self.tension(places)[0]
        with setting.model.workspace() as work:
            path = EquilibriumPath(setting, work)
            added = path.follow(tension) - tension @ setting.response
            if len(added) == 1:
                return partial(_still, added)
            if self.tension.is_closed:
                added[-1] = added[0]  # which differ by round-off
            from scipy.interpolate import (
                CubicSpline,
            )  # here: it takes longer to import than all else that most scenes need

            spline: Callable[..., Array] = CubicSpline(
                places, added, bc_type="periodic" if self.tension.is_closed else "clamped"
            )
            between = 0.5 * (places[:-1] + places[1:])
            tension = self.tension(between)[0]
            off = path.off(tension, tension @ setting.response + spline(between))
            if not off.max() <= BETWEEN:
                raise NoEquilibrium(
                    tension[np.argmax(off)], "the shape changes there by more than is followed"
                )
        return spline

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        q, q_dot = (values @ self._response for values in self.tension(times))
        if self._added is None:
            return q, q_dot
        place = self.tension.within(times)
        moves = self.tension.is_closed | (place == times)
        return q + self._added(place), q_dot + self._added(place, 1) * moves[:, None]


class EquilibriumPath:
    """Equilibria of an arm whose tensions change slowly, each next to the one before, from where it
    rests: natural continuation."""

    def __init__(self, setting: Setting, work: Workspace) -> None:
        """work: of the setting's model."""
        self._q, self._tension, self._response = setting.rest, setting.tension, setting.response
        self._balance = Balance(setting.model, setting.tension, work)

    def follow(self, tension: Array) -> Array:
        """Coordinates (m, n) at rest under tensions (m, n_a), one after the other. Raises
        NoEquilibrium, also where tensions that come back do not bring back the shape."""
        q = np.array([self._move(u) for u in tension])
        if (tension[-1] == tension[0]).all() and not self._balance.angle(q[-1] - q[0]) <= SAME:
            raise NoEquilibrium(tension[0], JUMPS)
        return q

    def off(self, tension: Array, q: Array) -> Array:
        """How far (m,) forces at coordinates q (m, n) are off under tensions (m, n_a), see
        `At.residual`; infinity without a strain."""
        found = np.full(len(q), np.inf)
        for i, (self._balance.tension, at) in enumerate(zip(tension, q, strict=True)):
            if (here := self._balance.at(at, 1.0)) is not None:
                found[i] = here.residual
        return found

    def _move(self, tension: Array, shorter: int = SHORTER) -> Array:
        """Go on to the equilibrium (n,) under other tensions (n_a,), halfway first if need be.
        Raises NoEquilibrium."""
        balance, guess = self._balance, self._q + (tension - self._tension) @ self._response
        balance.tension, balance.obstacle = tension, ""
        found = LoadPath(balance).equilibrium(guess, 1.0)
        off = np.inf if found is None else balance.angle(found.at.q - guess)
        if found is not None and off <= NEAR and found.stability.stable:
            self._q, self._tension = found.at.q, tension
        elif off <= CLOSE:
            raise NoEquilibrium(tension, "the arm is no longer stable there")
        elif shorter:
            self._move(0.5 * (self._tension + tension), shorter - 1)
            self._move(tension, shorter - 1)
        else:
            raise NoEquilibrium(tension, balance.obstacle or JUMPS)
        return self._q
