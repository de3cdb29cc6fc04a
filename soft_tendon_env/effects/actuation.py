"""Actuation: what lies between a command and the tension along a tendon.

Effects are actuators with lag and delay, elastic tendons, and friction.

Kernels read the numbers as `mechanics.effects.Transmission`.
"""

import math
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from soft_tendon_env.effects.base import Array, Discretisation, Effect
from soft_tendon_env.mechanics.terms.command_filter import NEVER
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.types import NotNegative, Number, Positive

FINEST = 1.0 / 8.0  # of the longest step
MOST_WAITING = 10_000  # commands
STEEPEST = 100.0  # mu phi along the stress-free arm
# [m/s] of stiction, which steps hold: it is some 1,000 times the round-off of rates of sliding
LEAST_SPEED = 1e-12
SAME = 1e-9  # of a number of steps, by which another one may differ and be the same


@register("effect", "actuators")
class Actuators(Effect):
    """`[effects.actuators]`: first-order lag with a limited rate, after a dead time.

    The lag is u_dot = clip((c - u) / tau, -r, r).

    u(t) follows the command c(t - delay), exactly for commands that are held: integrator steps end
    where one arrives (K. J. Astrom and B. Wittenmark, Computer-Controlled Systems, 1997, chapter
    2). The internal state is u, the command that acts, and those on their way with the times of
    their arrival. There is room for one new command in every `integrator.step`: more end the
    simulation.
    """

    is_actuation: ClassVar[bool] = True

    time_constant: NotNegative = Field(0.0, description="time constant of the lag [s]")
    rate_limit: Positive | None = Field(
        None, description="greatest rate [N/s], with elastic tendons [m/s]"
    )
    delay: Annotated[float, Field(ge=0, le=100)] = Field(0.0, description="dead time [s]")

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        most = MOST_WAITING * rod.step
        if self.delay > most:
            text = (
                f"is {self.delay:g}: it should be at most {most:g} s, {MOST_WAITING} integrator"
                f" steps of {rod.step:g} s"
            )
            raise ConfigurationError([Problem(("effects", "actuators", "delay"), text)])
        lags = self.time_constant > 0.0 or self.rate_limit is not None
        return {
            "delay": self.delay,
            "lags": int(lags),
            "time_constant": self.time_constant,
            "rate_limit": self.rate_limit or math.inf,
            "finest": FINEST * rod.step,
        }

    def state(self, rod: Discretisation) -> Array:
        tendons = rod.tendon_length.size
        rows = 1  # what has arrived
        if self.delay:  # one on its way for every step of the delay, and one more
            steps = self.delay / rod.step
            rows += math.ceil(steps * (1.0 - SAME)) + 1
        table = np.zeros((rows, 1 + tendons))
        table[1:, 0] = NEVER
        arrived = np.zeros(tendons)
        return np.concatenate([arrived, table.ravel()])


@register("effect", "tendon_elasticity")
class TendonElasticity(Effect):
    """`[effects.tendon_elasticity]`: tendons as springs with slack.

    They lie between the arm and actuators with displacements as commands.

    The command of a tendon is the displacement delta [m] by which its actuator has pulled it in,
    and its tension

        T = min(max(0, k (delta - l - (L_0 - L))), T_m)

    with the length L along the strained rod, L_0 along the stress-free one, the slack l, the
    stiffness k = E A / length of the whole tendon (D. B. Camarillo et al., IEEE Trans. Robotics 24,
    2008) and the strength T_m of the actuator, which gives way beyond. Springs stiffer than the arm
    are the rule: their tensions are those at the end of every substep. Environments scale actions
    to `displacement_limits`.
    """

    is_actuation: ClassVar[bool] = True
    command_unit: ClassVar[str] = "m"

    stiffness: Positive = Field(description="stiffness of the tendons [N/m]")
    displacement_limits: tuple[Number, Number] = Field(
        description="least and greatest displacement of the actuators [m]"
    )
    slack: tuple[Number, ...] = Field(
        (),
        description=(
            "slack of each tendon at displacement 0 [m], negative: pretension; none by default"
        ),
    )
    strength: Positive | None = Field(
        None,
        description="strength of the actuators [N]; by default the greatest of `tension_limits`",
    )

    @field_validator("displacement_limits")
    @classmethod
    def _ordered(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not limits[0] < limits[1]:
            raise ValueError("should be (least, greatest), least before greatest")
        return limits

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        tendons = len(rod.tension_limits)
        if len(self.slack) not in (0, tendons):
            text = f"has {len(self.slack)} entries: it should have one for each tendon, {tendons}"
            raise ConfigurationError([Problem(("effects", "tendon_elasticity", "slack"), text)])
        slack = np.array(self.slack or np.zeros(tendons))
        if self.strength is None:
            strength = np.maximum(rod.tension_limits[:, 1], 0.0)
        else:
            strength = np.full(tendons, self.strength)
        return {
            "elastic": 1,
            "stiffness": np.full(tendons, self.stiffness),
            "strength": strength,
            "length": rod.tendon_length + slack,
        }


@register("effect", "tendon_friction")
class TendonFriction(Effect):
    """`[effects.tendon_friction]`: Coulomb friction of tendons in their channels, regularised.

    By the capstan equation the tension falls, towards the end of the tendon, by the angle phi by
    which the path turns, in the direction in which the tendon slides there:

        dT / ds = -mu z T dphi / ds,    z = v / sqrt(v^2 + v_s^2)

    (T. N. Do et al., Mechatronics 24, 2014), v the rate at which the length from s to the tendon's
    end shrinks, at the rates of a step's end. So friction takes energy wherever a tendon slides,
    and never gives any. Where it would hold a tendon that creeps instead, at about v_s: with
    motions of v the tensions are right to about v_s / v. What friction takes away bends coordinates
    that tensions alone leave at zero, and places slide apart only as far as the coordinates let
    them: a strain with passive fields follows it better.
    """

    is_actuation: ClassVar[bool] = True

    coefficient: Annotated[float, Field(ge=0, le=10)] = Field(
        description="coefficient of friction mu [-]"
    )
    stiction_speed: Annotated[NotNegative, Field(ge=LEAST_SPEED)] = Field(
        1e-4, description="speed v_s [m/s] of sliding below which friction falls"
    )

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        most = float(rod.tendon_turn.max())
        if self.coefficient * most > STEEPEST:
            tendon = int(np.argmax(rod.tendon_turn))
            text = (
                f"is {self.coefficient:g}: tendon {tendon} turns by {most:.3g} rad: it should be"
                f" at most {STEEPEST / most:.3g}, or tensions let out grow by more than"
                f" exp({STEEPEST:g})"
            )
            raise ConfigurationError([Problem(("effects", "tendon_friction", "coefficient"), text)])
        return {"friction": self.coefficient, "stiction_speed": self.stiction_speed}
