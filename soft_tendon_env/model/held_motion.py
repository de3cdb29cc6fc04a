"""Motion of a model with its steps as they were taken, repeated from states and by models that are a little off."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soft_tendon_env.mechanics.motion.batch import Places, make_reading
from soft_tendon_env.mechanics.motion.extrapolation import Extrapolated
from soft_tendon_env.mechanics.motion.held_motion import replay_periods
from soft_tendon_env.mechanics.motion.scratch import Motion, Scratch, make_scratch
from soft_tendon_env.mechanics.motion.status import MESSAGES, OK
from soft_tendon_env.mechanics.types import IntVector
from soft_tendon_env.model.measurements import rows_of
from soft_tendon_env.model.model import Model
from soft_tendon_env.model.parameter_differences import derivative_by
from soft_tendon_env.scene.parameters import Parameter
from soft_tendon_env.tools.types import Array

Begin = Callable[[Model, int, float], Array]
SHARE = 1e-4
"""Step of a parameter as a share of its size: less than at rest, since in a long motion vibrations get out of phase."""
RATE = 3.0
"""Unit of a rate, as coordinates' units per second."""
LEAST_STATE = 1e-3
"""Least unit of an internal state, which is otherwise its own size."""
STRAIN = 1e-12
"""Tolerance of the strain's Newton: less, and its rest would show in differences."""


class HeldMotion(NamedTuple):
    """Motion of a model whose steps and columns are those of a log."""

    model: Model
    method: Extrapolated
    taken: Array  # (steps, 4), see Scratch.taken
    first: IntVector  # (periods + 1) first step of each period, and one past the last
    commands: Array  # (rows, n_a)
    start: Motion
    places: Places  # where it is measured at the ends of periods
    scratch: Scratch  # of the model's arm

    @property
    def borders(self) -> tuple[int, int]:
        """Numbers of a row that are states, and with them the tip's twist; then come measurements, see `rows_of`."""
        s = 2 * self.start.q.size + self.start.state.size
        return s, s + 6

    def rows(self, model: Model, state: Array | None = None) -> Array:
        """States, body twists of the tip and measurements at the ends of periods (periods, s + 6 + numbers), by a model and from a state
        (s,) of its own.

        Raises FloatingPointError where there is no such motion.
        """
        arm, n, periods = model.arm, model.coordinate_count, self.first.size - 1
        motion, alike = self.start.copy(), type(arm.strain) is type(self.model.arm.strain)
        if state is not None:
            motion = motion._replace(q=state[:n].copy(), q_dot=state[n : 2 * n].copy(), state=state[2 * n :].copy())
        states, reading = np.empty((periods, 2 * n + motion.state.size)), make_reading(arm, self.places, periods)
        method, scratch = self.method._replace(strain_tolerance=STRAIN), self.scratch if alike else make_scratch(arm, self.method.columns)
        scratch.work.xi_dot[:] = 0.0  # which effects that make tensions read of the evaluation before
        done = replay_periods(arm, method, (self.taken, self.first), self.commands, motion, self.places, scratch, states, reading)
        if done != OK:
            raise FloatingPointError(f"the motion could not be differentiated at {motion.clock[0]:g} s: {MESSAGES[done]}")
        return np.hstack([states, reading.tip_twist, rows_of(reading)])

    def by_parameters(self, parameters: tuple[Parameter, ...], begin: Begin) -> Array:
        """Derivatives of the rows by parameters of the scene (periods, s + 6 + numbers, p).

        begin: the state (s,) that the motion begins from by a model with another value of a parameter, its place among the parameters, and
        by how much it is off. Raises ConfigurationError, FloatingPointError.
        """
        scale, states = self.model.coordinate_scale(), self.start.state
        unit = np.concatenate([scale, RATE * scale, np.maximum(np.abs(states), LEAST_STATE)])
        found = []
        for i, parameter in enumerate(parameters):

            def evaluate(other: Model, change: float, i: int = i) -> Array:
                rows = self.rows(other, begin(other, i, change))
                rows[:, : unit.size] /= unit
                return rows

            slopes = derivative_by(self.model, parameter, evaluate, SHARE)
            slopes[:, : unit.size] *= unit
            found.append(slopes)
        return np.stack(found, axis=2) if found else np.empty((*self.rows(self.model).shape, 0))
