"""Quasi-static trajectories: the shapes at rest under tensions that change with time."""

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

HALVINGS = 40
"""How often drawn tensions that the arm cannot hold are halved."""

MARGIN = 1.03
"""Part of a drawn motion's coordinates that should have strains too: it may reach farther between
places."""

BETWEEN = 2e-4
"""How far forces may be off between the places of a spline, see `Evaluation.residual`.

Usual motions have 1e-6 to 5e-5."""

PER_KNOT = 4
"""Places per knot of the tensions at which a motion is looked at. The spline through four
equilibria moves the tip of a loaded arm by up to 1e-4 of its length off those between, through two
by up to 2e-3."""

NEAR = 0.2
"""Angle [rad] from where an equilibrium is expected, within which it is taken; else tensions change
by half as much at a time."""

CLOSE = 0.01
"""Angle [rad] from where an equilibrium is expected, within which one that is not stable is the
end."""

SAME = 1e-6
"""Angle [rad] between shapes that count as one."""

SHORTER = 8
"""How often changes of tensions are halved before the arm is said to jump."""

JUMPS = "the arm jumps from one shape to another near there"


class NoEquilibrium(ArithmeticError):
    """Tensions (n_a,) [N] that the arm cannot hold, and why."""

    def __init__(self, tension: Array, reason: str) -> None:
        message = f"{shown_numbers(tension)} N: {reason}"
        super().__init__(message)


class Tensions:
    """Tensions as a function of time; by itself, tensions that stay: the first of points (1, n_a).

    Attributes:
        knots: times (k,) [s] between which the motion is smooth, from its beginning at 0 to its end
            or, if `is_closed`, to where it repeats.
        is_closed: whether it repeats.
    """

    knots = np.zeros(1)
    is_closed = False

    def __init__(self, points: Array) -> None:
        self.points = points

    def within(self, times: Array) -> Array:
        """Times (m,) from the first to the last knot at which the motion is as at `times`."""
        end = self.knots[-1]
        if self.is_closed:
            return np.mod(times, end)
        return np.clip(times, 0.0, end)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        """Tensions [N] and their rates [N/s] at times (m,) [s], (m, n_a) each."""
        first = self.points[:1]
        tension = first.repeat(times.size, axis=0)
        return tension, np.zeros_like(tension)


def shape_course(
    target: DrawnShapes,
    generator: np.random.Generator,
    setting: Setting,
    motion: Callable[[Array], Tensions] = Tensions,
    count: int = 1,
) -> "StaticCourse":
    """Course of the shapes that tensions make, given ones or drawn ones clear of obstacles.

    Given ones are taken as they are, beyond their limits with a TensionLimitWarning. Drawn ones are
    uniform within a fraction of their limits around those nearest to zero, and halved towards these
    until the arm holds them: one draw, so that whatever is drawn next is the same for every arm.

    Args:
        target: that is drawn; it may have a `tension`.
        generator: of the episode.
        setting: of the arms.
        motion: tensions over time of points (count, n_a); by default those of one shape.
        count: of the points.

    Returns:
        The course.

    Raises:
        ConfigurationError: where the arm holds none.
    """
    tension = getattr(target, "tension", None)
    if tension is not None:
        return _given_course(np.array([tension]), setting, motion)
    fraction = drawn(target.fraction, generator)
    middle = setting.tension
    room = setting.limits - middle[:, None]
    reach = fraction * room
    low = reach[:, 0]
    high = reach[:, 1]
    shape = (count, middle.size)
    offset = generator.uniform(low, high, shape)
    for halvings in range(HALVINGS + 1):
        points = middle + 0.5**halvings * offset
        try:
            course = StaticCourse(setting, motion(points), MARGIN)
        except NoEquilibrium as error:
            reason = str(error)
            continue
        if _is_clear(course, setting):
            return course
        reason = "the arm would touch an obstacle"
    text = (
        f"is {fraction:g}: none of the tensions drawn, down to 1e-12 of it, is one that the arm can"
        f" hold, not {reason}"
    )
    raise ConfigurationError([Problem(("target", "fraction"), text)], "environment")


def _is_clear(course: "StaticCourse", setting: Setting) -> bool:
    """Whether a course stays in the space that obstacles leave free, if there are any."""
    if setting.free is None:
        return True
    q, _ = course.coordinates(course.places)
    return bool(setting.free.holds(q).all())


def _given_course(
    points: Array,
    setting: Setting,
    motion: Callable[[Array], Tensions],
) -> "StaticCourse":
    """Course of given tensions (1, n_a).

    Raises ConfigurationError where the arm holds none.
    """
    tension = points[0]
    warn_beyond_limits(setting.limits.tolist(), tension)
    with_obstacles = setting._replace(model=setting.arms.model)
    try:
        return StaticCourse(with_obstacles, motion(points))
    except NoEquilibrium as error:
        reason = static_equilibrium(with_obstacles.model, tension).reason
        if reason:
            why = f"{shown_numbers(tension)} N: {reason}"
        else:
            why = str(error)
        text = (
            f"is {shown(tension.tolist())}: it should be tensions that the arm can hold, not {why}"
        )
        problem = Problem(("target", "tension"), text)
        raise ConfigurationError([problem], "environment") from error


def _still(value: Array, times: Array, order: int = 0) -> Array:
    """A value (1, n) at times (m,), or its derivative: (m, n)."""
    held = value.repeat(len(times), axis=0)
    return (1.0 - order) * held


class StaticCourse(ShapeCourse):
    """Tensions pushed through the statics: at every time the shape in which they hold the arm.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions
    themselves (34). Otherwise a cubic spline goes through what loads add to that, at fixed places.
    """

    def __init__(
        self,
        setting: Setting,
        tension: Tensions,
        margin: float = 1.0,
    ) -> None:
        """Follow the equilibria of a motion.

        Args:
            setting: of the arms.
            tension: over time.
            margin: part of the coordinates that should have a strain too, above 1 for drawn ones.

        Raises:
            NoEquilibrium: where the arm cannot hold the tensions.
        """
        self.tension = tension
        self._response = setting.response
        self._added: Callable[..., Array] | None = None
        if not rests_at_tensions(setting.model):
            self._added = self._loaded(setting)
        # tendons that pull alone: so that there is a strain, and one alone, between knots too
        is_drawn = margin > 1.0
        pulls = setting.limits.min() >= 0.0
        if is_drawn and pulls:
            places = tension.knots
        else:
            places = self.places
        q, _ = self.coordinates(places)
        is_firm = setting.arms.have_margin(margin * q)
        if not is_firm.all():
            first_firm = places[~is_firm][:1]
            tensions, _ = tension(first_firm)
            raise NoEquilibrium(tensions[0], "the section is about to give way")

    @property
    def places(self) -> Array:
        """Times (m,) [s] at which the motion is looked at."""
        knots = self.tension.knots
        knot_numbers = np.arange(knots.size)
        count = PER_KNOT * (knots.size - 1) + 1
        places = np.arange(count) / PER_KNOT
        return np.interp(places, knot_numbers, knots)

    def _loaded(self, setting: Setting) -> Callable[..., Array]:
        """Coordinates that loads add to the response to tensions, as a function of time.

        Its second argument is the order of the derivative. Raises NoEquilibrium.
        """
        places = self.places
        tension, _ = self.tension(places)
        with setting.model.workspace() as work:
            path = EquilibriumPath(setting, work)
            straight = tension @ setting.response
            added = path.follow(tension) - straight
            if len(added) == 1:
                return partial(_still, added)
            # it takes longer to import than all else that most scenes need
            from scipy.interpolate import CubicSpline

            ends = "clamped"
            if self.tension.is_closed:
                ends = "periodic"
                added[-1] = added[0]  # which differ by round-off
            spline: Callable[..., Array] = CubicSpline(places, added, bc_type=ends)
            pair_sums = places[:-1] + places[1:]
            between = 0.5 * pair_sums
            tension_between, _ = self.tension(between)
            q = tension_between @ setting.response + spline(between)
            residuals = path.residuals(tension_between, q)
            if not residuals.max() <= BETWEEN:
                worst = tension_between[np.argmax(residuals)]
                raise NoEquilibrium(worst, "the shape changes there by more than is followed")
        return spline

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        tension, tension_rate = self.tension(times)
        q = tension @ self._response
        q_dot = tension_rate @ self._response
        if self._added is None:
            return q, q_dot
        place = self.tension.within(times)
        moves = self.tension.is_closed | (place == times)
        slope = self._added(place, 1)
        added_rate = slope * moves[:, None]
        added = self._added(place)
        return q + added, q_dot + added_rate


class EquilibriumPath:
    """Equilibria of an arm whose tensions change slowly, each next to the one before.

    It goes on from where the arm rests, by natural continuation.
    """

    def __init__(self, setting: Setting, work: Workspace) -> None:
        """Begin where the arm rests; work: of the setting's model."""
        self._q = setting.rest
        self._tension = setting.tension
        self._response = setting.response
        self._balance = Balance(setting.model, setting.tension, work)

    def follow(self, tension: Array) -> Array:
        """Coordinates at rest under tensions, one after the other.

        Args:
            tension: (m, n_a) [N].

        Returns:
            Coordinates (m, n).

        Raises:
            NoEquilibrium: also where tensions that come back do not bring back the shape.
        """
        equilibria = [self._move(u) for u in tension]
        q = np.array(equilibria)
        is_same = tension[-1] == tension[0]
        comes_back = is_same.all()
        change = q[-1] - q[0]
        if comes_back and not self._balance.angle(change) <= SAME:
            raise NoEquilibrium(tension[0], JUMPS)
        return q

    def residuals(self, tension: Array, q: Array) -> Array:
        """How far forces are off at coordinates under tensions, see `Evaluation.residual`.

        Args:
            tension: (m, n_a) [N].
            q: coordinates (m, n).

        Returns:
            Residuals (m,), infinity without a strain.
        """
        balance = self._balance
        residuals = np.full(len(q), np.inf)
        for i in range(len(q)):
            balance.tension = tension[i]
            balanced = balance.at(q[i], 1.0)
            if balanced is not None:
                residuals[i] = balanced.residual
        return residuals

    def _move(self, tension: Array, shorter: int = SHORTER) -> Array:
        """Go on to the equilibrium (n,) under other tensions (n_a,), halfway first if need be.

        Raises NoEquilibrium.
        """
        balance = self._balance
        balance.tension = tension
        balance.obstacle = ""
        change = (tension - self._tension) @ self._response
        guess = self._q + change
        rest = LoadPath(balance).equilibrium(guess, 1.0)
        angle = np.inf
        if rest is not None:
            difference = rest.evaluation.q - guess
            angle = balance.angle(difference)
            if angle <= NEAR and rest.stability.stable:
                self._q = rest.evaluation.q
                self._tension = tension
                return self._q
        if angle <= CLOSE:
            raise NoEquilibrium(tension, "the arm is no longer stable there")
        if shorter == 0:
            raise NoEquilibrium(tension, balance.obstacle or JUMPS)
        middle = 0.5 * (self._tension + tension)
        self._move(middle, shorter - 1)
        return self._move(tension, shorter - 1)
