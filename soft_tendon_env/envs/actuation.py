"""Actuators: actions to tensions by scaling, limits, gain and offset errors, and delay."""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.randomization import Draw
from soft_tendon_env.scene.scene import Array
from soft_tendon_env.tools.configuration import ConfigurationError, Problem

MOST_LATENCY = 1_000
"""Control periods by which tensions can be late: every row keeps its tensions for that long."""


class ActionScale(NamedTuple):
    """Action scaling of [-1, 1]: to tensions between limits (n_a,) [N], or to changes of at most `increment` [N] if there is one."""

    least: Array
    greatest: Array
    increment: float | None

    def tension(self, action: Array, command: Array) -> Array:
        """Tensions (..., n_a) [N] asked for by actions (..., n_a) after `command` (..., n_a) [N], within the limits."""
        if self.increment is None:
            wanted = self.least + (0.5 * (self.greatest - self.least)) * (action + 1.0)
        else:
            wanted = command + self.increment * action
        return np.asarray(np.minimum(np.maximum(wanted, self.least), self.greatest))

    def action(self, tension: Array, command: Array) -> Array:
        """The actions (..., n_a) that ask for tensions (..., n_a) [N], or come as near to them as actions can."""
        if self.increment is None:
            wanted = 2.0 * (tension - self.least) / (self.greatest - self.least) - 1.0
        else:
            wanted = (tension - command) / self.increment
        return np.asarray(np.minimum(np.maximum(wanted, -1.0), 1.0))


class Actuation:
    """Rows of actuators. `command` (rows, n_a) [N] is what was last asked for."""

    def __init__(self, options: Options, limits: Array, start: Array, rows: int, substeps: int) -> None:
        """limits: (n_a, 2) [N]; start: tensions (n_a,) [N] at reset, held since long before; substeps: integrator steps a period.

        Raises ConfigurationError.
        """
        increment = options.tension_rate * options.control_period if options.action == "increment" else None
        self.actions = ActionScale(limits[:, 0].copy(), limits[:, 1].copy(), increment)
        self._start, self._substeps = start, substeps
        self._integrator_step = options.control_period / substeps
        self.start_action = self.actions.action(start, start)
        self.command = np.tile(start, (rows, 1))
        self._imperfect = options.randomize.of_actuators
        self._gain, self._offset = np.ones((rows, start.size)), np.zeros((rows, start.size))
        latency = options.randomize.latency[1]
        if latency > MOST_LATENCY * options.control_period or 0.0 < latency <= 0.5 * self._integrator_step:
            least, most = 0.5 * self._integrator_step, MOST_LATENCY * options.control_period
            allowed = f"0, or more than half an integrator step, {least:g} s, and at most {MOST_LATENCY} control periods, {most:g} s"
            raise ConfigurationError([Problem(("randomize", "latency"), f"is {latency:g}: it should be {allowed}")], "environment")
        longest = self._delay(latency)
        self._sent = np.tile(start, (rows, longest + substeps, 1)) if longest else None  # by integrator step, the newest last
        self._first = np.full(rows, longest)  # where in it the tensions of a period begin to act

    def _delay(self, latency: float) -> int:
        return round(latency / self._integrator_step)

    def begin(self, row: int, draw: Draw) -> None:
        """A new episode of a row."""
        self.command[row], self._gain[row], self._offset[row] = self._start, draw.gain, draw.offset
        if self._sent is not None:
            self._sent[row] = self._start
            self._first[row] = self._sent.shape[1] - self._substeps - self._delay(draw.latency)

    def apply(self, action: Array, members: Indices) -> Array:
        """Tensions (rows, substeps, n_a) [N] of the period that begins, for actions (rows, n_a) in [-1, 1] of the rows `members`."""
        self.command[members] = self.actions.tension(action, self.command)[members]
        acting = np.repeat(self.command[:, None], self._substeps, axis=1)
        if self._sent is not None:
            self._sent[members, : -self._substeps] = self._sent[members, self._substeps :]
            self._sent[members, -self._substeps :] = acting[members]
            index = self._first[:, None] + np.arange(self._substeps)
            acting = self._sent[np.arange(len(action))[:, None], index]
        if self._imperfect:  # a tendon that can only pull goes slack, whatever its actuator's error
            acting = np.maximum(self._gain[:, None] * acting + self._offset[:, None], np.minimum(self.actions.least, 0.0))
        return acting
