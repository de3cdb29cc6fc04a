"""Sensitivities of motions: derivatives of states and measurements along a simulation by numbers of the scene, with its steps held."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.mechanics.motion.advance import Record, Scheme, advance
from soft_tendon_env.mechanics.motion.batch import Places
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.model.held_motion import Begin, HeldMotion
from soft_tendon_env.model.measurements import Measurements, derivatives_of, measurements_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.state import State
from soft_tendon_env.model.static_sensitivity import static_sensitivities
from soft_tendon_env.model.step_control import step_control, step_method
from soft_tendon_env.scene.parameters import scene_parameters
from soft_tendon_env.tools.checks import checked_array, checked_number
from soft_tendon_env.tools.types import Array

STEPS_AT_ONCE = 64
"""Steps of a motion that its log has room for at first."""


class MotionDerivatives(NamedTuple):
    """Derivatives of a motion by p numbers, the last axis; those of poses are body twists, see Measurements."""

    state: Array  # (samples, s, p)
    tip_twist: Array  # (samples, 6, p) of the body twist of the tip
    tip_pose: Array  # (samples, 6, p)
    stations: Array  # (samples, stations, 6, p)
    tendon_length: Array  # (samples, n_a, p)
    strain: Array  # (samples, sensors, 6, p)


class MotionSensitivities(NamedTuple):
    """States and measurements of a motion, the initial ones first, and their derivatives."""

    time: Array  # (samples,) [s]
    state: Array  # (samples, s) coordinates, rates and internal states, one after the other
    reading: Measurements
    parameters: MotionDerivatives  # by the parameters, in their order, each in the unit of its key: see Parameter


def motion_sensitivities(
    model: Model,
    commands: ArrayLike,
    period: float,
    parameters: Iterable[str],
    *,
    initial: State | None = None,
    initial_derivative: ArrayLike | None = None,
    stations: ArrayLike = (),
    sensors: ArrayLike = (),
) -> MotionSensitivities:
    """Sensitivities of a motion under commands (periods, n_a), each held over a period [s], at the ends of periods, with the integrator's
    steps held.

    commands: tensions [N], or what the scene's effects take in their place, see `Model.command_unit`.
    parameters: dotted keys of numbers of the scene, `"segments.*.damping"`, see `scene_parameters`.
    initial: state to start from; by default at rest without tension, an equilibrium that moves with the parameters.
    initial_derivative: (s, p) of a given initial state by the parameters; zero by default, so that its numbers are held.
    stations, sensors: arc lengths (m,) and (k,) [m] at which poses and strains are read.

    They are differences of fourth order of motions by arms with numbers a little off, and cost four motions per parameter. Raises what
    `simulate` raises, ConfigurationError for keys, FloatingPointError where an arm with other numbers has no such motion.
    """
    names = tuple(parameters)
    chosen = scene_parameters(model.scene, names)
    places = model.grid.places(model.arc_lengths("stations", stations), model.arc_lengths("sensors", sensors))
    if initial is None and initial_derivative is not None:
        raise ValueError("initial_derivative should be left out without an initial state, which is then an equilibrium")
    table = checked_array("commands", commands, (None, model.tendon_count))
    trajectory = simulate(model, table, len(table) * checked_number("period", period, 0.0, "a number of seconds"), period, initial)
    simulation = Simulation(model, initial)
    begin = simulation.reset_at_rest() if initial is None else simulation.state
    held = _held(model, trajectory.command, period, begin, places)
    slopes = held.by_parameters(chosen, _begin(model, begin, names, initial is None, initial_derivative))
    (state, _, rows), (by_state, twist, by_rows) = (np.split(part, held.borders, axis=1) for part in (held.rows(model), slopes))
    derivatives = MotionDerivatives(by_state, twist, *derivatives_of(rows, by_rows, places))
    return MotionSensitivities(trajectory.time, state, measurements_of(rows, places), derivatives)


def _held(model: Model, commands: Array, period: float, state: State, places: Places) -> HeldMotion:
    """The motion from a state under commands (periods, steps per period, n_a), as periods of which the first is no time long."""
    method, start = step_method(model), Motion(state.q, state.q_dot, model.grid.packed(state.strain), state.effects, np.array([state.time]))
    rows = commands.reshape(-1, model.tendon_count)
    taken = _log(model, Scheme(method, step_control(model, period)), rows, start, state.step)
    ends = commands.shape[1] * np.arange(len(commands) + 1) - 0.5  # between rows of commands
    first = np.append(0, np.searchsorted(taken[:, 0], ends))
    return HeldMotion(model, method, taken, first, rows, start, places, make_scratch(model.arm, method.columns))


def _log(model: Model, scheme: Scheme, commands: Array, start: Motion, step: float) -> Array:
    """Steps (steps, 4) that a motion takes, see Scratch.taken."""
    durations, room = np.full(len(commands), scheme.control.step), STEPS_AT_ONCE
    none = Record(np.empty((0, start.q.size)), np.empty((0, start.q.size)), np.empty((0, 4, 4)))
    while True:
        scratch = make_scratch(model.arm, scheme.method.columns, room)
        motion = start.copy()
        steps = advance(model.arm, scheme, commands, durations, motion, step, scratch, none).steps
        if steps <= room:
            return np.asarray(scratch.taken[:steps])
        room = steps


def _begin(model: Model, state: State, names: tuple[str, ...], at_rest: bool, derivative: ArrayLike | None) -> Begin:
    """States from which arms with other numbers begin: at rest, or with these derivatives."""
    held = np.concatenate([state.q, state.q_dot, state.effects])
    if not at_rest:
        slope = (
            np.zeros((held.size, len(names)))
            if derivative is None
            else checked_array("initial_derivative", derivative, (held.size, len(names)))
        )
        return lambda other, i, change: held + change * slope[:, i]
    rest = static_sensitivities(model, state.q, np.zeros(model.tendon_count), names).parameters.q

    def begin(other: Model, i: int, change: float) -> Array:
        own = Simulation(other).reset(state.q + change * rest[:, i], time=state.time)
        return np.concatenate([own.q, own.q_dot, own.effects])

    return begin
