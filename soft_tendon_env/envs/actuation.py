"""Actuators: actions to commands by scaling, limits, gain and offset errors, and delay."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.control.command_filter import whole_periods
from soft_tendon_env.envs.arms import Indices
from soft_tendon_env.envs.options import Options
from soft_tendon_env.envs.randomization import OF_ACTUATORS
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

MOST_LATENCY = 1_000
"""Control periods by which commands can be late at most: every row keeps its commands for that
long."""


@dataclass(frozen=True)
class ActionScale:
    """Action scaling of [-1, 1], to commands between limits or to changes of commands.

    Changes are of at most `increment` (n_a,), if there is one. Commands are tensions [N], or what
    the scene's effects make of them, as the displacements [m] of elastic tendons' actuators. The
    actuators let them change by at most `greatest_change` (n_a,) in a period, whatever is asked
    for; None: by any amount.
    """

    least: Array
    greatest: Array
    increment: Array | None
    greatest_change: Array | None = None

    @cached_property
    def _reach(self) -> Array:
        """Half the range of the commands."""
        return 0.5 * (self.greatest - self.least)

    def wanted(self, action: Array, before: Array) -> Array:
        """Commands that actions ask for, wherever the limits are; of tensors too.

        Args:
            action: (..., n_a) in [-1, 1].
            before: the command (..., n_a) before.

        Returns:
            Commands (..., n_a).
        """
        if self.increment is None:
            way = self._reach * (action + 1.0)
            return self.least + way
        return before + self.increment * action

    def command(self, action: Array, before: Array) -> Array:
        """Commands that actions ask for, within the limits and the rate.

        Args:
            action: (..., n_a) in [-1, 1].
            before: the command (..., n_a) before.

        Returns:
            Commands (..., n_a).
        """
        command = self.wanted(action, before)
        if self.greatest_change is not None:
            least = before - self.greatest_change
            above = np.maximum(command, least)
            greatest = before + self.greatest_change
            command = np.minimum(above, greatest)
        raised = np.maximum(command, self.least)
        return np.asarray(np.minimum(raised, self.greatest))

    def action(self, command: Array, before: Array) -> Array:
        """Actions that ask for a command, or come as near to it as actions can.

        Args:
            command: (..., n_a).
            before: the command (..., n_a) before.

        Returns:
            Actions (..., n_a) in [-1, 1].
        """
        if self.increment is None:
            doubled = 2.0 * (command - self.least)
            width = self.greatest - self.least
            unlimited = doubled / width - 1.0
        else:
            unlimited = (command - before) / self.increment
        raised = np.maximum(unlimited, -1.0)
        return np.asarray(np.minimum(raised, 1.0))


class Actuation:
    """Rows of actuators.

    Attributes:
        command: (rows, n_a) what was last asked for.
        in_transit: (rows, periods, n_a) what was asked for by control period, the newest last;
            None where commands cannot be late.
        imperfect: whether actuators have errors.
        gain: (rows, n_a) factors of commands.
        offset: (rows, n_a) that is added to commands.
        slack: (n_a,) at which tendons go slack that can only pull, 0; of others their least
            command.
    """

    def __init__(
        self,
        options: Options,
        limits: Array,
        start: Array,
        share: Array,
        rows: int,
        substeps: int,
    ) -> None:
        """Make actuators without errors, under a command.

        Args:
            options: of the environment.
            limits: (n_a, 2) of commands.
            start: commands (n_a,) before the first reset.
            share: (n_a,) of the range of commands that 1 N is of that of tensions.
            rows: of actuators.
            substeps: integrator steps a period.

        Raises:
            ConfigurationError: where commands can be too late.
        """
        period = options.control_period
        least = limits[:, 0].copy()
        greatest = limits[:, 1].copy()
        increment = None
        if options.action == "increment":
            increment = share * (options.tension_rate * period)
        greatest_change = None
        if options.rate_limit is not None:
            greatest_change = share * (options.rate_limit * period)
        self.actions = ActionScale(least, greatest, increment, greatest_change)
        self.substeps = substeps
        self.slack = np.minimum(least, 0.0)
        self._share = share
        self._period = period

        self.start_action = self.actions.action(start, start)
        self.command = np.tile(start, (rows, 1))
        self._randomize = options.randomize
        self.imperfect = options.randomize.of_actuators
        shape = (rows, start.size)
        self.gain = np.ones(shape)
        self.offset = np.zeros(shape)

        _, latency = options.randomize.latency
        most = MOST_LATENCY * period
        if latency > most:
            allowed = f"it should be at most {MOST_LATENCY} control periods, {most:g} s"
            message = f"is {latency:g}: {allowed}"
            problem = Problem(("randomize", "latency"), message)
            raise ConfigurationError([problem], "environment")
        # a command that comes within a period shares it with the one before
        whole, _ = whole_periods(latency, period)
        self._kept = whole + 2
        self.in_transit = None
        if latency:
            repeats = (rows, self._kept, 1)
            self.in_transit = np.tile(start, repeats)
        self._periods_late = np.zeros(rows, dtype=np.int64)
        self._durations = np.tile([0.0, period], (rows, 1))

    def begin(
        self,
        row: int,
        generator: np.random.Generator,
        command: Array,
    ) -> None:
        """Begin a new episode of a row, and draw its actuators, always in the same order.

        Args:
            row: that begins.
            generator: of the episode.
            command: (n_a,) that has been held since long before.
        """
        ranges = self._randomize
        tendons = command.size
        gain = generator.uniform(*ranges.tension_gain, tendons)
        offset_of_tension = generator.uniform(*ranges.tension_offset, tendons)
        offset = self._share * offset_of_tension
        latency = generator.uniform(*ranges.latency)
        # drawn after the others, so that these are the same with and without omissions
        if ranges.omits:
            omissions = [ranges.omission(name) for name in OF_ACTUATORS]
            has_gain, has_offset, has_latency = generator.random(3) >= omissions
            if not has_gain:
                gain = np.ones(tendons)
            if not has_offset:
                offset = np.zeros(tendons)
            if not has_latency:
                latency = 0.0
        self.command[row] = command
        self.gain[row] = gain
        self.offset[row] = offset
        whole, rest = whole_periods(latency, self._period)
        self._periods_late[row] = whole
        rest_of_period = self._period - rest
        self._durations[row] = rest, rest_of_period
        if self.in_transit is not None:
            self.in_transit[row] = command

    def drawn(self, row: int) -> dict[str, Any]:
        """Gain and offset [N] (n_a,) and latency [s] drawn for a row, by name in `randomize`."""
        values: dict[str, Any] = {}
        if self.imperfect:
            values["tension_gain"] = self.gain[row].copy()
            offset = self.offset[row]
            values["tension_offset"] = offset / self._share
        if self.in_transit is not None:
            values["latency"] = self.delay(row)
        return values

    def shares(self) -> Array:
        """Gains, offsets and latencies (rows, numbers) as shares of their ranges, 0 to 1."""
        rows = len(self.gain)
        delays = [self.delay(row) for row in range(rows)]
        latency = np.array(delays)[:, None]
        ranges = self._randomize
        offset = self.offset / self._share
        shares = [
            _share_of(self.gain, ranges.tension_gain),
            _share_of(offset, ranges.tension_offset),
            _share_of(latency, ranges.latency),
        ]
        return np.concatenate(shares, axis=1)

    def delay(self, row: int) -> float:
        """Time [s] by which a row's commands are late."""
        whole_periods_late = self._periods_late[row] * self._period
        late = whole_periods_late + self._durations[row, 0]
        return float(late)

    def acting(self, command: Array, row: int) -> Array:
        """Commands (..., n_a) with the errors of a row's actuators."""
        amplified = self.gain[row] * command
        erroneous = amplified + self.offset[row]
        return np.asarray(np.maximum(erroneous, self.slack))

    def commanded(self, acting: Array, row: int) -> Array:
        """Commands of which a row's actuators make others: the inverse of `acting`, if it has one.

        Args:
            acting: (..., n_a) what acts.
            row: of the actuators.

        Returns:
            Commands (..., n_a).
        """
        row_gain = self.gain[row]
        gain = np.where(row_gain > 0.0, row_gain, 1.0)
        amplified = acting - self.offset[row]
        return np.asarray(amplified / gain)

    def sent(self, row: int) -> Array:
        """Commands (m, n_a) on their way to a row, with errors, the last asked for at the end."""
        if self.in_transit is None:
            command = self.command[row : row + 1]
            return self.acting(command, row)
        return self.acting(self.in_transit[row], row)

    @property
    def arriving(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Indices in `in_transit` of the two commands that act in a period, one after the other.

        They are rows (rows, 1) and places (rows, 2).
        """
        newest = self._kept - 1 - self._periods_late
        rows = np.arange(len(newest))
        row_column = rows[:, None]
        places = newest[:, None] - [1, 0]
        return row_column, places

    def apply(self, action: Array, members: Indices) -> tuple[Array, Array | None]:
        """Commands of the period that begins.

        Args:
            action: (rows, n_a) in [-1, 1].
            members: rows whose actions count.

        Returns:
            Commands (rows, parts, n_a), and how long each is held (rows, parts) [s]; None: for an
            integrator step.
        """
        command = self.actions.command(action, self.command)
        if members.size < len(command):
            self.command[members] = command[members]
        else:
            self.command = command
        if self.in_transit is None:
            durations = None
            held = self.command[:, None]
            acting = held.repeat(self.substeps, axis=1)
        else:
            # the command before acts on until this one comes
            self.in_transit[members, :-1] = self.in_transit[members, 1:]
            self.in_transit[members, -1] = self.command[members]
            durations = self._durations
            acting = self.in_transit[self.arriving]
        if self.imperfect:
            amplified = self.gain[:, None] * acting
            erroneous = amplified + self.offset[:, None]
            acting = np.maximum(erroneous, self.slack)
        return acting, durations


def _share_of(values: Array, ends: tuple[float, float]) -> Array:
    """Values (rows, m) as shares of their range, (rows, 0) where nothing is drawn from it."""
    least, greatest = ends
    if least == greatest:
        return np.zeros((len(values), 0))
    return (values - least) / (greatest - least)
