"""Time integration of a model: one control step at a time (`Simulation`), or a whole input at once (`simulate`)."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion import advance, status
from soft_tendon_env.mechanics.motion.advance import Control, Record
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.runge_kutta import RungeKutta
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.stages import STEP_TOLERANCE
from soft_tendon_env.mechanics.terms.evaluate import evaluate_at_rest
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_guess
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.scene.learned_strain import LearnedRange
from soft_tendon_env.scene.scene import Array, extrapolation_columns
from soft_tendon_env.tools.checks import checked_array, checked_number, checked_type, dimensions, shown_numbers
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.files import read_arrays

UNSTABLE = 0.05
"""Estimated error of one step, as displacement over the rod's length, that a step of fixed size may have."""
STRAIN_SHARE, LOOSEST_STRAIN = 2.0, 3e-6
"""Of a step's tolerance over the rod's length, that of the strain's Newton within the step, and the most: its columns are as far off as
that, the strain by the square. With more, two ways of computing one motion, as a latency of an environment and a delay of its scene, come
apart by more than a millionth of the position error."""
SAMPLES_AT_ONCE = 100
SAME_STRAIN = 1e-6
"""Relative difference up to which a state's strain counts as that of its coordinates."""
SHORTEST = 1e-12  # [s], what may count as a time step
MOST_NUMBERS = 2**28
"""Numbers that one call may keep for tensions and samples: 2 GiB."""
BESIDE_MIDDLE = (-0.5 / np.sqrt(3.0), 0.5 / np.sqrt(3.0))
"""Places in a step, as shares of it from its middle, where a tension that is a function of time is looked at besides: Gauss points, which
no period that fits into steps hits alike."""
UNRESOLVED = 0.05
"""Of the range of such a tension, the most that it may change there otherwise than from step to step."""
EXPLICIT = 2.5
"""Steps times angular frequency up to which the explicit method is stable, with a margin: 2.83 without damping."""
STATE = "state that State.save wrote"
LATER = ("effects", "names")
"""Fields that files may lack."""

Tension = ArrayLike | Callable[[float], ArrayLike]


@dataclass(frozen=True, eq=False)
class State:
    """State of a simulation, everything that the next step depends on: a saved state continues bit for bit.

    time [s]; q, q_dot (n,) coordinates and rates; strain (points, 6) at the quadrature points, from which the next solution starts;
    step [s] the size to try next, where steps follow a tolerance: those of fixed size begin with the scene's; effects (m,) the internal
    states of the scene's effects, one after the other; names: what q and effects are of, see `Model.state_names`. A state without names
    is taken where it has no internal states.
    """

    time: float
    q: Array
    q_dot: Array
    strain: Array
    step: float
    effects: Array = field(default_factory=lambda: np.zeros(0))
    names: tuple[str, ...] = ()

    def save(self, path: str | Path) -> None:
        """Saves the state to an .npz file."""
        with open(path, "wb") as file:
            # names first: a damaged length in an archive hides what comes behind it, which then is missing
            np.savez(file, **{own.name: getattr(self, own.name) for own in reversed(fields(self))})

    @classmethod
    def load(cls, path: str | Path) -> "State":
        """Loads a state that `save` wrote. Raises TypeError, OSError or ValueError."""
        saved = read_arrays(path, [own.name for own in fields(cls) if own.name not in LATER], STATE, optional=LATER)
        try:
            time, step = float(saved.pop("time")), float(saved.pop("step"))
            names = tuple(map(str, saved.pop("names", ())))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path} holds no {STATE}: {error}") from error
        return cls(time=time, step=step, names=names, **saved)


class TensionWarning(UserWarning):
    """A tension that is a function of time changes faster than integrator steps follow."""


class SimulationDiverged(RuntimeError):
    """Raised where no step of the smallest allowed size succeeds. `state` is the last good one, `cause` says why."""

    def __init__(self, state: State, cause: str, tension: Array) -> None:
        super().__init__(f"no step succeeds at {state.time:.6g} s under tensions {shown_numbers(tension)} N: {cause}")
        self.state, self.cause, self.tension = state, cause, tension

    def __reduce__(self) -> tuple[type, tuple[State, str, Array]]:
        return type(self), (self.state, self.cause, self.tension)


class NoEquilibriumError(ValueError):
    """Raised where an arm is to begin at rest, and comes to rest nowhere under its loads and tensions."""

    def __init__(self, name: str, tension: Array, reason: str) -> None:
        text = f"{name!r} is at rest nowhere under its loads and tensions {shown_numbers(tension)} N: {reason}"
        super().__init__(f"{text}. Give an initial state: that of Simulation(model) is the stress-free shape")
        self.name, self.tension, self.reason = name, tension, reason

    def __reduce__(self) -> tuple[type, tuple[str, Array, str]]:
        return type(self), (self.name, self.tension, self.reason)


class StepReport(NamedTuple):
    """Statistics of one call of `Simulation.step`: accepted and rejected integrator steps, the estimated error, and what it all cost."""

    steps: int  # accepted
    rejected: int  # steps that failed and were tried again at a smaller size
    error: float  # [m], sum of the estimated errors of the steps, as root mean square displacement of the rod
    evaluations: int  # of the equation of motion, those of rejected steps with them: nearly all of the time that a call takes


class Trajectory(NamedTuple):
    """Sampled motion, the initial state first."""

    time: Array  # (samples,) [s]
    q: Array  # (samples, n)
    q_dot: Array  # (samples, n)
    tip_pose: Array  # (samples, 4, 4)
    tension: Array  # (samples - 1, steps per sample, n_a) [N], as held over each integrator step
    final: State
    steps: int
    rejected: int
    error: float  # [m], as in StepReport
    evaluations: int


class Simulation:
    """Simulation of a model, one control step at a time. Tensions are held over a step (zero-order hold); arguments are checked."""

    def __init__(self, model: Model, state: State | None = None) -> None:
        self.model = checked_type("model", model, Model, "see build_model")
        self._method, self._range = step_method(model), LearnedRange(model.scene.name, model.learned)
        self._scratch = make_scratch(model.arm, self._method.columns)
        self.reset()
        if state is not None:
            self.state = state

    def reset(
        self,
        q: ArrayLike | None = None,
        q_dot: ArrayLike | None = None,
        *,
        time: float = 0.0,
        effects: ArrayLike | None = None,
        tension: ArrayLike | None = None,
    ) -> State:
        """Resets to q, q_dot (n,) at a time [s]; returns the state. Raises ValueError, TypeError, StrainLimitError.

        By default q and q_dot are zero, the stress-free shape, which is not at rest where loads act: see `reset_at_rest`.
        effects (m,): the effects' internal states, see State; by default those at rest at q under tensions `tension` (n_a,) [N], zero by
        default, which have held the arm there since long before: that matters to what lies between command and tension, see
        docs/actuation.md.
        """
        n = self.model.coordinate_count
        clock = np.array([checked_number("time", time, -np.inf, "a finite number")])
        start = np.zeros(n) if q is None else checked_array("q", q, (n,))
        rate = np.zeros(n) if q_dot is None else checked_array("q_dot", q_dot, (n,))
        held = self.model.command(np.zeros(self.model.tendon_count) if tension is None else tension, start)
        strain, work = self.model.packed_strain(start), self._scratch.work
        if effects is not None:
            states = checked_array("effects", effects, work.state.shape).copy()
        elif work.state.size:
            work.xi[:] = strain
            evaluate_at_rest(self.model.arm, held, start, STEP_TOLERANCE, work)
            states = work.state.copy()
        else:
            states = np.zeros(0)
        self._take(Motion(start, rate, strain, states, clock), self.model.scene.integrator.step)
        return self.state

    def reset_at_rest(self, tension: ArrayLike | None = None, *, time: float = 0.0) -> State:
        """Resets to the static equilibrium under tensions (n_a,) [N], zero by default, and the scene's loads at time 0; returns the state.

        time: what the state's time is set to [s].

        Where the branch of stable equilibria ends the arm is let go to where it settles, see `static_equilibrium`. The stress-free shape
        where nothing acts. Raises ValueError or TypeError for bad arguments, NoEquilibriumError where the arm comes to rest nowhere.
        """
        u = np.zeros(self.model.tendon_count) if tension is None else checked_array("tension", tension, (self.model.tendon_count,))
        if not u.any() and not self.model.arm.effects.load:
            return self.reset(time=time)
        found = static_equilibrium(self.model, u, settle=True)
        if not found.converged:
            raise NoEquilibriumError(self.model.scene.name, u, found.reason)
        return self.reset(found.q, time=time, tension=u)

    @property
    def state(self) -> State:
        """A copy of the present state. Set, it is checked and taken whole; ValueError or TypeError leave the simulation as it was."""
        q, q_dot, xi, effects, clock = self._motion
        strain = self.model.grid.unpacked(xi)
        return State(float(clock[0]), q.copy(), q_dot.copy(), strain, self._step, effects.copy(), self.model.state_names)

    @state.setter
    def state(self, state: State) -> None:
        checked_type("state", state, State, "see Simulation.state")
        n = self.model.coordinate_count
        q, q_dot = checked_array("state.q", state.q, (n,)), checked_array("state.q_dot", state.q_dot, (n,))
        strain = checked_array("state.strain", state.strain, (self.model.grid.point_count, 6))
        if state.names or np.size(state.effects):
            self.model.check_names(state.names)
        motion = Motion(
            q,
            q_dot,
            self.model.grid.packed(strain),
            checked_array("state.effects", state.effects, self.model.arm.effects.state.shape),
            np.array([checked_number("state.time", state.time, -np.inf, "a finite number")]),
        )
        step = checked_number("state.step", state.step, SHORTEST, "a positive number of seconds")
        self._scratch.work.xi[:] = motion.xi
        failed = strain_from_guess(self.model.arm, motion.q, STEP_TOLERANCE, self._scratch.work)
        if failed >= 0 or not np.allclose(self._scratch.work.xi, motion.xi, rtol=SAME_STRAIN, atol=SAME_STRAIN * np.abs(motion.xi).max()):
            raise ValueError("state.strain should be the strain at state.q; to start from other coordinates, use reset(q, q_dot)")
        self._take(motion, step)

    def _take(self, motion: Motion, step: float) -> None:
        self._motion, self._step = motion, step
        self._sample = Record(motion.q[None].copy(), motion.q_dot[None].copy(), np.eye(4)[None].copy())
        advance.tip_pose(self.model.arm, motion, self._scratch.work, self._sample.tip_pose[0])

    def step(self, tension: ArrayLike, duration: float) -> StepReport:
        """Integrates over `duration` [s] in equal steps of at most the scene's, under constant tension (n_a,) [N].

        Raises ValueError or TypeError before anything changes, `SimulationDiverged` with the state before the failing step.
        """
        u = checked_array("tension", tension, (self.model.tendon_count,))
        duration = checked_number("duration", duration, 0.0, "a number of seconds, at least 0")
        if duration == 0.0:
            return StepReport(0, 0, 0.0, 0)
        step = self.model.scene.integrator.step
        most = step * (MOST_NUMBERS // u.size)
        if duration > most:
            raise ValueError(f"duration should be at most {most:g} s in one call with integrator steps of {step:g} s, not {duration:g} s")
        control = step_control(self.model, duration)
        tensions = np.tile(u, (round(duration / control.step), 1))
        return self._run(tensions, control, self._sample)

    @property
    def tip_pose(self) -> Array:
        """Pose of the tip in the world frame, (4, 4)."""
        return self._sample.tip_pose[0].copy()

    def _run(self, tensions: Array, control: Control, record: Record) -> StepReport:
        """Advance by control.step under each row of tensions (rows, n_a), with the record's samples evenly among them; unchecked."""
        arm, motion, durations = self.model.arm, self._motion, np.full(len(tensions), control.step)
        done = advance.advance(arm, self._method, control, tensions, durations, motion, self._step, self._scratch, record)
        self._step = done.step
        if done.status == status.OK:
            self._range.look(record.q)
            return StepReport(done.steps, done.rejected, done.error, done.evaluations)
        self._take(self._motion, done.step)
        cause = cause_of(done.status, self.model, control)
        if done.status == status.NO_STRAIN:
            cause += f"; in the last good state {self.model.nearest_limit(self._motion.q, self._motion.xi)}"
        raise SimulationDiverged(self.state, cause, tensions[done.row])


def simulate(
    model: Model,
    tension: Tension,
    duration: float,
    sample_period: float,
    initial: State | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Simulates `duration` [s] and samples the motion every `sample_period` [s].

    tension: an array (n_a,) held throughout, a table (duration / sample_period, n_a) of which each row is held over one sample
    period, or a function of time [s] that is sampled at the middle of each integrator step and held over it (second order, and
    jumps at the borders of steps stay exact). initial: the state to start from, by default at rest without tension under the scene's
    loads at time 0, see `Simulation.reset_at_rest`; `Simulation(model).state` is the stress-free shape, where loads let an arm go.
    progress: called with the simulated time [s] now and then.

    Raises ValueError or TypeError for bad input before anything is computed, NoEquilibriumError where no initial state is given and the
    arm rests nowhere, `SimulationDiverged`.
    """
    simulation = Simulation(model, initial)
    period = checked_number("sample_period", sample_period, SHORTEST, "a positive number of seconds")
    duration = checked_number("duration", duration, 0.0, "a number of seconds, at least 0")
    _check_size(model, duration, period)
    samples = round(duration / period)
    if abs(samples * period - duration) > 1e-9 * max(duration, period):
        raise ValueError(f"duration should be a multiple of sample_period {period:g} s, not {duration:g} s")
    control = step_control(model, period)
    tensions = _tension_table(model, tension, simulation.state.time, samples, round(period / control.step), control.step)
    start = simulation.reset_at_rest() if initial is None else simulation.state
    record = Record(*(np.zeros((samples + 1, *shape)) for shape in ((start.q.size,), (start.q.size,), (4, 4))))
    record.tip_pose[:] = np.eye(4)
    record.q[0], record.q_dot[0], record.tip_pose[0] = start.q, start.q_dot, simulation.tip_pose
    reports = []
    for first in range(0, samples, SAMPLES_AT_ONCE):
        rows = slice(first, min(first + SAMPLES_AT_ONCE, samples))
        part = Record(*(values[rows.start + 1 : rows.stop + 1] for values in record))
        reports.append(simulation._run(tensions[rows].reshape(-1, model.tendon_count), control, part))
        if progress is not None:
            progress(rows.stop * period)
    totals = (sum(values) for values in zip(StepReport(0, 0, 0.0, 0), *reports, strict=True))
    times = start.time + period * np.arange(samples + 1, dtype=np.float64)
    return Trajectory(times, *record, tensions, simulation.state, *totals)


def _check_size(model: Model, duration: float, period: float) -> None:
    """Raises ValueError where one call would have to keep too many samples and tensions."""
    step = model.scene.integrator.step
    per_sample = 2 * model.coordinate_count + 16 + model.tendon_count * np.ceil(period / step)
    most = step * (MOST_NUMBERS // model.tendon_count)
    if per_sample > MOST_NUMBERS:
        raise ValueError(f"sample_period should be at most {most:g} s with integrator steps of {step:g} s, not {period:g} s")
    most = period * (MOST_NUMBERS // per_sample)
    if duration > most:
        limit = f"at most {most:g} s in one call with samples every {period:g} s and integrator steps of {step:g} s"
        raise ValueError(f"duration should be {limit}, not {duration:g} s: go on from Trajectory.final")


def cause_of(code: int, model: Model, control: Control) -> str:
    """The message of a status. With error control, that of an estimate says which tolerance could not be met."""
    if code != status.INACCURATE or not control.adaptive:
        return status.MESSAGES[code]
    settings = f"steps of {control.smallest:.2g} s, {model.scene.integrator.max_halvings} halvings"
    return f"the estimated error is above integrator.tolerance, {control.tolerance:g} m, even with {settings}: allow more of either"


def step_method(model: Model) -> Extrapolated | RungeKutta:
    """Integration method of the scene, as the kernels take it. Raises ConfigurationError where it cannot follow stiff tendons."""
    integrator = model.scene.integrator
    if integrator.method == "runge_kutta_4":
        _check_explicit(model)
        return RungeKutta()
    columns = extrapolation_columns(model.scene)
    least = columns if integrator.tolerance is None else 2
    keeps = least < columns and not integrator.quasi_static  # without inertia D is in the place of M
    return Extrapolated(columns, least, not integrator.quasi_static, keeps, _strain_tolerance(model))


def _check_explicit(model: Model) -> None:
    """Raises ConfigurationError where an explicit step is unstable with the springs of the tendons, which are too bounded to diverge."""
    n, step = model.coordinate_count, model.scene.integrator.step
    springs = model.scene.effects.springs(np.zeros(model.tendon_count), model.length)
    if not springs.any():
        return
    terms = model.terms(np.zeros(n), np.zeros(n))
    stiffness = (terms.actuation * springs) @ terms.actuation.T
    fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(terms.mass, stiffness)).real.max())
    if step * fastest > EXPLICIT:
        text = f"is {step:g}: with tendons of {springs.max():g} N/m steps of runge_kutta_4 are stable if at most {EXPLICIT / fastest:.2g} s"
        raise ConfigurationError([Problem(("integrator", "step"), f"{text}; those of 'extrapolated' are whatever their length")])


def _strain_tolerance(model: Model) -> float:
    """Of the strain's Newton within a step."""
    allowed = model.scene.integrator.tolerance
    return STEP_TOLERANCE if allowed is None else min(max(STRAIN_SHARE * allowed / model.length, STEP_TOLERANCE), LOOSEST_STRAIN)


def step_control(model: Model, duration: float) -> Control:
    """Step control of the scene over `duration` [s]: equal steps of at most the scene's, tolerance, smallest step."""
    integrator = model.scene.integrator
    step = duration / np.ceil(duration / integrator.step * (1.0 - 1e-9))
    return Control(
        step=step,
        tolerance=UNSTABLE * model.length if integrator.tolerance is None else integrator.tolerance,
        adaptive=integrator.tolerance is not None,
        smallest=step * 0.5**integrator.max_halvings,
        horizon=0.0 if integrator.quasi_static else integrator.step,
    )


def _tension_table(model: Model, tension: Tension, start: float, samples: int, per_sample: int, step: float) -> Array:
    """Tensions over every integrator step: (samples, per_sample, n_a)."""
    shape = (samples, per_sample, model.tendon_count)
    if callable(tension):
        middles: Array = start + step * (np.arange(samples * per_sample, dtype=np.float64) + 0.5)
        held = _sampled(tension, middles, model.tendon_count)
        _check_resolved(tension, held, middles, step)
        return held.reshape(shape)
    if dimensions(tension) == 1:
        return np.tile(checked_array("tension", tension, shape[2:]), (samples, per_sample, 1))
    table = checked_array("tension", tension, (samples, model.tendon_count))
    return np.repeat(table[:, None], per_sample, axis=1)


def _check_resolved(tension: Callable[[float], ArrayLike], held: Array, middles: Array, step: float) -> None:
    """Warns where a function of time changes within steps otherwise than from step to step: it is held at its values in their middles."""
    if len(held) < 2:
        return
    slope, missed = np.gradient(held, axis=0), np.zeros(len(held))
    for share in BESIDE_MIDDLE:
        inside = _sampled(tension, middles + share * step, held.shape[1]) - held
        missed = np.maximum(missed, np.minimum(np.abs(inside), np.abs(inside - share * slope)).max(axis=1))
    worst = int(np.argmax(missed))
    if missed[worst] > UNRESOLVED * np.ptp(held, axis=0).max() and missed[worst] > 0.0:
        warnings.warn(
            f"tension(t) changes within integrator steps of {step:g} s, over which it is held, by {missed[worst]:.3g} N more than from "
            f"step to step, at {middles[worst]:.6g} s: a shorter integrator.step follows it, and jumps belong to borders of steps",
            TensionWarning,
            stacklevel=3,
        )


def _sampled(tension: Callable[[float], ArrayLike], times: Array, size: int) -> Array:
    """The function at all times (m,): (m, size). An error names the time."""
    table = np.empty((times.size, size))
    for row, time in zip(table, times, strict=True):
        given = tension(time)
        plain = isinstance(given, np.ndarray) and given.dtype == np.float64 and given.shape == (size,)
        row[:] = given if plain else checked_array(f"tension({time:.6g})", given, (size,))
    for i in np.flatnonzero(~np.isfinite(table).all(axis=1)):
        checked_array(f"tension({times[i]:.6g})", table[i], (size,))
    return table
