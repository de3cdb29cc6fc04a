"""Tendon elasticity: tendons as springs between the arm and actuators that are moved, with slack.

The command of a tendon is the displacement delta [m] by which its actuator has pulled it in, and its tension

    T = min(max(0, k (delta - (L_0 - L))), T_m)

with the length L along the strained rod, L_0 along the stress-free one, and the stiffness k = E A / length of the whole tendon
(D. B. Camarillo et al., Mechanics modeling of tendon-driven continuum manipulators, IEEE Trans. Robotics 24, 2008). A tendon that the arm
shortens by more than it was pulled in hangs slack. An actuator holds its displacement with no more than its strength T_m, the limit of
the current of a motor, and gives way beyond: where a command jumps, a steel cable would pull with thousands of newton otherwise, and
throw or tear the arm. Springs stiffer than the arm are the rule, so that they enter the implicit step.
"""

from typing import ClassVar, NamedTuple

import numpy as np
from pydantic import field_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.effect_parameters import Vector
from soft_tendon_env.mechanics.effects import makes_tension
from soft_tendon_env.mechanics.terms.tendons import path_lengths
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Number, Positive


@register_effect("tendon_elasticity")
class TendonElasticity(Effect):
    """`[effects.tendon_elasticity]`. `stiffness` [N/m] of the tendons, one for all or one each; `displacement_limits` (least, greatest)
    [m] of the actuators, which environments scale actions to; `strength` [N] of the actuators, one for all or one each, by default the
    greatest of a tendon's `tension_limits`."""

    is_actuation: ClassVar[bool] = True
    command_unit: ClassVar[str] = "m"

    stiffness: Positive | tuple[Positive, ...]
    displacement_limits: tuple[Number, Number]
    strength: Positive | tuple[Positive, ...] | None = None

    @field_validator("displacement_limits")
    @classmethod
    def _ordered(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not limits[0] < limits[1]:
            raise ValueError("should be (least, greatest), least before greatest")
        return limits

    def parameters(self, rod: Discretisation) -> "ElasticityParameters":
        tendons = len(rod.tension_limits)
        for key in ("stiffness", "strength"):
            given = getattr(self, key)
            if isinstance(given, tuple) and len(given) != tendons:
                text = f"has {len(given)} values: it should be one number, or one for each of the {tendons} tendons"
                raise ConfigurationError([Problem(("effects", "tendon_elasticity", key), text)])
        stiffness, strength = (Vector(np.full(tendons, values)) for values in (self.stiffness, self._strengths(rod.tension_limits)))
        return ElasticityParameters(stiffness, Vector(rod.tendon_length), strength)

    def state_tendons(self, rod: Discretisation) -> Array:
        return np.empty(0)

    def _strengths(self, limits: Array) -> Array:
        return np.asarray(np.maximum(limits[:, 1], 0.0) if self.strength is None else self.strength)

    def command(self, tension: Array, shortening: Array) -> Array:
        return tension / np.asarray(self.stiffness) + shortening

    def tension(self, command: Array, shortening: Array, limits: Array) -> Array:
        return np.clip(np.asarray(self.stiffness) * (command - shortening), 0.0, self._strengths(limits))

    def command_limits(self, limits: Array) -> Array:
        return np.tile(np.array(self.displacement_limits), (len(limits), 1))


class ElasticityParameters(NamedTuple):
    """The springs."""

    stiffness: Vector  # (n_a) [N/m]
    length: Vector  # (n_a) [m] along the stress-free rod
    strength: Vector  # (n_a) [N] of the actuators


@makes_tension(ElasticityParameters)
@kernel(refcount=True)
def spring_tension(springs, actuation):
    """k times the stretch of every tendon, between slack and what its actuator can hold."""
    length = np.empty(actuation.tension.size)
    path_lengths(actuation.geometry, actuation.first, actuation.last, actuation.weight, actuation.strain, 2 * actuation.packs, length)
    for i in range(length.size):
        actuation.tension[i] = springs.stiffness[i] * (actuation.tension[i] - (springs.length[i] - length[i]))
        actuation.stiffness[i] = springs.stiffness[i]
        actuation.least[i], actuation.greatest[i] = 0.0, springs.strength[i]
