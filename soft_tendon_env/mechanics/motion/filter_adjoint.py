"""Adjoint of the filter of commands through a part: cotangents of the mean commands in its halves,
and of the internal state at its end, to those of the state at its beginning and of the command.

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
    slope: Annotated[
        np.ndarray, "numbers", "n_a"
    ]  # derivatives of u, then cotangents of the numbers


def make_filter_memory(arm: Arm) -> FilterMemory:
    """Zeroed FilterMemory for one arm."""
    n_a, size = arm.tendons.size, arm.effects.filter_size
    return zeros(
        FilterMemory, {**sizes_of(arm), "numbers": 2 + (size - n_a) // (1 + n_a) if size else 0}
    )


@kernel
def source_at(path, table, times, begins, arrival):
    """Number that had arrived last at a time [s], of the table at the beginning of a part and of
    the command that is given there."""
    if path.delay == 0.0 or (begins and times[0] + path.delay <= arrival):
        return 1 + len(table)
    source = 1
    for k in range(1, len(table)):
        if table[k, 0] <= arrival:
            source = 1 + k
    return source


@kernel
def begin_filter(effects, start, command, times, begins, scratch, memory):
    """Runs the filter through a part from its internal state (states) under a command (n_a), with
    its derivatives."""
    path, half, at, is_new = effects.transmission, 0.5 * (times[1] - times[0]), times[0], begins
    table, u = (
        filter_state(effects, start, command.size)[1],
        filter_state(effects, memory.state, command.size)[0],
    )
    copy(start, memory.state)
    memory.mean[:] = 0.0
    memory.slope[:] = 0.0
    memory.slope[0] = 1.0
    for side in range(2):
        end, mean = times[0] + (side + 1) * half, memory.mean[side]
        while end - at > SHORTEST * half:
            receive(effects, command, is_new, at, memory.state, scratch.acting, scratch.until)
            step, is_new = max(min(scratch.until[0], end) - at, SHORTEST * half), False
            source, share = source_at(path, table, times, begins, has_arrived_by(at)), step / half
            for i in range(command.size):
                left, by_u = lag_slopes(path, scratch.acting[i] - u[i], step)
                for number in range(len(mean)):
                    mean[number, i] += share * by_u * memory.slope[number, i]
                    memory.slope[number, i] *= left
                mean[source, i] += share * (1.0 - by_u)
                memory.slope[source, i] += 1.0 - left
            follow(effects, scratch.acting, step, memory.state)
            at += step
        copy(
            command_at(effects, scratch.acting, memory.state, 0.0, memory.after[side]),
            memory.after[side],
        )
    receive(effects, command, False, times[1], memory.state, scratch.acting, scratch.until)


@kernel
def filter_adjoint(effects, start, times, begins, state, command, memory):
    """Cotangents `state` (states) from a part's end to its beginning, and those added to `command`
    (n_a); after begin_filter()."""
    path, tendons, found, (u, table) = (
        effects.transmission,
        command.size,
        memory.slope,
        filter_state(effects, state, command.size),
    )
    before, after = (
        filter_state(effects, start, tendons)[1],
        filter_state(effects, memory.state, tendons)[1],
    )
    for i in range(tendons):
        for number in range(len(found)):
            by_means = (
                memory.force[0, i] * memory.mean[0, number, i]
                + memory.force[1, i] * memory.mean[1, number, i]
            )
            found[number, i] = u[i] * found[number, i] + by_means
        for k in range(len(after)):
            arrival = after[k, 0] if k > 0 else has_arrived_by(times[1])
            if arrival < NEVER:  # without a delay what has arrived stays what it was
                found[
                    source_at(path, before, times, begins, arrival) if path.delay > 0.0 else 1, i
                ] += table[k, 1 + i]
        u[i] = found[0, i]
        for k in range(len(table)):
            table[k, 1 + i] = found[1 + k, i]
        command[i] += found[len(found) - 1, i]
