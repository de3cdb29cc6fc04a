"""Filter of commands in front of the tendons: delay, lag and limited rate.

See effects.Transmission.

Commands wait until the delay is over. What has arrived, c, acts as u with u_dot = clip((c - u) /
tau, -r, r): as long as c is held u is a function of time that is known exactly, so that it is no
coordinate of the integrator. Its steps end where commands arrive. The internal state is u (n_a) and
a table (1 + room, 1 + n_a) of times of arrival and commands: what has arrived, and what is on its
way.
"""

import math
from typing import Annotated

import numpy as np

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import IntArray

NEVER = 1e30  # [s], the arrival of what is not on its way
SETTLED = 0.02  # of the largest tension: what is nearer to its command than this has arrived
LAGS = 2.0  # time constants that a step may take while a tension lags
EARLY = 1e-9  # [s] by which a command may act before its time: clocks are sums of steps
ROUND_OFF = 1e-15  # of the time, by which besides

HAS_ROOM = 0
IS_FULL = 1
"""Status of the queue of commands on their way."""


class Arrival(Struct):
    """Command that has arrived at a time, and how long it stays."""

    command: Annotated[np.ndarray, "n_a"]
    until: Annotated[np.ndarray, "1"]  # [s] when the next integrator step should end
    queue: Annotated[IntArray, "1"]  # HAS_ROOM, or IS_FULL: a command found no place


@kernel(refcount=True)
def filter_state(effects, state, tendons):
    """Tensions u (n_a) and table (1 + room, 1 + n_a) of the filter.

    They lie in the internal states of all effects.
    """
    i = effects.transmission.filter
    begin = effects.first_state[i]
    behind_tensions = begin + tendons
    end = effects.first_state[i + 1]
    u = state[begin:behind_tensions]
    table = state[behind_tensions:end].reshape(-1, 1 + tendons)
    return u, table


@kernel(inline=True)
def has_arrived_by(time):
    """Time [s] of arrival up to which a command acts at a time [s]."""
    return time + EARLY + ROUND_OFF * abs(time)


@kernel
def receive(effects, command, begins, time, state, arrival):
    """Writes the command that has arrived, and how long it stays, into `arrival`.

    One (n_a) may be given, from this time [s] on if it `begins`.
    """
    copy(command, arrival.command)
    arrival.until[0] = math.inf
    arrival.queue[0] = HAS_ROOM
    if effects.transmission.filter >= 0:
        arrive(effects, begins, time, state, arrival)


@phase
def arrive(effects, begins, time, state, arrival):
    """receive() of a filter, where arrival.command holds what is commanded."""
    path = effects.transmission
    command = arrival.command
    u, table = filter_state(effects, state, command.size)
    if path.delay > 0.0:
        # rows of the table: row 0 has arrived, and the others are on their way
        count = 1
        while count < len(table) and table[count, 0] < NEVER:
            count += 1
        if begins:
            count = enqueue(time + path.delay, command, table, count)
            if count == 0:
                arrival.queue[0] = IS_FULL
                return
        while count > 1 and table[1, 0] <= has_arrived_by(time):
            count -= 1
            leave(0, count, table)
        copy(table[0, 1:], command)
        # the next one that is not the same
        for k in range(count - 1, 0, -1):
            if differ(table[k - 1], table[k, 1:]):
                arrival.until[0] = table[k, 0]
    if path.lags:
        settled = time + settling_time(path, u, command)
        arrival.until[0] = min(arrival.until[0], settled)


@kernel
def enqueue(arrival_time, command, table, count):
    """Adds a command to a table of `count` rows; how many there are then, 0 where there is no room.

    One that repeats the last one is kept while there is room, since it has a derivative of its own.
    """
    is_full = count == len(table)
    is_new = differ(table[count - 1], command)
    if not is_new:
        is_waiting = count > 1 and table[count - 1, 0] >= arrival_time - EARLY
        if is_full or is_waiting:
            return count
    if is_full:  # the first that repeats the one before it makes room
        k = 1
        while k < count and differ(table[k - 1], table[k, 1:]):
            k += 1
        if k == count:
            return 0
        count -= 1
        leave(k, count, table)
    table[count, 0] = arrival_time
    copy(command, table[count, 1:])
    return count + 1


@kernel
def leave(k, last, table):
    """Takes the k-th row out of the table, of which `last` remain."""
    for row in range(k, last):
        copy(table[row + 1], table[row])
    table[last, 0] = NEVER
    table[last, 1:] = 0.0


@kernel
def differ(row, command):
    """Whether the command in a row of the table is another one."""
    for i in range(command.size):
        if row[1 + i] != command[i]:
            return True
    return False


@kernel
def settling_time(path, u, command):
    """Time [s] to the next kink of u.

    It is the end of its limited rate, or some time constants while it lags.
    """
    largest = 0.0
    for i in range(command.size):
        largest = max(largest, abs(command[i]), abs(u[i]))
    slow = path.rate_limit * path.time_constant  # nearer than this the rate is below its limit
    soonest = math.inf
    for i in range(command.size):
        away = abs(command[i] - u[i])
        if away > SETTLED * largest:
            if away <= slow:
                kink = LAGS * path.time_constant
            else:
                kink = (away - slow) / path.rate_limit
            soonest = min(soonest, kink)
    return max(soonest, path.finest)


@kernel
def limited_time(path, away, step):
    """Part of a time [s] in which the rate is limited, and the lag's factor over the rest.

    The factor is what the lag leaves of how far u is away.
    """
    slow = 0.0  # nearer than this the rate is below its limit
    if path.time_constant > 0.0:
        slow = path.rate_limit * path.time_constant
    limited = 0.0
    distance = abs(away)
    if distance > slow and path.rate_limit < math.inf:
        needed = (distance - slow) / path.rate_limit
        limited = min(needed, step)
    rest = step - limited
    if path.time_constant > 0.0:
        return limited, math.exp(-rest / path.time_constant)
    return limited, 1.0 if rest == 0.0 else 0.0


@kernel
def lag_response(path, u, command, step):
    """State u of the filter a time [s] towards a command that is held, exactly."""
    if step == 0.0:
        return u
    away = command - u
    limited, left = limited_time(path, away, step)
    kink = u
    if limited > 0.0:
        kink = u + math.copysign(path.rate_limit * limited, away)
    return command + (kink - command) * left


@kernel
def lag_slopes(path, away, step):
    """Derivatives by u of lag_response() and of its mean.

    Those by the command are what is left to 1. Without a lag the command acts.
    """
    if not path.lags:
        return 1.0, 0.0
    limited, left = limited_time(path, away, step)
    mean = (limited + path.time_constant * (1.0 - left)) / step
    return left, mean


@kernel(refcount=True)
def command_at(effects, arrived, state, since, out):
    """Command that acts a time [s] after the internal states were `state`.

    `arrived` (n_a) has arrived: the command is in `out`, or that.
    """
    path = effects.transmission
    if not path.lags:
        return arrived
    first = effects.first_state[path.filter]
    for i in range(arrived.size):
        out[i] = lag_response(path, state[first + i], arrived[i], since)
    return out


@kernel
def follow(effects, arrived, step, state):
    """Advances the filter's part of the internal states by a time [s].

    In it `arrived` (n_a) has arrived and is held.
    """
    if effects.transmission.lags:
        u, _ = filter_state(effects, state, arrived.size)
        command_at(effects, arrived, state, step, u)


@kernel
def rest_filter(effects, command, state):
    """The filter's part of the internal states where a command (n_a) has always been held."""
    if effects.transmission.filter >= 0:
        u, table = filter_state(effects, state, command.size)
        copy(command, u)
        copy(command, table[0, 1:])
        for row in range(1, len(table)):
            table[row, 0] = NEVER
