"""Quasi-static trajectories: the shapes in which tensions that change with time hold the arm at rest.

Tensions are pushed through the statics, so that the arm can hold every one of the shapes: tensions that are given and cannot be held are
refused, drawn ones are halved.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from soft_tendon_env.envs.targets import Setting, ShapeCourse
from soft_tendon_env.envs.targets.equilibria import Equilibria
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import rests_at_tensions, static_equilibrium
from soft_tendon_env.model.tension_limits import warn_beyond_limits
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.checks import checked_array, shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.types import Array

HALVINGS = 40
"""How often drawn tensions that the arm cannot hold are halved."""
MARGIN = 1.03
"""Part of a drawn motion's coordinates that should have strains too: it may reach farther between places where they are looked for."""
CHECKS = 4
"""Places per knot at which a motion is checked for strains and obstacles."""
BETWEEN = 1.7e-4
"""Angle [rad] by which a spline through equilibria may be off those between two of them: it moves the tip by at most 1 / sqrt(3) of that,
a cantilever's under its end load, so by 1e-4 of the length."""
NEAR = 1e-2
"""Angle [rad] up to which an equilibrium counts as the one that was expected between two others."""
REFINEMENTS = 10
"""How often intervals between equilibria are halved before a motion counts as one that jumps."""


class NotHeld(ArithmeticError):
    """Tensions (n_a,) [N] along a motion that the arm cannot hold; the message says why, which is found out when it is asked for."""

    def __init__(self, tension: Array, reason: Callable[[], str]) -> None:
        super().__init__(tension)
        self._tension, self._reason = tension, reason

    def __str__(self) -> str:
        return f"{shown_numbers(self._tension)} N: {self._reason()}"


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


def nearest_to_zero(limits: Array) -> Array:
    """The tensions (n_a,) within limits (n_a, 2) that are nearest to zero."""
    return np.clip(0.0, limits[:, 0], limits[:, 1])


def check_tension(tension: tuple[float, ...] | None, scene: Scene) -> None:
    """Raises ConfigurationError unless a target's `tension`, if it is given, has an entry per tendon of the scene."""
    if tension is not None and len(tension) != len(scene.tendons):
        text = f"has {len(tension)} entries: it should have one per tendon, {len(scene.tendons)}"
        raise ConfigurationError([Problem(("target", "tension"), text)], "environment")


def given_course(tension: tuple[float, ...], setting: Setting, motion: Callable[[Array], Tensions]) -> "StaticCourse":
    """The course of a motion that given tensions make. Beyond their limits they are taken as they are, with a TensionLimitWarning."""
    warn_beyond_limits(setting.limits.tolist(), np.array(tension))
    try:
        return StaticCourse(setting, motion(checked_array("target.tension", tension, (setting.arms.model.tendon_count,))))
    except NotHeld as error:
        text = f"is {shown(tension)}: it should be tensions that the arm can hold, not {error}"
        raise ConfigurationError([Problem(("target", "tension"), text)], "environment") from error


def drawn_course(
    count: int, fraction: float | tuple[float, float], generator: np.random.Generator, setting: Setting, motion: Callable[[Array], Tensions]
) -> "StaticCourse":
    """The course of a motion that drawn tensions (count, n_a) make.

    They are uniform within a fraction of their limits around those nearest to zero, drawn from a range if it is one, and halved towards
    these until the arm holds them: one draw, so that whatever is drawn next is the same for every arm.
    """
    middle = nearest_to_zero(setting.limits)
    share = generator.uniform(*fraction) if isinstance(fraction, tuple) else fraction
    reach = share * (setting.limits - middle[:, None])
    offset = generator.uniform(reach[:, 0], reach[:, 1], (count, middle.size))
    for halvings in range(HALVINGS + 1):
        part = 0.5**halvings
        try:
            return StaticCourse(setting, motion(middle + part * offset), is_drawn=True)
        except NotHeld as error:
            last = error
    text = f"is {share:g}: none of the tensions drawn, down to 1e-12 of it, is one that the arm can hold, not {last}"
    raise ConfigurationError([Problem(("target", "fraction"), text)], "environment")


def drawn_set_point(fraction: float | tuple[float, float], generator: np.random.Generator, setting: Setting) -> "StaticCourse":
    """The course of one shape at rest under random tensions within a fraction of their limits."""
    return drawn_course(1, fraction, generator, setting, lambda points: Constant(points[0]))


class StaticCourse(ShapeCourse):
    """Tensions pushed through the statics: at every time the shape in which they hold the arm.

    Without effects, and with the statics-based strain, the coordinates at rest are the tensions themselves (34). Otherwise they are
    a cubic spline through equilibria. Drawn motions are those of the arm without obstacles, and keep clear of these.
    """

    def __init__(self, setting: Setting, tension: Tensions, is_drawn: bool = False) -> None:
        """is_drawn: it could as well be another motion, and should keep clear of what the arm cannot hold. Raises NotHeld."""
        if is_drawn and setting.free is not None:
            setting = setting._replace(model=setting.free.model, is_exact=rests_at_tensions(setting.free.model))
        model, response = setting.model, Response(tension, setting.response)
        self._tension = tension
        self._motion: Response | Constant | EquilibriumSpline
        if isinstance(tension, Constant) and not (is_drawn and setting.is_exact):
            self._motion = Constant(_rest(model, tension.value))
        elif setting.is_exact:
            self._motion = response
        else:
            self._motion = EquilibriumSpline(Equilibria(setting.arms, model), setting.metric, response)
        if is_drawn or not isinstance(tension, Constant):
            self._check(setting, is_drawn)

    def _check(self, setting: Setting, is_drawn: bool) -> None:
        """Raises NotHeld where the motion comes near to where strains end, or a drawn one to obstacles."""
        margin = MARGIN if is_drawn else 1.0
        knots = self._tension.knots
        times = np.interp(np.arange(CHECKS * (knots.size - 1) + 1) / CHECKS, np.arange(knots.size), knots)
        pulls = is_drawn and setting.is_exact and setting.limits.min() >= 0.0  # so that there is a strain, and one alone, everywhere
        looked = knots if pulls else times
        if (soft := looked[~setting.arms.are_firm(margin * self._motion(looked)[0])]).size:
            given = self._tension(soft[:1])[0][0]
            raise NotHeld(given, lambda: static_equilibrium(setting.model, given).reason or "the section is about to give way")
        if is_drawn and setting.free is not None and not setting.free.holds(self._motion(times)[0]).all():
            raise NotHeld(self._tension(times[:1])[0][0], lambda: "the arm would touch an obstacle")

    def coordinates(self, times: Array) -> tuple[Array, Array]:
        return self._motion(times)


class Response:
    """Coordinates as a function of time that are tensions mapped by `matrix` (n_a, n)."""

    def __init__(self, tension: Tensions, matrix: Array) -> None:
        self.tension, self.matrix = tension, matrix
        moved = matrix != 0.0  # by each tension: one coordinate alone, where coordinates are tensions
        self._borders = [*zip(moved.argmax(axis=1).tolist(), (matrix.shape[1] - moved[:, ::-1].argmax(axis=1)).tolist(), strict=True)]

    def __call__(self, times: Array) -> tuple[Array, Array]:
        values = np.array(self.tension(times))  # row by row: a product of matrices rounds a row otherwise when others stand beside it
        mapped, columns = np.zeros((self.matrix.shape[1], *values.shape[:2])), np.ascontiguousarray(values.transpose(2, 0, 1))
        for column, row, (first, last) in zip(columns, self.matrix, self._borders, strict=True):
            mapped[first:last] += row[first:last, None, None] * column
        q, q_dot = np.ascontiguousarray(mapped.transpose(1, 2, 0))
        return q, q_dot


def _rest(model: Model, tension: Array) -> Array:
    """Coordinates (n,) in which tensions (n_a,) hold the arm. Raises NotHeld."""
    found = static_equilibrium(model, tension)
    if not found.converged:
        raise NotHeld(tension, lambda: found.reason)
    return found.q


def _rests(equilibria: Equilibria, tension: Array) -> Array:
    """Coordinates (m, n) in which tensions (m, n_a) hold the arm. Raises NotHeld."""
    q, found = equilibria.on_path(tension)
    for i in np.flatnonzero(~found):
        q[i] = _rest(equilibria.model, tension[i])
    return q


def _beside(equilibria: Equilibria, tension: Array, expected: Array, metric: Array) -> Array:
    """Coordinates (m, n) of equilibria under tensions (m, n_a) next to expected ones (m, n), where there are such. Raises NotHeld."""
    q, found = equilibria.beside(tension, expected)
    for i in np.flatnonzero(~found):
        beside = static_equilibrium(equilibria.model, tension[i], expected[i])
        q[i], found[i] = beside.q, beside.converged
    far = np.flatnonzero(~(found & (np.linalg.norm((q - expected) @ metric, axis=1) <= NEAR)))
    if far.size:
        q[far] = _rests(equilibria, tension[far])
    return q


class EquilibriumSpline:
    """Coordinates as a function of time: the equilibria under tensions that change with time, by a cubic spline through what loads add
    to the response to the tensions.

    At the knots they are those where a slowly loaded arm goes. In the middle between two knots an equilibrium is looked for near the
    spline and becomes a knot itself, until the spline through all of them is off those between by no more than BETWEEN. Where that
    does not come to an end the arm jumps from one shape to another under tensions that hardly differ.
    """

    def __init__(self, equilibria: Equilibria, metric: Array, response: Response) -> None:
        """metric: see Setting. Raises NotHeld where there are no equilibria, or where they jump."""
        tension = response.tension
        self._response, self._tension, self._duration = response, tension, float(tension.knots[-1])
        times = tension.knots
        q = _rests(equilibria, tension(times[: times.size - tension.is_closed])[0])
        q = np.concatenate([q, q[:1]]) if tension.is_closed else q
        rough, tolerance = np.ones(times.size - 1, dtype=bool), 16.0 * BETWEEN  # the error falls with the fourth power of an interval
        for _ in range(REFINEMENTS):
            self._pass_through(times, q)
            place = np.flatnonzero(rough)
            middles = 0.5 * (times[place] + times[place + 1])
            expected = self(middles)[0]
            found = _beside(equilibria, tension(middles)[0], expected, metric)
            astray = np.linalg.norm((found - expected) @ metric, axis=1)
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
        from scipy.interpolate import CubicSpline  # here: it takes longer to import than all else that most scenes need

        added, ends = q - self._response(times)[0], "clamped"
        if self._tension.is_closed:
            added[-1], ends = added[0], "periodic"  # which differ by round-off
        self._spline = CubicSpline(times / self._duration, added, bc_type=ends)

    def __call__(self, times: Array) -> tuple[Array, Array]:
        place = self._tension.within(times) / self._duration
        moves = self._tension.is_closed | ((times > 0.0) & (times < self._duration))
        q, q_dot = self._response(times)
        return q + self._spline(place), q_dot + self._spline(place, 1) * (moves / self._duration)[:, None]
