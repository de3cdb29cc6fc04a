"""Actuators: actions to commands by scaling, limits, gain and offset errors, and delay."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.control.smith_predictor import whole_periods
from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.options import Options
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

# control periods by which commands can be late: every row keeps its commands for that long
MOST_LATENCY = 1_000


@dataclass(frozen=True)
class ActionScale:
    """Action scaling of [-1, 1]: to commands between limits (n_a,), or to changes of at most
    `increment` (n_a,) if there is one.

    Commands are tensions [N], or what the scene's effects make of them, as the displacements [m] of
    elastic tendons' actuators.
    """

    least: Array
    greatest: Array
    increment: Array | None

    @cached_property
    def _reach(self) -> Array:
        return 0.5 * (self.greatest - self.least)

    def wanted(self, action: Array, before: Array) -> Array:
        """Commands (..., n_a) asked for by actions (..., n_a) after the command `before`, wherever
        the limits are: of tensors too."""
        if self.increment is None:
            return self.least + self._reach * (action + 1.0)
        return before + self.increment * action

    def command(self, action: Array, before: Array) -> Array:
        """Commands (..., n_a) asked for by actions (..., n_a) after the command `before` (...,
        n_a), within the limits."""
        return np.asarray(
            np.minimum(np.maximum(self.wanted(action, before), self.least), self.greatest)
        )

    def action(self, command: Array, before: Array) -> Array:
        """Actions (..., n_a) that ask for a command (..., n_a) after the one `before`, or come as
        near to it as actions can."""
        if self.increment is None:
            wanted = 2.0 * (command - self.least) / (self.greatest - self.least) - 1.0
        else:
            wanted = (command - before) / self.increment
        return np.asarray(np.minimum(np.maximum(wanted, -1.0), 1.0))


class Actuation:
    """Rows of actuators.

    `command` (rows, n_a) is what was last asked for, `in_transit` (rows, periods, n_a) what was
    asked for by control period, the newest last, where commands can be late; `gain` and `offset`
    (rows, n_a) err, where actuators are `imperfect`. A tendon that can only pull goes slack at
    `slack` (n_a,), 0; others have their least command there.
    """

    def __init__(
        self, options: Options, limits: Array, start: Array, share: Array, rows: int, substeps: int
    ) -> None:
        """limits: (n_a, 2) of commands; start: commands (n_a,) before the first reset; share:
        (n_a,) of the range of commands that 1 N is of that of tensions; substeps: integrator steps
        a period.

        Raises ConfigurationError.
        """
        increment = (
            share * (options.tension_rate * options.control_period)
            if options.action == "increment"
            else None
        )
        self.actions = ActionScale(limits[:, 0].copy(), limits[:, 1].copy(), increment)
        self.substeps, self._share, self._period, self.slack = (
            substeps,
            share,
            options.control_period,
            np.minimum(limits[:, 0], 0.0),
        )
        self.start_action = self.actions.action(start, start)
        self.command = np.tile(start, (rows, 1))
        self._randomize, self.imperfect = options.randomize, options.randomize.of_actuators
        self.gain, self.offset = np.ones((rows, start.size)), np.zeros((rows, start.size))
        latency, most = options.randomize.latency[1], MOST_LATENCY * options.control_period
        if latency > most:
            allowed = f"it should be at most {MOST_LATENCY} control periods, {most:g} s"
            raise ConfigurationError(
                [Problem(("randomize", "latency"), f"is {latency:g}: {allowed}")], "environment"
            )
        self._kept = whole_periods(latency, self._period)[0] + 2
        self.in_transit = np.tile(start, (rows, self._kept, 1)) if latency else None
        self._periods_late, self._durations = (
            np.zeros(rows, dtype=np.int64),
            np.tile([0.0, self._period], (rows, 1)),
        )

    def begin(self, row: int, generator: np.random.Generator, command: Array) -> None:
        """A new episode of a row under a command (n_a,), held since long before; its actuators are
        drawn, always in the same order."""
        drawn, self.command[row] = self._randomize, command
        self.gain[row] = generator.uniform(*drawn.tension_gain, command.size)
        self.offset[row] = self._share * generator.uniform(*drawn.tension_offset, command.size)
        latency = generator.uniform(*drawn.latency)
        if drawn.omit:
            gain, offset, late = generator.random(3) >= drawn.omit
            self.gain[row], self.offset[row], latency = (
                (self.gain[row] if gain else 1.0),
                offset * self.offset[row],
                late * latency,
            )
        self._periods_late[row], rest = whole_periods(latency, self._period)
        self._durations[row] = rest, self._period - rest
        if self.in_transit is not None:
            self.in_transit[row] = command

    def drawn(self, row: int) -> dict[str, Any]:
        """Gain and offset [N] (n_a,), and latency [s], of a row's actuators as they were drawn, by
        their names in `randomize`."""
        found = (
            {
                "tension_gain": self.gain[row].copy(),
                "tension_offset": self.offset[row] / self._share,
            }
            if self.imperfect
            else {}
        )
        return found | ({} if self.in_transit is None else {"latency": self.delay(row)})

    def shares(self) -> Array:
        """How far from the least to the greatest of every range (rows, ranges) gains, offsets and
        latencies of rows are, 0 to 1."""
        drawn, late = (
            self._randomize,
            np.array([[self.delay(row)] for row in range(len(self.gain))]),
        )
        values = (
            (self.gain, drawn.tension_gain),
            (self.offset / self._share, drawn.tension_offset),
            (late, drawn.latency),
        )
        shares = [
            (value - least) / (greatest - least)
            for value, (least, greatest) in values
            if least < greatest
        ]
        return np.concatenate([np.zeros((len(late), 0)), *shares], axis=1)

    def delay(self, row: int) -> float:
        """Time [s] by which a row's commands are late."""
        return float(self._periods_late[row] * self._period + self._durations[row, 0])

    def acting(self, command: Array, row: int) -> Array:
        """Commands (..., n_a) with the errors of a row's actuators."""
        return np.asarray(np.maximum(self.gain[row] * command + self.offset[row], self.slack))

    def commanded(self, acting: Array, row: int) -> Array:
        """Commands (..., n_a) of which a row's actuators make `acting` (..., n_a): the inverse of
        `acting`, where there is one."""
        gain = np.where(self.gain[row] > 0.0, self.gain[row], 1.0)
        return np.asarray((acting - self.offset[row]) / gain)

    def sent(self, row: int) -> Array:
        """Commands (m, n_a) that may not have arrived at a row yet, with its actuators' errors, the
        last asked for at the end."""
        return self.acting(
            self.command[row : row + 1] if self.in_transit is None else self.in_transit[row], row
        )

    @property
    def arriving(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Rows (rows, 1) and places (rows, 2) in `in_transit` of the commands that act in a period,
        one after the other."""
        newest = self._kept - 1 - self._periods_late
        return np.arange(len(newest))[:, None], newest[:, None] - [1, 0]

    def apply(self, action: Array, members: Indices) -> tuple[Array, Array | None]:
        """Commands (rows, parts, n_a) of the period that begins, for actions (rows, n_a) in [-1, 1]
        of the rows `members`, and how long each is held (rows, parts) [s]; None: for an integrator
        step."""
        wanted, durations = self.actions.command(action, self.command), None
        if members.size < len(wanted):
            self.command[members] = wanted[members]
            wanted = self.command
        self.command = wanted
        if self.in_transit is None:
            acting = self.command[:, None].repeat(self.substeps, axis=1)
        else:  # the command before acts on until this one comes
            self.in_transit[members, :-1] = self.in_transit[members, 1:]
            self.in_transit[members, -1] = self.command[members]
            acting, durations = self.in_transit[self.arriving], self._durations
        if self.imperfect:
            acting = np.maximum(self.gain[:, None] * acting + self.offset[:, None], self.slack)
        return acting, durations
