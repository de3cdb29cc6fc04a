"""Adjoint of the filter of commands through a part: cotangents of the mean commands in its halves, and of the internal state at its end,
to those of the state at its beginning and of the command.

A tendon has its numbers in the state, u, what has arrived and the commands on their way, and last the command that is given. Which of
them acts is known by their times of arrival, and u answers to that as lag_slopes() says: one run has all derivatives.
"""

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
    queue_of,
    receive,
)
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of

SHORTEST = 1e-9  # of half of a part, what is left of it


class FilterMemory(Struct):
    """A run of the filter with its derivatives by the numbers of each tendon, and cotangents."""

    state: FloatVector  # (states) on the way, at the end after a run
    after: np.ndarray  # (2, n_a) what acts at the ends of the halves
    force: np.ndarray  # (2, n_a) cotangents of the mean commands
    mean: np.ndarray  # (2, numbers, n_a) derivatives of the mean commands
    slope: np.ndarray  # (numbers, n_a) derivatives of u, then cotangents of the numbers


def make_filter_memory(arm: Arm) -> FilterMemory:
    """Zeroed FilterMemory for one arm."""
    n_a, size = arm.tendons.size, arm.effects.filter_size
    numbers = 3 + (size - 2 * n_a) // (1 + n_a) if size else 0
    shapes = ((2, n_a), "after force"), ((2, numbers, n_a), "mean"), ((numbers, n_a), "slope")
    return FilterMemory(**zeros_of(((arm.effects.state.size,), "state"), *shapes))


@kernel
def source_at(path, waiting, times, begins, arrival):
    """Number that had arrived last at a time [s], of what waited at the beginning of a part and of the command that is given there."""
    source = 1
    for k in range(len(waiting)):
        if waiting[k, 0] <= arrival:
            source = 2 + k
    return 2 + len(waiting) if path.delay == 0.0 or (begins and times[0] + path.delay <= arrival) else source


@kernel
def begin_filter(effects, start, command, times, begins, scratch, memory):
    """Runs the filter through a part from its internal state (states) under a command (n_a), with its derivatives."""
    path, half, at, fresh = effects.transmission, 0.5 * (times[1] - times[0]), times[0], begins
    waiting, first = queue_of(filter_state(effects, start), command.size), effects.first_state[path.filter]
    copy(start, memory.state)
    memory.mean[:] = 0.0
    memory.slope[:] = 0.0
    memory.slope[0] = 1.0
    for side in range(2):
        end, mean = times[0] + (side + 1) * half, memory.mean[side]
        while end - at > SHORTEST * half:
            receive(effects, command, fresh, at, memory.state, scratch.acting, scratch.until)
            step, fresh = max(min(scratch.until[0], end) - at, SHORTEST * half), False
            source, share = source_at(path, waiting, times, begins, has_arrived_by(at)), step / half
            for i in range(command.size):
                left, by_u = lag_slopes(path, scratch.acting[i] - memory.state[first + i], step)
                for number in range(len(mean)):
                    mean[number, i] += share * by_u * memory.slope[number, i]
                    memory.slope[number, i] *= left
                mean[source, i] += share * (1.0 - by_u)
                memory.slope[source, i] += 1.0 - left
            follow(effects, scratch.acting, step, memory.state)
            at += step
        copy(command_at(effects, scratch.acting, memory.state, 0.0, memory.after[side]), memory.after[side])
    receive(effects, command, False, times[1], memory.state, scratch.acting, scratch.until)


@kernel
def filter_adjoint(effects, start, times, begins, state, command, memory):
    """Cotangents `state` (states), in place from the end of a part to its beginning, and those added to `command` (n_a), by memory.force;
    after begin_filter() from the internal state `start`."""
    path, tendons, own, found = effects.transmission, command.size, filter_state(effects, state), memory.slope
    before, after = queue_of(filter_state(effects, start), tendons), queue_of(filter_state(effects, memory.state), tendons)
    waiting, arrived = queue_of(own, tendons), 1  # which nothing changes without a delay
    if path.delay > 0.0:
        arrived = source_at(path, before, times, begins, has_arrived_by(times[1]))
    for i in range(tendons):
        for number in range(len(found)):
            of_means = memory.force[0, i] * memory.mean[0, number, i] + memory.force[1, i] * memory.mean[1, number, i]
            found[number, i] = own[i] * found[number, i] + of_means
        found[arrived, i] += own[tendons + i]
    for k in range(len(after)):
        if after[k, 0] < NEVER:
            source = source_at(path, before, times, begins, after[k, 0])
            for i in range(tendons):
                found[source, i] += waiting[k, 1 + i]
    for i in range(tendons):
        own[i], own[tendons + i] = found[0, i], found[1, i]
        for k in range(len(waiting)):
            waiting[k, 1 + i] = found[2 + k, i]
        command[i] += found[len(found) - 1, i]
