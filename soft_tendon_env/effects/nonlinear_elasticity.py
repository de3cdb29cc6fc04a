"""Stiffening material: stress sigma_i = Sigma_i e_i (1 + (e_i / e0_i)^2) of every strain e = xi - xi*.

Silicone and rubber arms get stiffer the further they are bent or stretched. This is the leading term of any law that is odd in the
strain (Duffing's; for stretch the next term of an expansion as of R. W. Ogden, Non-linear Elastic Deformations, 1984, chapter 4), strain
by strain, with the linear law for small ones. Its energy per length is 1/2 Sigma_i e_i^2 (1 + (e_i / e0_i)^2 / 2).
"""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Configured, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import adds_stress
from soft_tendon_env.tools.types import Positive


@register_effect("nonlinear_elasticity")
class NonlinearElasticity(Effect):
    """`[effects.nonlinear_elasticity]`: strains at which the stress is twice that of the linear law; one that is not given stays linear."""

    torsion: Positive | None = Field(None, description="e0 of torsion [1/m]")
    bending: Positive | None = Field(None, description="e0 of both curvatures [1/m]; the surface of a rod of radius r is strained by r e0")
    stretch: Positive | None = Field(None, description="e0 of stretch [-]")
    shear: Positive | None = Field(None, description="e0 of both shears [-]")

    @model_validator(mode="after")
    def _stiffens(self) -> Self:
        if self.torsion is self.bending is self.stretch is self.shear is None:
            raise ValueError("should give at least one of torsion, bending [1/m], stretch, shear [-]")
        return self

    @property
    def rate(self) -> tuple[float, float, float, float, float, float]:
        """1 / e0^2 of the six strains."""
        kinds = (self.torsion, self.bending, self.bending, self.stretch, self.shear, self.shear)
        a, b, c, d, e, f = (0.0 if strain is None else strain**-2.0 for strain in kinds)
        return a, b, c, d, e, f

    def parameters(self, rod: Discretisation) -> "NonlinearElasticityParameters":
        return NonlinearElasticityParameters(self.rate)

    def potential_energy(self, arm: Configured) -> float:
        return 0.25 * float(arm.weight @ (arm.stiffness * arm.strain**4) @ np.array(self.rate))


class NonlinearElasticityParameters(Struct):
    """1 / e0^2 of the six strains."""

    rate: tuple[float, float, float, float, float, float]


@adds_stress(NonlinearElasticityParameters)
@kernel
def stiffening_stress(law, points):
    """Sigma e^3 / e0^2 at every point, beside the linear stress."""
    for block in range(2 * points.packs):
        for i in range(6):
            at = (block * 6 + i) * LANES
            strain, root = load(points.strain, at) - load(points.reference, at), load(points.root_stiffness, at)
            slope = law.rate[i] * root * root * strain * strain
            store(points.stress, at, load(points.stress, at) + slope * strain)
            store(points.stiffness, at, load(points.stiffness, at) + 3.0 * slope)
