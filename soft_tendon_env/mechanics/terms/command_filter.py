"""Filter of commands in front of the tendons: delay, lag and limited rate, see
effects.Transmission.

Commands wait until the delay is over. What has arrived, c, acts as u with u_dot = clip((c - u) /
tau, -r, r): as long as c is held u is a function of time that is known exactly, so that it is no
coordinate of the integrator. Its steps end where commands arrive. The internal state is u (n_a) and
a table (1 + room, 1 + n_a) of times of arrival and commands: what has arrived, and what is on its
way.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.linear import copy

NEVER = 1e30  # [s], the arrival of what is not on its way
SETTLED = 0.02  # of the largest tension: what is nearer to its command than this has arrived
LAGS = 2.0  # time constants that a step may take while a tension lags
EARLY = 1e-9  # [s] by which a command may act before its time: clocks are sums of steps
ROUND_OFF = 1e-15  # of the time, by which besides


@kernel(refcount=True)
def filter_state(effects, state, tendons):
    """Tensions u (n_a) and table (1 + room, 1 + n_a) of the filter, in the internal states of all
    effects."""
    begin, end = (
        effects.first_state[effects.transmission.filter],
        effects.first_state[effects.transmission.filter + 1],
    )
    return state[begin : begin + tendons], state[begin + tendons : end].reshape(-1, 1 + tendons)


@kernel(inline=True)
def has_arrived_by(time):
    """Time [s] of arrival up to which a command acts at a time [s]."""
    return time + EARLY + ROUND_OFF * abs(time)


@kernel
def receive(effects, command, begins, time, state, acting, until):
    """Writes the command that has arrived into `acting` (n_a) where one (n_a) is given, from this
    time [s] on if it `begins`, and into `until` (1) when the next integrator step should end [s];
    -infinity where the queue has no room."""
    copy(command, acting)
    until[0] = math.inf
    if effects.transmission.filter >= 0:
        arrive(effects, begins, time, state, acting, until)


@phase
def arrive(effects, begins, time, state, acting, until):
    """receive() of a filter, where `acting` holds what is commanded."""
    path, (u, table) = effects.transmission, filter_state(effects, state, acting.size)
    if path.delay > 0.0:
        count = 1
        while count < len(table) and table[count, 0] < NEVER:
            count += 1
        if begins:
            count = enqueue(time + path.delay, acting, table, count)
            if count == 0:
                until[0] = -math.inf
                return
        while count > 1 and table[1, 0] <= has_arrived_by(time):
            count -= 1
            leave(0, count, table)
        copy(table[0, 1:], acting)
        for k in range(count - 1, 0, -1):
            if differ(table[k - 1], table[k, 1:]):
                until[0] = table[k, 0]
    if path.lags:
        until[0] = min(until[0], time + settling_time(path, u, acting))


@kernel
def enqueue(arrival, command, table, count):
    """Adds a command to a table of `count` rows; how many there are then, 0 where there is no room.
    One that repeats the last one is kept while there is room, since it has a derivative of its
    own."""
    is_full, is_new = count == len(table), differ(table[count - 1], command)
    if not is_new and (is_full or (count > 1 and table[count - 1, 0] >= arrival - EARLY)):
        return count
    if is_full:  # the first that repeats the one before it makes room
        k = 1
        while k < count and differ(table[k - 1], table[k, 1:]):
            k += 1
        if k == count:
            return 0
        count -= 1
        leave(k, count, table)
    table[count, 0] = arrival
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
def settling_time(path, u, acting):
    """Time [s] to the next kink of u: the end of its limited rate, or some time constants while it
    lags."""
    soonest, largest, slow = math.inf, 0.0, path.rate_limit * path.time_constant
    for i in range(acting.size):
        largest = max(largest, abs(acting[i]), abs(u[i]))
    for i in range(acting.size):
        away = abs(acting[i] - u[i])
        if away > SETTLED * largest:
            soonest = min(
                soonest,
                LAGS * path.time_constant if away <= slow else (away - slow) / path.rate_limit,
            )
    return max(soonest, path.finest)


@kernel
def limited_time(path, away, step):
    """For how much of a time [s] the rate is limited, and what the lag leaves over the rest of it
    of how far u is away."""
    limited = 0.0
    slow = (
        path.rate_limit * path.time_constant if path.time_constant > 0.0 else 0.0
    )  # nearer than this the rate is below its limit
    if abs(away) > slow and path.rate_limit < math.inf:
        limited = min((abs(away) - slow) / path.rate_limit, step)
    rest = step - limited
    return limited, math.exp(
        -rest / path.time_constant
    ) if path.time_constant > 0.0 else 1.0 if rest == 0.0 else 0.0


@kernel
def lag_response(path, u, command, step):
    """u after a time [s] towards a command that is held, exactly."""
    away = command - u
    limited, left = limited_time(path, away, step)
    kink = u + math.copysign(path.rate_limit * limited, away) if limited > 0.0 else u
    return u if step == 0.0 else command + (kink - command) * left


@kernel
def lag_slopes(path, away, step):
    """Derivatives by u of lag_response() and of its mean; those by the command are what is left to
    1. Without a lag the command acts."""
    if not path.lags:
        return 1.0, 0.0
    limited, left = limited_time(path, away, step)
    return left, (limited + path.time_constant * (1.0 - left)) / step


@kernel(refcount=True)
def command_at(effects, acting, state, since, out):
    """The command that acts a time [s] after the internal states were `state`, where `acting` (n_a)
    has arrived: `out`, or that."""
    if not effects.transmission.lags:
        return acting
    first = effects.first_state[effects.transmission.filter]
    for i in range(acting.size):
        out[i] = lag_response(effects.transmission, state[first + i], acting[i], since)
    return out


@kernel
def follow(effects, acting, step, state):
    """Advances the filter's part of the internal states by a time [s] in which `acting` (n_a) has
    arrived and is held."""
    if effects.transmission.lags:
        command_at(effects, acting, state, step, filter_state(effects, state, acting.size)[0])


@kernel
def rest_filter(effects, command, state):
    """The filter's part of the internal states where a command (n_a) has always been held."""
    if effects.transmission.filter >= 0:
        u, table = filter_state(effects, state, command.size)
        copy(command, u)
        copy(command, table[0, 1:])
        for row in range(1, len(table)):
            table[row, 0] = NEVER
