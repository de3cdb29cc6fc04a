"""Adjoint of the filter in front of the tendons over a part of a period: by its internal state at the beginning, and by the command.

The filter alone is run through the part, for the mean commands in its halves and the internal state at its end. Every tendon has a filter
of its own: forward differences by a number of all tendons at once give the cotangents.
"""

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.terms.command_filter import command_at, follow, lagged, receive
from soft_tendon_env.mechanics.types import Arm, FloatVector
from soft_tendon_env.mechanics.workspace import zeros_of

SMALL = 1e-6  # of a number, or of 1, by which it is moved
SHORTEST = 1e-9  # of half of a part, what is left of it


class FilterMemory(Struct):
    """Course of the filter through a part, and the gradient."""

    state: FloatVector  # (states) on the way, at the end after a run
    given: FloatVector  # (n_a) the command
    start: FloatVector  # (states)
    end: FloatVector  # (states) after the run with which others are compared
    acting: FloatVector  # (n_a)
    until: FloatVector  # (1)
    mean: np.ndarray  # (2, n_a) of the halves
    known: np.ndarray  # (2, n_a) of the run with which others are compared
    after: np.ndarray  # (2, n_a) what acts at the ends of the halves
    force: np.ndarray  # (2, n_a) cotangents of the means
    gradient: np.ndarray  # (numbers, n_a) by the state at the beginning, and by the command last
    moved: FloatVector  # (n_a) by how much a number of every tendon is moved


def make_filter_memory(arm: Arm) -> FilterMemory:
    """Zeroed FilterMemory for one arm."""
    n_a, size = arm.tendons.size, arm.effects.filter_size
    numbers = 3 + (size - 2 * n_a) // (1 + n_a) if size else 0
    return FilterMemory(
        **zeros_of(
            ((arm.effects.state.size,), "state start end"),
            ((n_a,), "given acting moved"),
            ((1,), "until"),
            ((2, n_a), "mean known after force"),
            ((numbers, n_a), "gradient"),
        )
    )


@kernel
def run_filter(effects, times, begins, memory):
    """Runs memory.state and memory.given from one time [s] to another: mean commands, and those at the ends of both halves."""
    half, at, fresh = 0.5 * (times[1] - times[0]), times[0], begins
    first = effects.first_state[effects.transmission.filter]
    for side in range(2):
        end, mean = times[0] + (side + 1) * half, memory.mean[side]
        mean[:] = 0.0
        while end - at > SHORTEST * half:
            receive(effects, memory.given, fresh, at, memory.state, memory.acting, memory.until)
            step, fresh = max(min(memory.until[0], end) - at, SHORTEST * half), False
            for i in range(mean.size):
                held = memory.acting[i]
                if effects.transmission.lags:
                    held = lagged(effects.transmission, memory.state[first + i], held, step)[1]
                mean[i] += step / half * held
            follow(effects, memory.acting, step, memory.state)
            at += step
        copy(command_at(effects, memory.acting, memory.state, 0.0, memory.after[side]), memory.after[side])
    receive(effects, memory.given, False, times[1], memory.state, memory.acting, memory.until)


@kernel
def begin_filter(effects, start, command, times, begins, memory):
    """Runs the filter through a part from its internal state (states) under a command (n_a), for filter_adjoint() to compare with."""
    copy(start, memory.start)
    copy(start, memory.state)
    copy(command, memory.given)
    run_filter(effects, times, begins, memory)
    copy_matrix(memory.mean, memory.known)
    copy(memory.state, memory.end)


@kernel
def place_of(number, tendons):
    """Place where the number of every tendon begins in the internal state: u, what has arrived, and the commands on their way."""
    return number * tendons if number < 2 else 2 * tendons + (number - 2) * (1 + tendons) + 1


@kernel
def filter_adjoint(effects, times, begins, state, command, memory):
    """Cotangents `state` (states), in place from the end of a part to its beginning, and those added to `command` (n_a), by memory.force;
    after begin_filter()."""
    tendons, numbers = command.size, memory.gradient.shape[0]
    first = effects.first_state[effects.transmission.filter]
    for number in range(numbers):
        copy(memory.start, memory.state)
        place = first + place_of(number, tendons)
        for i in range(tendons):
            before = memory.given[i] if number == numbers - 1 else memory.state[place + i]
            memory.moved[i] = SMALL * max(abs(before), 1.0)
            if number == numbers - 1:
                memory.given[i] += memory.moved[i]
            else:
                memory.state[place + i] += memory.moved[i]
        run_filter(effects, times, begins, memory)
        for i in range(tendons):
            change = 0.0
            for side in range(2):
                change += memory.force[side, i] * (memory.mean[side, i] - memory.known[side, i])
            for other in range(numbers - 1):
                at = first + place_of(other, tendons) + i
                change += state[at] * (memory.state[at] - memory.end[at])
            memory.gradient[number, i] = change / memory.moved[i]
    for number in range(numbers - 1):
        for i in range(tendons):
            state[first + place_of(number, tendons) + i] = memory.gradient[number, i]
    for i in range(tendons):
        command[i] += memory.gradient[numbers - 1, i]
