"""Actuator dynamics: lag, rate limit and delay between the command and the tension that a tendon is pulled with.

A first-order lag with a limited rate, u_dot = clip((c - u) / tau, -r, r), after a dead time in which the command c waits: u(t) follows
c(t - delay). u is a function of time that is known exactly for a command that is held (zero-order hold), and integrator steps end where a
command arrives, so that a delay of any length is as exact as one of whole steps (K. J. Astrom and B. Wittenmark, Computer-Controlled
Systems, 1997, chapter 2).

The internal state is u, the command that acts, and those on their way with the times of their arrival. There is room for one new command
in every `integrator.step`; more of them end the simulation with that message.
"""

import math
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.effects.base import Array, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.terms.command_filter import NEVER
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import NotNegative, Positive

FINEST = 1.0 / 8.0  # of the longest step
MOST_WAITING = 10_000  # commands


@register_effect("actuators")
class Actuators(Effect):
    """`[effects.actuators]`."""

    is_actuation: ClassVar[bool] = True

    time_constant: NotNegative = Field(0.0, description="time constant of the lag [s]")
    rate_limit: Positive | None = Field(None, description="greatest rate [N/s], with elastic tendons [m/s]")
    delay: Annotated[float, Field(ge=0, le=100)] = Field(0.0, description="dead time [s]")

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        if self.delay > MOST_WAITING * rod.step:
            most = MOST_WAITING * rod.step
            text = f"is {self.delay:g}: it should be at most {most:g} s, {MOST_WAITING} integrator steps of {rod.step:g} s"
            raise ConfigurationError([Problem(("effects", "actuators", "delay"), text)])
        return {
            "lags": 1 if self.time_constant > 0.0 or self.rate_limit is not None else 0,
            "delay": self.delay,
            "time_constant": self.time_constant,
            "rate_limit": math.inf if self.rate_limit is None else self.rate_limit,
            "finest": FINEST * rod.step,
        }

    def state(self, rod: Discretisation) -> Array:
        tendons = rod.tendon_length.size
        table = np.zeros((math.ceil(self.delay / rod.step * (1.0 - 1e-9)) + 2 if self.delay else 1, 1 + tendons))
        table[1:, 0] = NEVER
        return np.concatenate([np.zeros(tendons), table.ravel()])
