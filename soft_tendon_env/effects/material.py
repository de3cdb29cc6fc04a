"""Materials: stresses of the strains besides the linear law, stiffening and memory.

The memory is viscoelastic.
"""

import math
from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import adds_stress
from soft_tendon_env.mechanics.types import point_field
from soft_tendon_env.tools.configuration import Configuration
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.types import Positive

# of a relaxation time, up to which a time step meets a spring alone: that costs a step less than a
# spring and a damper
SHORT = 0.25
SMALL_TIME = 1e-3  # relaxation times, below which a mean is its series


@register("effect", "nonlinear_elasticity")
class NonlinearElasticity(Effect):
    """`[effects.nonlinear_elasticity]`: stress that stiffens with the strain e = xi - xi*.

    It is sigma_i = Sigma_i e_i (1 + (e_i / e0_i)^2) of every strain.

    The leading term of any law that is odd in the strain (R. W. Ogden, Non-linear Elastic
    Deformations, 1984, chapter 4), as silicone and rubber stiffen. Its energy per length is 1/2
    Sigma_i e_i^2 (1 + (e_i / e0_i)^2 / 2). A strain without an e0_i stays linear.
    """

    is_uniform: ClassVar[bool] = True

    torsion: Positive | None = Field(None, description="e0 of torsion [1/m]")
    bending: Positive | None = Field(
        None,
        description=(
            "e0 of both curvatures [1/m]; the surface of a rod of radius r is strained by r e0"
        ),
    )
    stretch: Positive | None = Field(None, description="e0 of stretch [-]")
    shear: Positive | None = Field(None, description="e0 of both shears [-]")

    @property
    def rate(self) -> Array:
        """1 / e0^2 of the six strains."""
        kinds = self.torsion, self.bending, self.bending, self.stretch, self.shear, self.shear
        return np.array([0.0 if strain is None else strain**-2.0 for strain in kinds])

    def parameters(self, rod: Discretisation) -> "NonlinearElasticityParameters":
        return NonlinearElasticityParameters(self.rate)

    def potential_energy(self, arm: Configured) -> float:
        return 0.25 * float(arm.weight @ (arm.stiffness * arm.strain**4) @ self.rate)


class NonlinearElasticityParameters(Struct):
    """1 / e0^2 of the six strains."""

    rate: Array


@adds_stress(NonlinearElasticityParameters)
@kernel
def stiffening_stress(law, points):
    """Sigma e^3 / e0^2 at every point, beside the linear stress."""
    for block in range(2 * points.packs):
        for i in range(6):
            at = (block * 6 + i) * LANES
            reference = load(points.reference, at)
            strain = load(points.strain, at) - reference
            root = load(points.root_stiffness, at)
            # Sigma e^2 / e0^2
            slope = law.rate[i] * root * root * strain * strain
            add(points.stress, at, slope * strain)
            add(points.stiffness, at, 3.0 * slope)


@kernel(inline=True)
def add(field, at, value):
    """field[at ..] += value."""
    store(field, at, load(field, at) + value)


class Branch(Configuration):
    """A Maxwell branch, alike for all strains."""

    modulus: Positive = Field(description="its share of the static moduli [-]")
    relaxation_time: Positive = Field(description="relaxation time [s]")


@register("effect", "viscoelastic_memory")
class ViscoelasticMemory(Effect):
    """`[effects.viscoelastic_memory]`: Maxwell branches, the standard linear solid.

    They are the tables `[[effects.viscoelastic_memory.branches]]`.

    A branch k, a spring of modulus ratio m_k in series with a damper of relaxation time tau_k, adds
    the stress m_k Sigma (e - s_k) with e = xi - xi* and the strain s_k of its damper, s_k_dot = (e
    - s_k) / tau_k (J. C. Simo and T. J. R. Hughes, Computational Inelasticity, 1998, section 10.2).
    At rest it adds nothing. The internal state is s_k at every point, exact for a strain that is a
    quadratic of time. Over a time step a branch answers as a spring where that is short beside
    tau_k, as a damper where it is long: so it enters the implicit step, and may be as stiff and
    fast as it likes.
    """

    is_uniform: ClassVar[bool] = True

    branches: tuple[Branch, ...] = Field(
        min_length=1, description="one or more tables, see `Branch`"
    )

    def parameters(self, rod: Discretisation) -> "MemoryParameters":
        moduli = np.array([branch.modulus for branch in self.branches])
        time = np.array([branch.relaxation_time for branch in self.branches])
        # what lasts over a substep, which is shorter than a step
        is_short = rod.step > SHORT * time
        decayed = np.exp(-0.5 * rod.step / time)
        lasting = np.where(is_short, decayed, 1.0)
        spring = lasting * moduli
        damper = (1.0 - lasting) * time * moduli
        return MemoryParameters(moduli, time, spring, damper)

    def state(self, rod: Discretisation) -> Array:
        return np.zeros(len(self.branches) * rod.point.size * 6)

    def potential_energy(self, arm: Configured) -> float:
        strain = point_field(arm.strain.reshape(-1, 2, 6))
        weighted = arm.weight[:, None] * arm.stiffness
        stiffness = point_field(weighted.reshape(-1, 2, 6))
        states = arm.state.reshape(-1, strain.size)
        lag = strain - states
        # int Sigma (e - s_k)^2 dX of each branch
        squares = lag**2 @ stiffness
        energy = 0.0
        for branch, square in zip(self.branches, squares, strict=True):
            energy += branch.modulus * square
        return 0.5 * float(energy)


class MemoryParameters(Struct):
    """The branches."""

    modulus: Array  # (branches) [-]
    time: Array  # (branches) [s]
    spring: Array  # (branches) [-], what the implicit step takes for stiffness
    damper: Array  # (branches) [s], and for damping


@kernel
def lag_weights(x):
    """Weights of the lag e - s_k after a time of x relaxation times.

    They are of the lag before, of the change of strain, and of the product of that time and the
    rate.
    """
    if x == 0.0:
        return 1.0, 1.0, 0.0
    if x == math.inf:
        return 0.0, 0.0, 0.0
    # means of exp(-x s) and of s exp(-x (1 - s)) over s from 0 to 1
    mean = -math.expm1(-x) / x
    if x > SMALL_TIME:
        slope = (1.0 - mean) / x
    else:
        slope = 0.5 - x / 6.0 + x * x / 24.0
    return math.exp(-x), 2.0 * (mean - slope), 2.0 * slope - mean


@adds_stress(MemoryParameters)
@kernel
def remembered_stress(memory, points):
    """sum_k m_k Sigma (e - s_k) at every point, beside the linear stress, with s_k as it is now."""
    per_branch = points.strain.size
    h = points.since
    for k in range(memory.time.size):
        kept, changed, rated = lag_weights(h / memory.time[k])
        modulus = memory.modulus[k]
        spring = memory.spring[k]
        damper = memory.damper[k]
        for at in range(0, per_branch, LANES):
            state_at = k * per_branch + at
            reference = load(points.reference, at)
            whole = load(points.strain, at)
            strain = whole - reference
            lag = strain - load(points.state, state_at)  # e - s_k, before the time h
            if h > 0.0:
                change = whole - load(points.before, at)
                lag = kept * (lag - change) + changed * change
                if h < math.inf:
                    lag = lag + (rated * h) * load(points.rate, at)
                store(points.state, state_at, strain - lag)
            root = load(points.root_stiffness, at)
            stiffness = root * root
            add(points.stress, at, modulus * stiffness * lag)
            add(points.stiffness, at, spring * stiffness)
            add(points.damping, at, damper * stiffness)
