"""Exact linearisation of a simulated period: derivatives of its end by its state and command, with the integrator's steps held."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion.batch import make_reading
from soft_tendon_env.mechanics.motion.course import make_differences
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.linearised import linearise, tip_jacobian
from soft_tendon_env.mechanics.motion.reading_slopes import ReadingSlopes, differentiate_reading
from soft_tendon_env.mechanics.motion.scratch import Motion, make_scratch
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.mechanics.motion.tangents import make_tangents
from soft_tendon_env.model.held_motion import LEAST_STATE, RATE, STRAIN, HeldMotion
from soft_tendon_env.model.measurements import derivatives_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.state import State
from soft_tendon_env.scene.parameters import Parameter
from soft_tendon_env.tools.types import Array

MOVED = 1e-4
"""Part of its unit by which an input is moved to either side: errors of second order and of rounding are then alike."""
FEW_STEPS = 16
NOWHERE = np.zeros(0)


class Linearization(NamedTuple):
    """The end of a period and its derivatives, with s = 2 n + m numbers of a state: n coordinates, their rates, m internal states.

    Angular components before linear ones; a column is by one number of the state before, by one command, or by one of p parameters of the
    scene, in the unit of its key, from a state with the same numbers. In what is read they stand side by side, s + n_a + p of them.
    """

    next: State
    state: Array  # (s, s) of the next state by the state
    command: Array  # (s, n_a) of the next state by the command
    tip: Array  # (6, s + n_a + p) body twist of the next tip pose [rad, m]
    tip_twist: Array | None = None  # (6, s + n_a + p) of the next body twist of the tip [rad/s, m/s]; it and the next two with sensors
    tendon_length: Array | None = None  # (n_a, s + n_a + p) of the next lengths of the tendons [m]
    strain: Array | None = None  # (sensors, 6, s + n_a + p) of the next strains at the sensors
    parameters: Array | None = None  # (s, p) of the next state by the parameters, where there are some


class Linearizer:
    """Kernels' room and settings for the linearisation of one model's motions."""

    def __init__(self, model: Model, method: Extrapolated) -> None:
        self.model = model
        self._method = method._replace(strain_tolerance=STRAIN)
        limits = np.array([tendon.tension_limits for tendon in model.scene.tendons])
        scale, command = model.coordinate_scale(), np.abs(model.scene.effects.command_limits(limits)).max(axis=1)
        self._unit = np.concatenate([scale, RATE * scale, np.full(model.arm.effects.state.size, LEAST_STATE), command])
        self._columns = 0
        self.scratch = make_scratch(model.arm, method.columns, FEW_STEPS)

    def make_room(self, steps: int) -> None:
        """Makes room for a log of so many steps."""
        self.scratch = make_scratch(self.model.arm, self._method.columns, steps)

    def linearized(self, motion: Motion, commands: Array, steps: int, following: State, sensors: Array | None = None) -> Linearization:
        """The linearisation of a motion, which it advances, over the steps in the log; following: the state that they led to."""
        arm, s = self.model.arm, 2 * motion.q.size + motion.state.size
        taken = self.scratch.taken[:steps].copy()
        columns = max(2, int(taken[:, 2].max(initial=0.0)))
        if columns > self._columns:
            self._columns, self._tangents = columns, make_tangents(arm, columns)
            self._difference = make_differences(arm, self._unit.copy(), columns * (columns + 1) // 2)
        self._difference.unit[:] = MOVED * self._unit
        states = slice(s - motion.state.size, s)
        self._difference.unit[states] = MOVED * np.maximum(np.abs(motion.state), LEAST_STATE)
        jacobian = np.empty((6, motion.q.size))
        done = linearise(arm, self._method, taken, commands, motion, self.scratch, self._difference, self._tangents)
        if done == OK:
            done = tip_jacobian(arm, self._method, commands[-1], motion, self.scratch, jacobian)
        if done != OK:
            raise FloatingPointError(f"the motion could not be differentiated at {motion.clock[0]:g} s: {MESSAGES[done]}")
        end = self._tangents.begin[:s].copy()
        found = Linearization(following, end[:, :s].copy(), end[:, s:].copy(), jacobian @ end[: motion.q.size])
        if sensors is None:
            return found
        by_end = self._reading_slopes(motion, sensors)
        tip_twist, tendon_length, strain = (slopes @ end[: 2 * motion.q.size] for slopes in by_end)
        return found._replace(tip_twist=tip_twist, tendon_length=tendon_length, strain=strain)

    def with_parameters(self, found: Linearization, held: HeldMotion, parameters: tuple[Parameter, ...]) -> Linearization:
        """A linearisation of the one period of a held motion, with its derivatives by parameters of the scene besides."""
        begin = np.concatenate([held.start.q, held.start.q_dot, held.start.state])
        slopes = held.by_parameters(parameters, lambda *_: begin)
        *_, rows = np.split(held.rows(self.model), held.borders, axis=1)
        state, twist, measured = np.split(slopes, held.borders, axis=1)
        read = derivatives_of(rows, measured, held.places).first()
        moved = found._replace(parameters=state[0], tip=np.hstack([found.tip, read.tip_pose]))
        if found.tip_twist is None or found.tendon_length is None or found.strain is None:
            return moved
        return moved._replace(
            tip_twist=np.hstack([found.tip_twist, twist[0]]),
            tendon_length=np.hstack([found.tendon_length, read.tendon_length]),
            strain=np.concatenate([found.strain, read.strain], axis=2),
        )

    def held(self, motion: Motion, commands: Array, steps: int, sensors: Array | None) -> HeldMotion:
        """A motion from here over the steps in the log, as one period."""
        places = self.model.grid.places(NOWHERE, NOWHERE if sensors is None else sensors)
        start = motion.copy()
        taken = self.scratch.taken[:steps].copy()
        return HeldMotion(self.model, self._method, taken, np.array([0, steps]), commands, start, places, self.scratch)

    def _reading_slopes(self, motion: Motion, sensors: Array) -> ReadingSlopes:
        """Derivatives of readings at a motion, by its coordinates and rates."""
        arm, places, n = self.model.arm, self.model.grid.places(NOWHERE, sensors), motion.q.size
        slopes = ReadingSlopes(
            tip_twist=np.empty((6, 2 * n)), tendon_length=np.empty((arm.tendons.size, 2 * n)), strain=np.empty((sensors.size, 6, 2 * n))
        )
        unit, reading = MOVED * self._unit[: 2 * n], make_reading(arm, places, 2)
        failed = differentiate_reading(arm, places, motion, unit, self.scratch, reading, slopes)
        if failed != OK:
            raise FloatingPointError(f"what is measured could not be differentiated at {motion.clock[0]:g} s: {MESSAGES[failed]}")
        return slopes
