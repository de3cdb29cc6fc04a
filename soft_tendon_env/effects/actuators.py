"""Actuator dynamics: lag, rate limit and delay between the command and the tension that a tendon is pulled with.

A first-order lag with a limited rate, u_dot = clip((c - u) / tau, -r, r), after a dead time in which the command c waits: u(t) follows
c(t - delay). It is advanced exactly for a command that is held (zero-order hold), and integrator steps end where a command arrives, so
that a delay of any length is as exact as one of whole steps (K. J. Astrom and B. Wittenmark, Computer-Controlled Systems, 1997, chapter 2).

The internal state is u, the command that acts, and those on their way with the times of their arrival. There is room for one new command
in every `integrator.step`; more of them end the simulation with that message.
"""

import math
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.effects import delivers_command, follows_command, makes_tension
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

NEVER = 1e30  # [s], the arrival of what is not on its way
SETTLED = 0.02  # of the largest tension: what is nearer to its command than this has arrived
LAGS = 2.0  # time constants that a step may take while a tension lags
FINEST = 1.0 / 8.0  # of the longest step
MOST_WAITING = 10_000  # commands
EARLY = 1e-9  # [s] by which a command may act before its time: clocks are sums of steps
ROUND_OFF = 1e-15  # of the time, by which besides


@register_effect("actuators")
class Actuators(Effect):
    """`[effects.actuators]`. `time_constant` [s] of the lag, `delay` [s], `rate_limit` [N/s], or with elastic tendons [m/s]; none of them
    by default."""

    is_actuation: ClassVar[bool] = True

    time_constant: NotNegative = 0.0
    rate_limit: Positive | None = None
    delay: Annotated[float, Field(ge=0, le=100)] = 0.0

    def parameters(self, rod: Discretisation) -> "ActuatorParameters":
        if self.delay > MOST_WAITING * rod.step:
            most = MOST_WAITING * rod.step
            text = f"is {self.delay:g}: it should be at most {most:g} s, {MOST_WAITING} integrator steps of {rod.step:g} s"
            raise ConfigurationError([Problem(("effects", "actuators", "delay"), text)])
        rate_limit = math.inf if self.rate_limit is None else self.rate_limit
        return ActuatorParameters(self.time_constant, rate_limit, self.delay, FINEST * rod.step)

    def state(self, rod: Discretisation) -> Array:
        return self._state(rod, 0.0, NEVER)

    def state_tendons(self, rod: Discretisation) -> Array:
        return self._state(rod, np.arange(rod.tendon_length.size), -1.0)

    def _state(self, rod: Discretisation, of_tendons: Any, of_times: float) -> Array:
        """Values of all internal states: those of the tendons (n_a,), and of the times of arrival."""
        tendons = rod.tendon_length.size
        waiting = np.empty((math.ceil(self.delay / rod.step * (1.0 - 1e-9)) + 1 if self.delay else 0, 1 + tendons))
        waiting[:, 0], waiting[:, 1:] = of_times, of_tendons
        return np.concatenate([np.tile(np.broadcast_to(of_tendons, tendons), 2), waiting.ravel()])

    def potential_energy(self, arm: Configured) -> float:
        return 0.0


class ActuatorParameters(NamedTuple):
    """The path of a command."""

    time_constant: float  # [s]
    rate_limit: float  # [N/s]
    delay: float  # [s]
    finest: float  # [s], the shortest step that a tension on its way asks for


@kernel
def forget(place):
    """Empty the place of a command that waited."""
    place[0] = NEVER
    for i in range(1, place.size):
        place[i] = 0.0


@kernel
def leave(k, last, waiting):
    """Take the k-th command out of the queue, of which `last` remain."""
    for place in range(k, last):
        copy(waiting[place + 1], waiting[place])
    forget(waiting[last])


@kernel
def differ(command, other):
    """Whether two commands differ."""
    for i in range(command.size):
        if command[i] != other[i]:
            return True
    return False


@kernel
def first_change(acting, waiting, changes):
    """Place of the first command in the queue that differs from the one before it, or without `changes` of the first that repeats it; or
    its length."""
    for k in range(len(waiting)):
        if differ(acting if k == 0 else waiting[k - 1, 1:], waiting[k, 1:]) == changes:
            return k
    return len(waiting)


@kernel
def queue(actuators, delivery):
    """Keep a command that begins until its time, and put in its place the one that has arrived.

    Where there is room, one that repeats the last one is kept too: it has a derivative of its own.
    """
    tendons, state, arrival = delivery.command.size, delivery.state, delivery.time + actuators.delay
    acting, waiting = state[tendons : 2 * tendons], state[2 * tendons :].reshape(-1, 1 + tendons)
    count = 0
    while count < len(waiting) and waiting[count, 0] < NEVER:
        count += 1
    is_new = delivery.begins and differ(acting if count == 0 else waiting[count - 1, 1:], delivery.command)
    if is_new and count == len(waiting):
        k = first_change(acting, waiting, False)
        if k == count:
            delivery.until[0] = -math.inf
            return
        count -= 1
        leave(k, count, waiting)
    repeats = delivery.begins and count < len(waiting) and (count == 0 or waiting[count - 1, 0] < arrival - EARLY)
    if is_new or repeats:
        waiting[count, 0] = arrival
        copy(delivery.command, waiting[count, 1:])
        count += 1
    while count > 0 and waiting[0, 0] <= delivery.time + EARLY + ROUND_OFF * abs(delivery.time):
        copy(waiting[0, 1:], acting)
        count -= 1
        leave(0, count, waiting)
    copy(acting, delivery.command)
    k = first_change(acting, waiting[:count], True)
    if k < count:
        delivery.until[0] = min(delivery.until[0], waiting[k, 0])


@kernel
def is_prompt(actuators):
    """Whether what has arrived acts at once."""
    return actuators.time_constant == 0.0 and actuators.rate_limit == math.inf


@kernel
def arrival(actuators, delivery):
    """Time [s] to the next kink of a tension: the end of its limited rate, or some time constants while it lags."""
    u, command, soonest, largest = delivery.state, delivery.command, math.inf, 0.0
    slow = actuators.rate_limit * actuators.time_constant
    for i in range(command.size):
        largest = max(largest, abs(command[i]), abs(u[i]))
    for i in range(command.size):
        away = abs(command[i] - u[i])
        if away > SETTLED * largest:
            soonest = min(soonest, LAGS * actuators.time_constant if away <= slow else (away - slow) / actuators.rate_limit)
    return max(soonest, actuators.finest)


@delivers_command(ActuatorParameters)
@kernel
def wait(actuators, delivery):
    """Keep a new command until its time, let those act that have arrived, and end steps where tensions arrive at them."""
    if actuators.delay > 0.0:
        queue(actuators, delivery)
    if not is_prompt(actuators):
        delivery.until[0] = min(delivery.until[0], delivery.time + arrival(actuators, delivery))


@kernel
def lagged(actuators, u, command, step):
    """u after a step [s] towards a command that is held, exactly."""
    away = command - u
    if step == math.inf:
        return command
    if actuators.time_constant == 0.0:
        return u + min(max(away, -actuators.rate_limit * step), actuators.rate_limit * step)
    slow = actuators.rate_limit * actuators.time_constant  # nearer than this the rate is below its limit
    if abs(away) > slow:
        limited = min((abs(away) - slow) / actuators.rate_limit, step)
        u, step = u + math.copysign(actuators.rate_limit * limited, away), step - limited
    return command + (u - command) * math.exp(-step / actuators.time_constant)


@makes_tension(ActuatorParameters)
@kernel
def lagging_tension(actuators, actuation):
    """u in place of the command."""
    if not is_prompt(actuators):
        for i in range(actuation.tension.size):
            actuation.tension[i] = actuation.state[i]


@follows_command(ActuatorParameters)
@kernel
def follow(actuators, step, actuation):
    """Advance u; in a step of infinity all that is commanded has arrived."""
    tendons, state = actuation.command.size, actuation.state
    for i in range(tendons):
        state[i] = actuation.command[i] if is_prompt(actuators) else lagged(actuators, state[i], actuation.command[i], step)
    if step == math.inf:
        copy(actuation.command, state[tendons : 2 * tendons])
        waiting = state[2 * tendons :].reshape(-1, 1 + tendons)
        for k in range(len(waiting)):
            forget(waiting[k])
