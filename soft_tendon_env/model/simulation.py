"""Time integration of a model, by control steps or over a whole input.

`Simulation` takes one step at a time, `simulate` a whole input at once.
"""

from __future__ import annotations

import contextlib
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from soft_tendon_env.mechanics.motion import advance, status
from soft_tendon_env.mechanics.motion.advance import Control, Record, Scheme
from soft_tendon_env.mechanics.motion.batch import make_batch, step_rows
from soft_tendon_env.mechanics.motion.period_map import Plan, linearised_rollout, make_plan
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch, make_tape
from soft_tendon_env.mechanics.terms.external_forces import rest_states
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import SHORTEST, State, checked_motion, state_of
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.model.step_control import (
    Command,
    cause_of,
    command_table,
    linear_rate,
    step_control,
    step_count,
    step_method,
)
from soft_tendon_env.model.strain_limits import StrainLimitError, nearest_limit
from soft_tendon_env.model.tension_limits import warn_beyond_limits
from soft_tendon_env.tools.checks import (
    checked_array,
    checked_count,
    checked_number,
    checked_type,
    shown_numbers,
)
from soft_tendon_env.tools.types import Array

Given = ArrayLike | None

STEPS_LOGGED = 4096
"""Integrator steps at most of a period that is linearised."""

DIFFERENCE_SHARE = 1e-4
"""Steps of the differences by which a period is linearised, as shares of the units."""

CONTACT_FACTOR = 1e-2
"""Factor of these steps among obstacles: a contact begins and ends within small ways."""

RATE_UNIT = 3.0
"""Unit of a rate, in units of its coordinate per second."""

LEAST_STATE_UNIT = 1e-3
"""Least unit of an effect's internal state."""

STRAIN_TOLERANCE = 1e-12
"""Relative tolerance of Newton's method for the strain: differences show what is above it."""

TOLERANCE_FACTOR = 2.0
"""Factor of the tolerance of steps, by which no step that was taken is refused."""

JUMP_RATIO = 1e3
"""Ratio of the differences to both sides from which on the larger one is a jump."""


class SimulationDiverged(RuntimeError):
    """Raised where no integrator step of the smallest allowed size succeeds.

    Attributes `state`, `cause`, `command` and `unit` are the arguments.

    Args:
        state: the last good one.
        cause: why no step succeeds.
        command: (n_a,) under which it happened.
        unit: of the command, "N" or "m".
    """

    def __init__(self, state: State, cause: str, command: Array, unit: str = "N") -> None:
        super().__init__(state, cause, command, unit)  # what it is pickled as
        self.state = state
        self.cause = cause
        self.command = command
        self.unit = unit

    def __str__(self) -> str:
        if self.unit == "N":
            kind = "tensions"
        else:
            kind = "commands"
        return (
            f"no step succeeds at {self.state.time:.6g} s under {kind}"
            f" {shown_numbers(self.command)} {self.unit}: {self.cause}"
        )


class NoEquilibriumError(ValueError):
    """Raised where an arm has no stable equilibrium to begin at, under its loads and tensions."""


class StepReport(NamedTuple):
    """Statistics of one call of `Simulation.step`: integrator steps, estimated error and cost."""

    steps: int  # accepted
    rejected: int  # steps that failed and were tried again at a smaller size
    # [m], sum of the estimated errors of the steps, as root mean square displacement of the rod:
    # that of the tip is two to three times as large; where damping is light they grow in what
    # follows
    error: float
    evaluations: int  # of the equation of motion, those of rejected steps with them


class Trajectory(NamedTuple):
    """Sampled motion, the initial state first."""

    time: Array  # (samples,) [s]
    q: Array  # (samples, n)
    q_dot: Array  # (samples, n)
    tip_pose: Array  # (samples, 4, 4)
    # (samples - 1, steps per sample, n_a) in Model.command_unit, as held over each integrator step
    command: Array
    final: State  # at the end, to go on from
    steps: int  # integrator steps that were accepted
    rejected: int  # those that were tried again at half their size
    error: float  # [m], as in StepReport
    evaluations: int  # of the equation of motion


class Rollout(NamedTuple):
    """Simulated motion over N periods and its linearisation.

    There are n coordinates, n_a tendons, m internal states of effects, k forces.

    The derivatives are those of a linearly implicit method with the matrices of the period's
    beginning, see docs/explanation/derivatives.md: 2 to 15 percent of the largest entry off on most
    arms, all of it at an impact.
    """

    q: Array  # (N + 1, n) where every period begins, and where the last one ends, as the next four
    q_dot: Array  # (N + 1, n)
    effects: Array  # (N + 1, m)
    tip_pose: Array  # (N + 1, 4, 4)
    tip_jacobian: Array  # (N + 1, 6, n) body Jacobian
    by_state: Array  # (N, 2 n, 2 n) of (q, q_dot) at the end of a period by those at its beginning
    by_tension: Array  # (N, 2 n, n_a) by tensions [N] added throughout it
    by_force: Array  # (N, 2 n, k) by generalised forces added throughout it


class Linearization(NamedTuple):
    """End of a period and its derivatives.

    There are s = 2 n + m numbers of a state: n coordinates, their rates, m internal states.

    Columns are by the numbers of the state before, then by the n_a commands; angular components
    before linear ones.
    """

    next: State  # at the end of the period
    state: Array  # (s, s) of the next state by the state
    command: Array  # (s, n_a) of the next state by the command
    tip: Array  # (6, s + n_a) body twist of the next tip pose [rad, m]
    tip_twist: Array  # (6, s + n_a) of the next body twist of the tip [rad/s, m/s]


class Simulation:
    """Simulates a model one control step at a time.

    Commands are held over a step (zero-order hold); arguments are checked.

    Args:
        model: of the arm.
        state: where the simulation begins; None is the stress-free shape at rest.

    Raises:
        TypeError: for a model or a state of another type.
        ValueError: for a state that is not one of the model.
    """

    def __init__(self, model: Model, state: State | None = None) -> None:
        self.model = checked_type("model", model, Model, "see build_model")
        self._method = step_method(model)
        self._unit = model.command_unit
        tension_limits = model.discretisation.tension_limits
        limits = model.scene.effects.command_limits(tension_limits)
        self._limits = limits.tolist()
        self._scratch = make_scratch(model.arm, self._method.columns, STEPS_LOGGED)
        self._plan: Plan | None = None  # of the last rollout, for others of its shape
        self.reset()
        if state is not None:
            self.state = state

    def __repr__(self) -> str:
        time = self._motion.clock[0]
        return f"Simulation({self.model!r} at {time:g} s)"

    def reset(
        self,
        q: Given = None,
        q_dot: Given = None,
        *,
        time: float = 0.0,
        effects: Given = None,
        tension: Given = None,
    ) -> State:
        """Resets the simulation to coordinates and rates at a time.

        Args:
            q: coordinates (n,); None is zero.
            q_dot: rates (n,) of the coordinates; None is zero.
            time: of the state [s].
            effects: the effects' internal states (m,), see State. None is those of an arm that the
                tensions have held at q since long before.
            tension: the tensions (n_a,) [N] that held the arm; None is zero.

        Returns:
            The new state.

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
        """
        model = self.model
        seconds = checked_number("time", time, -np.inf, "a finite number")
        clock = np.array([seconds])
        still = np.zeros(model.coordinate_count)
        no_tension = np.zeros(model.tendon_count)
        if q is None:
            q = still
        start = checked_array("q", q, still.shape)
        if q_dot is None:
            q_dot = still
        rate = checked_array("q_dot", q_dot, still.shape)
        if tension is None:
            tension = no_tension
        command = model.command(tension, start)
        strain = model.packed_strain(start)
        if effects is None:
            states = self._rest_states(strain, command)
        else:
            states = checked_array("effects", effects, model.arm.effects.state.shape)
        motion = Motion(start, rate, strain, states, clock)
        self._take(motion, model.scene.integrator.step)
        return self.state

    def _rest_states(self, strain: Array, command: Array) -> Array:
        """Internal states (m,) of the effects at rest at a packed strain.

        A command (n_a,) has always held the arm there.
        """
        work = self._scratch.work
        if work.inputs.state.size:
            work.strain.xi[:] = strain
            arm = self.model.arm
            rest_states(arm, command, work.inputs, work.strain, work.loads)
        return work.inputs.state.copy()

    def reset_at_rest(self, tension: Given = None, *, time: float = 0.0) -> State:
        """Resets the simulation to the static equilibrium under tensions and the loads at time 0.

        Where the branch of stable equilibria ends the arm is let go to where it settles.

        Args:
            tension: (n_a,) [N]; None is zero.
            time: which the state's time is set to [s].

        Returns:
            The new state.

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes or numbers that are not finite.
            NoEquilibriumError: if the arm has no stable equilibrium under them.
        """
        u = np.zeros(self.model.tendon_count)
        if tension is not None:
            u = checked_array("tension", tension, u.shape)
        has_loads = bool(self.model.arm.effects.load)
        if not u.any() and not has_loads:
            return self.reset(time=time)
        equilibrium = static_equilibrium(self.model, u, settle=True)
        if not equilibrium.converged:
            text = (
                f"{self.model.scene.name!r} is at rest nowhere under its loads and tensions"
                f" {shown_numbers(u)} N: {equilibrium.reason}"
            )
            raise NoEquilibriumError(
                f"{text}. Give an initial state: that of Simulation(model) is the stress-free shape"
            )
        return self.reset(equilibrium.q, time=time, tension=u)

    @property
    def state(self) -> State:
        """State of the simulation, a copy.

        Set, it is checked and taken whole; ValueError or TypeError leave the simulation as it was.
        """
        return state_of(self.model, self._motion, self._step)

    @state.setter
    def state(self, state: State) -> None:
        self._take(*checked_motion(self.model, state))

    def _take(self, motion: Motion, step: float) -> None:
        """Goes on from a motion, with integrator steps of a length [s] as the next guess."""
        self._motion = motion
        self._step = step
        q = motion.q[None].copy()
        q_dot = motion.q_dot[None].copy()
        tip_pose = np.eye(4)[None].copy()
        work = self._scratch.work
        advance.tip_pose(self.model.arm, motion, work, tip_pose[0])
        self._sample = Record(q, q_dot, tip_pose)

    def step(self, command: ArrayLike, duration: float) -> StepReport:
        """Integrates the equation of motion under a constant command.

        The steps are equal, and of at most the scene's. A command beyond `tension_limits` is taken
        as it is, with a TensionLimitWarning.

        Args:
            command: (n_a,) in the unit `Model.command_unit`.
            duration: [s], at least 0.

        Returns:
            Numbers of steps, their estimated error and their cost.

        Raises:
            TypeError: for arguments that are no numbers.
            ValueError: for wrong shapes, numbers that are not finite, or a negative duration.
            SimulationDiverged: if no integrator step of the smallest size succeeds.
        """
        u = checked_array("command", command, (self.model.tendon_count,))
        duration = checked_number("duration", duration, 0.0, "a number of seconds, at least 0")
        if duration == 0.0:
            return StepReport(0, 0, 0.0, 0)
        warn_beyond_limits(self._limits, u, self._unit)
        control = step_control(self.model, duration)
        steps = step_count(duration, control)
        commands = u[None].repeat(steps, axis=0)
        return self._run(commands, control, self._sample)

    def linearize(self, command: ArrayLike, duration: float) -> Linearization:
        """Linearises `step` under a constant command; the simulation stays where it is.

        Central differences with the integrator's steps held, by 1e-4 of units,
        `Model.coordinate_scale`, limits of commands and internal states, among obstacles by a
        hundredth of that. The error is below 1e-6 of the largest entry of a block where the motion
        is smooth. At a kink both sides are mixed; where one jumps or fails, the other one counts.

        Args:
            command: (n_a,) in the unit `Model.command_unit`.
            duration: of the period [s].

        Returns:
            The end of the period and its derivatives.

        Raises:
            TypeError: for arguments that are no numbers.
            ValueError: for wrong shapes, numbers that are not finite, or a duration of too many
                steps.
            SimulationDiverged: if the step itself diverges.
            LinAlgError: if both sides of a difference fail.
        """
        start = self._motion.copy()
        step = self._step
        try:
            report = self.step(command, duration)
            steps = report.steps
            if steps > STEPS_LOGGED:
                raise ValueError(
                    f"duration should be of at most {STEPS_LOGGED} integrator steps, not {steps}"
                )
            u = np.asarray(command, dtype=np.float64)
            parts = [start.q, start.q_dot, start.state, u]
            inputs = np.concatenate(parts)
            # a period of no length has one step of none
            taken = np.array([[0.0, self._method.columns]])
            if steps:
                taken = self._scratch.taken[:steps].copy()
            return period_derivatives(self.model, start, inputs, taken, self.state)
        finally:
            self._take(start.copy(), step)

    def rollout(
        self,
        commands: ArrayLike,
        duration: ArrayLike,
        *,
        forces: Given = None,
        steps: int | None = None,
    ) -> Rollout:
        """Simulates N periods from the present state and linearises them; the simulation stays.

        Args:
            commands: (N, n_a), each held for a period, or (N, p, n_a) of the p parts of a period,
                in the unit `Model.command_unit`.
            duration: of a period [s], or (p,) of its parts.
            forces: generalised forces (n, k) by which to differentiate besides; None: no forces.
            steps: of a period that the linearisation takes; None is as many as resolve the slowest
                vibration.

        Returns:
            The motion at the ends of the periods and its derivatives.

        Raises:
            TypeError: for arguments that are no numbers.
            ValueError: for wrong shapes, numbers that are not finite, or durations that are not
                positive.
            SimulationDiverged: if no integrator step of the smallest size succeeds.
            LinAlgError: if the motion has no linearisation.
        """
        model = self.model
        n = model.coordinate_count
        n_a = model.tendon_count
        has_parts = np.ndim(duration) > 0
        shape_of_durations = (None,) * np.ndim(duration)
        durations = checked_array("duration", duration, shape_of_durations)
        parts = np.atleast_1d(durations)
        shape: tuple[int | None, ...] = (None, n_a)
        if has_parts:
            shape = (None, parts.size, n_a)
        played = checked_array("commands", commands, shape)
        no_forces = np.empty((n, 0))
        if forces is None:
            others = no_forces
        else:
            others = checked_array("forces", forces, (n, None))
        shortest = float(parts.min(initial=0.0))
        checked_number("duration", shortest, 0.0, "a number of seconds, at least 0")
        whole = float(parts.sum())
        checked_number("duration", whole, SHORTEST, "a positive number of seconds")
        periods = checked_count("commands", len(played), 1)
        plan = self._plan_of(periods, parts.size, others)
        plan.command[:] = played.reshape(plan.command.shape)
        plan.duration[:] = parts
        warn_beyond_limits(self._limits, plan.command, self._unit)
        period = float(plan.duration.sum())
        if steps is None:
            steps = math.ceil(period * linear_rate(model))
        else:
            steps = checked_count("steps", steps, 1)
        control = step_control(model, period)
        scheme = Scheme(self._method, control)
        motion = self._motion.copy()
        code, row = linearised_rollout(model.arm, scheme, motion, steps, self._scratch, plan)
        if code != status.OK:
            last = len(plan.command) - 1
            command_row = min(row, last)
            failed_command = plan.command[command_row, 0]
            raise self._divergence(code, motion, failed_command, control)
        if not np.isfinite(plan.jacobian).all():
            raise np.linalg.LinAlgError(
                "there is no linearisation of this motion: the matrix of an implicit step is"
                " singular"
            )
        borders = [2 * n, 2 * n + n_a]
        jacobian = plan.jacobian.copy()
        by_inputs = np.split(jacobian, borders, axis=2)
        results = (plan.q, plan.q_dot, plan.state, plan.tip_pose, plan.tip_jacobian)
        outcome = [values.copy() for values in results]
        return Rollout(*outcome, *by_inputs)

    def _plan_of(self, periods: int, parts: int, forces: Array) -> Plan:
        """Plan with forces (n, k) besides those of the tendons: the last one if it has its shape.

        To make one takes as long as two steps of a period.
        """
        tendons = self.model.tendon_count
        inputs = tendons + forces.shape[1]
        plan = self._plan
        if plan is not None:
            has_steps = plan.command.shape[:2] == (periods, parts)
            has_inputs = plan.forces.shape[1] == inputs
            if has_steps and has_inputs:
                plan.forces[:, tendons:] = forces
                return plan
        self._plan = make_plan(self.model.arm, periods, parts, forces)
        return self._plan

    @property
    def tip_pose(self) -> Array:
        """Pose of the tip in the world frame, (4, 4)."""
        return self._sample.tip_pose[0].copy()

    def _run(self, commands: Array, control: Control, record: Record) -> StepReport:
        """Advances by control.step under each row of commands (rows, n_a); unchecked.

        The record's samples are evenly among them.
        """
        motion = self._motion
        scheme = Scheme(self._method, control)
        durations = np.full(len(commands), control.step)
        outcome = advance.advance(
            self.model.arm,
            scheme,
            commands,
            durations,
            motion,
            self._step,
            self._scratch,
            record,
        )
        self._step = outcome.step
        if outcome.status == status.OK:
            return StepReport(outcome.steps, outcome.rejected, outcome.error, outcome.evaluations)
        self._take(motion, outcome.step)
        command = commands[outcome.row]
        raise self._divergence(outcome.status, motion, command, control)

    def _divergence(
        self, code: int, motion: Motion, command: Array, control: Control
    ) -> SimulationDiverged:
        """Error of a status at a motion, under a command (n_a,)."""
        model = self.model
        cause = cause_of(code, model, control)
        if code == status.NO_STRAIN:
            limit = nearest_limit(model.arm, model.grid, motion.q, motion.xi)
            cause += f"; in the last good state {limit}"
        state = state_of(model, motion, self._step)
        return SimulationDiverged(state, cause, command, self._unit)


def simulate(
    model: Model,
    command: Command,
    duration: float,
    sample_period: float,
    initial: State | None = None,
) -> Trajectory:
    """Simulates the motion of an arm under commands and samples it at equal periods.

    Commands beyond `tension_limits` are used as given, with a TensionLimitWarning.

    Args:
        model: of the arm.
        command: in the unit `Model.command_unit`. An array (n_a,) is constant. A table (duration /
            sample_period, n_a) has a row per sample period. A function of time [s] returns (n_a,);
            it is sampled at the middle of each integrator step and held over it: second order,
            exact for jumps at the borders of steps.
        duration: of the motion [s], a multiple of the sample period.
        sample_period: time between two samples [s].
        initial: first state. None is rest without tension; `Simulation(model).state` is the
            stress-free shape.

    Returns:
        The sampled motion, its first sample the initial state.

    Raises:
        TypeError: for arguments of wrong types.
        ValueError: for wrong shapes, numbers that are not finite, or a duration that is no multiple
            of the period.
        NoEquilibriumError: if the arm has no equilibrium to begin at.
        SimulationDiverged: if no integrator step of the smallest size succeeds.
    """
    simulation = Simulation(model, initial)
    period = checked_number(
        "sample_period", sample_period, SHORTEST, "a positive number of seconds"
    )
    duration = checked_number("duration", duration, 0.0, "a number of seconds, at least 0")
    control = step_control(model, period)
    step_count(duration, control)
    samples = round(duration / period)
    difference = abs(samples * period - duration)
    if difference > 1e-9 * max(duration, period):
        raise ValueError(
            f"duration should be a multiple of sample_period {period:g} s, not {duration:g} s"
        )
    per_sample = round(period / control.step)
    begin = simulation.state.time
    commands = command_table(model, command, begin, samples, per_sample, control.step)
    warn_beyond_limits(simulation._limits, commands, model.command_unit)
    if initial is None:
        start = simulation.reset_at_rest()
    else:
        start = simulation.state
    # the first sample is the start
    values = [start.q, start.q_dot, simulation.tip_pose]
    count = samples + 1
    stacked = [value[None].repeat(count, axis=0) for value in values]
    record = Record(*stacked)
    report = StepReport(0, 0, 0.0, 0)
    if samples:
        every_command = commands.reshape(-1, model.tendon_count)
        rows_after = (rows[1:] for rows in record)
        later = Record(*rows_after)
        report = simulation._run(every_command, control, later)
    counts = np.arange(samples + 1, dtype=np.float64)
    times = start.time + period * counts
    return Trajectory(
        times,
        *record,
        command=commands,
        final=simulation.state,
        steps=report.steps,
        rejected=report.rejected,
        error=report.error,
        evaluations=report.evaluations,
    )


def ends(model: Model, start: Motion, taken: Array, inputs: Array) -> tuple[Array, Array, Array]:
    """States, tip poses and twists after a period, infinite where it fails.

    They are (copies, s), (copies, 4, 4) and (copies, 6). Raises LinAlgError.

    inputs (copies, s + n_a): numbers of the state where it begins, and commands; taken (steps, 2):
    length [s] and columns of every step, the same for all copies, since an order that follows their
    errors would jump.
    """
    arm = model.arm
    n = model.coordinate_count
    count = len(inputs)
    no_places = model.grid.places(np.zeros(0), np.zeros(0))
    batch = make_batch(arm, no_places, start, 0.0, count)
    rows = batch.rows
    failed = np.zeros(count, dtype=bool)
    states = start.state.size
    begin_of_state = 2 * n
    begin_of_command = begin_of_state + states
    rows.q[:] = inputs[:, :n]
    rows.q_dot[:] = inputs[:, n:begin_of_state]
    rows.state[:] = inputs[:, begin_of_state:begin_of_command]
    commands = inputs[:, begin_of_command:]
    if states:  # a memory remembers the strain before a step
        for row, q in enumerate(rows.q):
            with contextlib.suppress(StrainLimitError):
                rows.xi[row] = model.packed_strain(q)

    # the steps that were taken, again: none is refused, and none has another length
    method = step_method(model)._replace(strain_tolerance=STRAIN_TOLERANCE)
    longest = taken[:, 0].sum()
    control = step_control(model, longest or 1.0)
    tolerance = TOLERANCE_FACTOR * control.tolerance
    control = control._replace(adaptive=False, tolerance=tolerance)
    scratch = make_scratch(arm, method.columns)
    tape = make_tape(arm, 0, 0)
    held_commands = commands[:, None].copy()
    for number, (length, columns) in enumerate(taken):
        fixed = method._replace(columns=int(columns), least=int(columns))
        scheme = Scheme(fixed, control, begins=number == 0)
        going_on = np.flatnonzero(~failed)
        durations = np.full((count, 1), length)
        step_rows(batch, scheme, going_on, held_commands, durations, scratch, tape)
        failed |= batch.outcome.status != status.OK
    if failed[0]:
        cause = status.MESSAGES[batch.outcome.status[0]]
        raise np.linalg.LinAlgError(f"the motion has no derivative: {cause}")

    parts = [rows.q, rows.q_dot, rows.state]
    state = np.hstack(parts)
    tip_pose = batch.reading.tip_pose
    tip_twist = batch.reading.tip_twist
    for values in (state, tip_pose, tip_twist):
        values[failed] = np.inf
    return state, tip_pose, tip_twist


def _slopes(values: Array, step: Array) -> Array:
    """Derivatives (.., inputs) of values by inputs, from differences on both sides.

    values (1 + 2 inputs, ..) are those at the inputs, then a step (inputs,) to the right of every
    input, then to the left.

    They are central; where a value jumps on one side, they are those of the other side.
    """
    count = step.size
    middle = values[0]
    right = values[1 : count + 1] - middle
    left = middle - values[count + 1 :]
    central = 0.5 * (left + right)
    backward = _jumps(right, left)
    forward = _jumps(left, right)
    jumps = [backward, forward]
    difference = np.select(jumps, [left, right], central)
    return np.moveaxis(difference, 0, -1) / step


def _jumps(side: Array, other: Array) -> NDArray[np.bool_]:
    """Mask of entries whose difference to one side is a jump beside that to the other.

    A difference beside none is no jump but a kink, as where friction holds something at rest.
    """
    bound = JUMP_RATIO * abs(other)
    is_far_larger = abs(side) > bound
    moves = other != 0.0
    fails = np.isinf(side)
    return np.asarray(is_far_larger & (moves | fails))


@np.errstate(invalid="ignore")
def period_derivatives(
    model: Model, start: Motion, inputs: Array, taken: Array, following: State
) -> Linearization:
    """Linearization of a period that leads from inputs to a state by the steps taken, see `ends`.

    Raises LinAlgError.
    """
    # steps of the differences, by the unit of every input
    effects = model.scene.effects
    scale = model.coordinate_scale()
    state_size = np.abs(start.state)
    state_unit = np.maximum(state_size, LEAST_STATE_UNIT)
    limits = effects.command_limits(model.discretisation.tension_limits)
    command_unit = np.abs(limits).max(axis=1)
    rate_unit = RATE_UNIT * scale
    units = [scale, rate_unit, state_unit, command_unit]
    unit = np.concatenate(units)
    step = DIFFERENCE_SHARE * unit
    chosen = effects.chosen().values()
    is_contact = (effect.is_contact for effect in chosen)
    has_contact = any(is_contact)
    if has_contact:
        step *= CONTACT_FACTOR

    # row 0 has the inputs themselves, then one row for every step to the right, and to the left
    changes = np.diag(step)
    parts = [inputs, inputs + changes, inputs - changes]
    all_inputs = np.vstack(parts)
    state, tip_pose, tip_twist = ends(model, start, taken, all_inputs)
    by = _slopes(state, step)
    pose_slopes = _slopes(tip_pose, step)
    twists = _slopes(tip_twist, step)
    if not np.isfinite(by).all():
        raise np.linalg.LinAlgError(
            "the motion has no derivative: on either side of it a step fails"
        )
    # in the tip frame: the vector of R^T dR, which is antisymmetric, and R^T dr
    rotation = tip_pose[0, :3, :3]
    moved = np.einsum("ji,jkm->ikm", rotation, pose_slopes[:3])
    about_x = moved[2, 1]
    about_y = moved[0, 2]
    about_z = moved[1, 0]
    angular = [about_x, about_y, about_z]
    linear = moved[:, 3]
    tip = np.stack([*angular, *linear])
    size = len(by)
    by_state = by[:, :size]
    by_command = by[:, size:]
    return Linearization(following, by_state, by_command, tip, twists)
