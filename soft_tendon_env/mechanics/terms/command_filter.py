"""Filter of commands in front of the tendons: delay, lag and limited rate, see effects.Transmission.

Commands wait in a queue until the delay is over. What has arrived, c, acts as u with u_dot = clip((c - u) / tau, -r, r): as long as c is
held u is a function of time that is known exactly, so that it is no coordinate of the integrator. Its steps end where commands arrive.
The internal state is u, c, and the commands on their way with the times of their arrival.
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
def filter_state(effects, state):
    """Internal state of the filter, in those of all effects."""
    i = effects.transmission.filter
    return state[effects.first_state[i] : effects.first_state[i + 1]]


@kernel(refcount=True)
def queue_of(own, tendons):
    """Times of arrival and commands on their way (room, 1 + n_a), of the filter's internal state."""
    return own[2 * tendons :].reshape(-1, 1 + tendons)


@kernel(inline=True)
def has_arrived_by(time):
    """Time [s] of arrival up to which a command acts at a time [s]."""
    return time + EARLY + ROUND_OFF * abs(time)


@kernel
def receive(effects, command, begins, time, state, acting, until):
    """Writes the command that has arrived into `acting` (n_a) where one (n_a) is given, from this time [s] on if it `begins`, and into
    `until` (1) when the next integrator step should end [s]; -infinity where the queue has no room."""
    copy(command, acting)
    until[0] = math.inf
    if effects.transmission.filter >= 0:
        arrive(effects, begins, time, state, acting, until)


@phase
def arrive(effects, begins, time, state, acting, until):
    """receive() of a filter, where `acting` holds what is commanded."""
    path, own = effects.transmission, filter_state(effects, state)
    if path.delay > 0.0:
        queue(path.delay, begins, time, own, acting, until)
    if path.lags:
        until[0] = min(until[0], time + settling_time(path, own, acting))


@kernel
def queue(delay, begins, time, own, acting, until):
    """Keep a command that begins until its time, and put in its place the one that has arrived.

    Where there is room, one that repeats the last one is kept too: it has a derivative of its own.
    """
    tendons, arrival, count = acting.size, time + delay, 0
    last, waiting = own[tendons : 2 * tendons], queue_of(own, tendons)
    while count < len(waiting) and waiting[count, 0] < NEVER:
        count += 1
    is_new = begins and differ(last if count == 0 else waiting[count - 1, 1:], acting)
    if is_new and count == len(waiting):
        k = first_change(last, waiting, False)
        if k == count:
            until[0] = -math.inf
            return
        count -= 1
        leave(k, count, waiting)
    repeats = begins and count < len(waiting) and (count == 0 or waiting[count - 1, 0] < arrival - EARLY)
    if is_new or repeats:
        waiting[count, 0] = arrival
        copy(acting, waiting[count, 1:])
        count += 1
    while count > 0 and waiting[0, 0] <= has_arrived_by(time):
        copy(waiting[0, 1:], last)
        count -= 1
        leave(0, count, waiting)
    copy(last, acting)
    k = first_change(last, waiting[:count], True)
    if k < count:
        until[0] = waiting[k, 0]


@kernel
def leave(k, last, waiting):
    """Take the k-th command out of the queue, of which `last` remain."""
    for place in range(k, last):
        copy(waiting[place + 1], waiting[place])
    waiting[last, 0] = NEVER
    waiting[last, 1:] = 0.0


@kernel
def differ(command, other):
    """Whether two commands differ."""
    for i in range(command.size):
        if command[i] != other[i]:
            return True
    return False


@kernel
def first_change(last, waiting, changes):
    """Place of the first command in the queue that differs from the one before it, or without `changes` of the first that repeats it; or
    its length."""
    for k in range(len(waiting)):
        if differ(last if k == 0 else waiting[k - 1, 1:], waiting[k, 1:]) == changes:
            return k
    return len(waiting)


@kernel
def settling_time(path, own, acting):
    """Time [s] to the next kink of u: the end of its limited rate, or some time constants while it lags."""
    soonest, largest, slow = math.inf, 0.0, path.rate_limit * path.time_constant
    for i in range(acting.size):
        largest = max(largest, abs(acting[i]), abs(own[i]))
    for i in range(acting.size):
        away = abs(acting[i] - own[i])
        if away > SETTLED * largest:
            soonest = min(soonest, LAGS * path.time_constant if away <= slow else (away - slow) / path.rate_limit)
    return max(soonest, path.finest)


@kernel
def limited_time(path, away, step):
    """For how much of a time [s] the rate is limited, and what the lag leaves over the rest of it of how far u is away."""
    limited = 0.0
    slow = path.rate_limit * path.time_constant if path.time_constant > 0.0 else 0.0  # nearer than this the rate is below its limit
    if abs(away) > slow and path.rate_limit < math.inf:
        limited = min((abs(away) - slow) / path.rate_limit, step)
    rest = step - limited
    return limited, math.exp(-rest / path.time_constant) if path.time_constant > 0.0 else 1.0 if rest == 0.0 else 0.0


@kernel
def lagged(path, u, command, step):
    """u after a time [s] towards a command that is held, exactly."""
    away = command - u
    limited, left = limited_time(path, away, step)
    kink = u + math.copysign(path.rate_limit * limited, away) if limited > 0.0 else u
    return u if step == 0.0 else command + (kink - command) * left


@kernel
def lag_slopes(path, away, step):
    """Derivatives by u of lagged(), and of its mean over the time; those by the command are what is left to 1. Without a lag the command
    is the mean, and u stays."""
    if not path.lags:
        return 1.0, 0.0
    limited, left = limited_time(path, away, step)
    return left, (limited + path.time_constant * (1.0 - left)) / step


@kernel(refcount=True)
def command_at(effects, acting, state, since, out):
    """The command that acts a time [s] after the internal states were `state`, where `acting` (n_a) has arrived and is held; in `out`, or
    `acting` itself."""
    if not effects.transmission.lags:
        return acting
    first = effects.first_state[effects.transmission.filter]
    for i in range(acting.size):
        out[i] = lagged(effects.transmission, state[first + i], acting[i], since)
    return out


@kernel
def follow(effects, acting, step, state):
    """Advances the filter's part of the internal states by a time [s] in which `acting` (n_a) has arrived and is held."""
    if effects.transmission.lags:
        first = effects.first_state[effects.transmission.filter]
        for i in range(acting.size):
            state[first + i] = lagged(effects.transmission, state[first + i], acting[i], step)


@kernel
def rest_filter(effects, command, state):
    """The filter's part of the internal states where a command (n_a) has always been held."""
    if effects.transmission.filter >= 0:
        own, tendons = filter_state(effects, state), command.size
        waiting = queue_of(own, tendons)
        copy(command, own[:tendons])
        copy(command, own[tendons : 2 * tendons])
        for k in range(len(waiting)):
            leave(k, k, waiting)
