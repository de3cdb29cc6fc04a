"""Tendon elasticity: tendons as springs between the arm and actuators that are moved, with slack.

The command of a tendon is the displacement delta [m] by which its actuator has pulled it in, and its tension

    T = min(max(0, k (delta - (L_0 - L))), T_m)

with the length L along the strained rod, L_0 along the stress-free one, and the stiffness k = E A / length of the whole tendon
(D. B. Camarillo et al., Mechanics modeling of tendon-driven continuum manipulators, IEEE Trans. Robotics 24, 2008). A tendon that the arm
shortens by more than it was pulled in hangs slack. An actuator holds its displacement with no more than its strength T_m, the limit of
the current of a motor, and gives way beyond: where a command jumps, a steel cable would pull with thousands of newton otherwise, and
throw or tear the arm. Springs stiffer than the arm are the rule: their tensions are those at the end of every substep.
"""

from typing import Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from soft_tendon_env.effects.base import Discretisation, Effect, register_effect
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Number, Positive


@register_effect("tendon_elasticity")
class TendonElasticity(Effect):
    """`[effects.tendon_elasticity]`. Environments scale actions to `displacement_limits`."""

    is_actuation: ClassVar[bool] = True
    command_unit: ClassVar[str] = "m"

    stiffness: Positive | tuple[Positive, ...] = Field(description="stiffness of the tendons [N/m], one for all or one each")
    displacement_limits: tuple[Number, Number] = Field(description="least and greatest displacement of the actuators [m]")
    strength: Positive | tuple[Positive, ...] | None = Field(
        None, description="strength of the actuators [N], one for all or one each; by default the greatest of `tension_limits`"
    )

    @field_validator("displacement_limits")
    @classmethod
    def _ordered(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not limits[0] < limits[1]:
            raise ValueError("should be (least, greatest), least before greatest")
        return limits

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        tendons = len(rod.tension_limits)
        for key in ("stiffness", "strength"):
            given = getattr(self, key)
            if isinstance(given, tuple) and len(given) != tendons:
                text = f"has {len(given)} values: it should be one number, or one for each of the {tendons} tendons"
                raise ConfigurationError([Problem(("effects", "tendon_elasticity", key), text)])
        strength = np.maximum(rod.tension_limits[:, 1], 0.0) if self.strength is None else self.strength
        each = {"stiffness": np.full(tendons, self.stiffness), "strength": np.full(tendons, strength), "length": rod.tendon_length.copy()}
        return {"elastic": 1, **each}
