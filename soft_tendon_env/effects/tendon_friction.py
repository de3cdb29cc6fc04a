"""Tendon friction: Coulomb friction of tendons in their channels by the capstan equation.

The tension falls along a tendon that is pulled in, and grows along one that is let out, with the angle phi(s) by which the path has turned,

    T(s) = T(0) exp(-mu z phi(s)),    z = v / sqrt(v^2 + v_s^2),

v = -dL/dt being the rate at which the tendon is pulled in, and z its direction of sliding, 1 pulled in, -1 let out: the capstan equation
(T. N. Do et al., Hysteresis modeling and position control of tendon-sheath mechanism, Mechatronics 24, 2014) with Coulomb friction that is
made smooth below a speed v_s, as in MuJoCo and Drake. One direction holds for the whole tendon: fronts of sliding that move along it after
a reversal are left out.

Where friction would hold a tendon it creeps instead, at less than v_s: a cycle has hysteresis, but an arm that is left alone comes to the
rest that it has without friction. A soft arm of 0.3 m that friction holds 36 mm off that rest is 13 mm off after 10 s. The tensions of the
strain law have no friction: what it takes away bends coordinates that tensions alone leave at zero, and a strain with passive fields
follows it better. The friction in a step is that of the rates at its end.
"""

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.effects.base import Discretisation, Effect, register_effect
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Positive

STEEPEST = 100.0  # mu phi along the stress-free arm


@register_effect("tendon_friction")
class TendonFriction(Effect):
    """`[effects.tendon_friction]`."""

    is_actuation: ClassVar[bool] = True

    coefficient: Annotated[float, Field(ge=0, le=10)] = Field(description="coefficient of friction mu [-]")
    stiction_speed: Positive = Field(1e-4, description="speed v_s [m/s] below which friction falls")

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        i = int(np.argmax(rod.tendon_turn))
        if self.coefficient * rod.tendon_turn[i] > STEEPEST:
            text = f"is {self.coefficient:g}: tendon {i} turns by {rod.tendon_turn[i]:.3g} rad, for which it should be at most"
            problem = f"{text} {STEEPEST / rod.tendon_turn[i]:.3g}, or the tension let out grows by more than exp({STEEPEST:g})"
            raise ConfigurationError([Problem(("effects", "tendon_friction", "coefficient"), problem)])
        return {"friction": self.coefficient, "stiction_speed": self.stiction_speed}
