"""Adjoint of the filter of commands through a part.

It takes cotangents of the mean commands in its halves, and of the internal state at its end, to
those of the state at its beginning and of the command.

A tendon has its numbers in the state, u and its commands in the table, and last the command that is
given. Which of them acts is known by their times of arrival, and u answers to that as lag_slopes()
says: one run has all derivatives.
"""

from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.terms.command_filter import (
    NEVER,
    command_at,
    filter_state,
    follow,
    has_arrived_by,
    lag_slopes,
    receive,
)
from soft_tendon_env.mechanics.types import Arm
from soft_tendon_env.mechanics.workspace import sizes_of, zeros

SHORTEST = 1e-9  # of half of a part, what is left of it


class FilterMemory(Struct):
    """A run of the filter with its derivatives by the numbers of each tendon, and cotangents."""

    state: Annotated[np.ndarray, "states"]  # on the way, at the end after a run
    after: Annotated[np.ndarray, "2", "n_a"]  # what acts at the ends of the halves
    force: Annotated[np.ndarray, "2", "n_a"]  # cotangents of the mean commands
    mean: Annotated[np.ndarray, "2", "numbers", "n_a"]  # derivatives of the mean commands
    # derivatives of u, then cotangents of the numbers
    slope: Annotated[np.ndarray, "numbers", "n_a"]


def make_filter_memory(arm: Arm) -> FilterMemory:
    """Zeroed FilterMemory for one arm."""
    n_a = arm.tendons.size
    size = arm.effects.filter_size
    table_rows = (size - n_a) // (1 + n_a) if size else 0
    sizes = sizes_of(arm)
    sizes["numbers"] = 2 + table_rows if size else 0
    return zeros(FilterMemory, sizes)


@kernel
def source_at(path, table, times, begins, arrived_by):
    """Number that had arrived last at a time [s].

    It is one of the table at the beginning of a part and of the command that is given there.
    """
    given = 1 + len(table)
    if path.delay == 0.0 or (begins and times[0] + path.delay <= arrived_by):
        return given
    source = 1
    for k in range(1, len(table)):
        if table[k, 0] <= arrived_by:
            source = 1 + k
    return source


@kernel
def begin_filter(effects, start, command, times, begins, scratch, memory):
    """Runs the filter through a part from its internal state (states), with derivatives.

    It is under a command (n_a).
    """
    path = effects.transmission
    arrival = scratch.arrival
    state = memory.state
    half = 0.5 * (times[1] - times[0])
    shortest = SHORTEST * half
    _, table = filter_state(effects, start, command.size)
    copy(start, state)
    memory.mean[:] = 0.0
    memory.slope[:] = 0.0
    memory.slope[0] = 1.0  # of u by itself
    time = times[0]
    is_new = begins
    for side in range(2):
        end = times[0] + (side + 1) * half
        mean = memory.mean[side]
        while end - time > shortest:
            # up to where another command arrives
            receive(effects, command, is_new, time, state, arrival)
            is_new = False
            until = min(arrival.until[0], end)
            step = max(until - time, shortest)
            arrived = arrival.command
            source = source_at(path, table, times, begins, has_arrived_by(time))
            u, _ = filter_state(effects, state, command.size)
            share = step / half
            add_slopes(path, arrived, u, source, step, share, memory.slope, mean)
            follow(effects, arrived, step, state)
            time += step
        after = memory.after[side]
        copy(command_at(effects, arrival.command, state, 0.0, after), after)
    receive(effects, command, False, times[1], state, arrival)


@kernel
def add_slopes(path, arrived, u, source, step, share, slope, mean):
    """Takes derivatives of u (numbers, n_a) over a time [s], and adds those of its mean.

    They are of a share of the mean, where the `source`-th number has arrived.
    """
    for i in range(arrived.size):
        away = arrived[i] - u[i]
        left, by_u = lag_slopes(path, away, step)
        of_mean = share * by_u
        for number in range(len(mean)):
            mean[number, i] += of_mean * slope[number, i]
            slope[number, i] *= left
        # the rest is by what has arrived
        mean[source, i] += share * (1.0 - by_u)
        slope[source, i] += 1.0 - left


@kernel
def filter_adjoint(effects, start, times, begins, state, command, memory):
    """Cotangents `state` (states) from a part's end to its beginning, after begin_filter().

    Those of the command are added to `command` (n_a).
    """
    path = effects.transmission
    tendons = command.size
    numbers = memory.slope
    u, table = filter_state(effects, state, tendons)
    _, before = filter_state(effects, start, tendons)
    _, after = filter_state(effects, memory.state, tendons)
    first_mean = memory.mean[0]
    second_mean = memory.mean[1]
    for i in range(tendons):
        first_force = memory.force[0, i]
        second_force = memory.force[1, i]
        # by u at the end, and by the mean commands
        for number in range(len(numbers)):
            by_first = first_force * first_mean[number, i]
            by_second = second_force * second_mean[number, i]
            numbers[number, i] = u[i] * numbers[number, i] + (by_first + by_second)
        # by the commands in the table at the end, which are those that had arrived by their times
        for k in range(len(after)):
            arrived_by = after[k, 0] if k > 0 else has_arrived_by(times[1])
            if arrived_by < NEVER:
                source = 1  # without a delay what has arrived stays what it was
                if path.delay > 0.0:
                    source = source_at(path, before, times, begins, arrived_by)
                numbers[source, i] += table[k, 1 + i]
        # u, the table, and the command that is given
        u[i] = numbers[0, i]
        for k in range(len(table)):
            table[k, 1 + i] = numbers[1 + k, i]
        last = len(numbers) - 1
        command[i] += numbers[last, i]
