"""A wrench at the tip, and a payload fixed to it."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from soft_tendon_env.effects.base import DeadLoads, Effect, random_vector, register_effect, size
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import rotate_back
from soft_tendon_env.mechanics.terms.kinematics import tip_pose_of
from soft_tendon_env.mechanics.terms.loads import adds_wrench
from soft_tendon_env.tools.compilation import kernel

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
NotNegative = Annotated[float, Field(ge=0)]


@register_effect("tip_load")
class TipLoad(Effect):
    """`[effects.tip_load]`.

    `force` (x, y, z) [N] and `moment` (x, y, z) [N m] act at the tip, with components in `frame`: "world" (a dead load)
    or "tip" (a load that follows the tip). `mass` [kg] and `inertia` (principal moments about the tip frame's axes)
    [kg m^2] belong to a payload whose centre of mass is the tip frame's origin.
    """

    force: Vector = (0.0, 0.0, 0.0)
    moment: Vector = (0.0, 0.0, 0.0)
    frame: Literal["world", "tip"] = "world"
    mass: NotNegative = 0.0
    inertia: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    def parameters(self) -> "TipLoadParameters":
        return TipLoadParameters(self.force, self.moment, self.frame == "tip")

    def dead_loads(self) -> DeadLoads | None:
        follows = self.frame == "tip" and (any(self.force) or any(self.moment))
        return None if follows else DeadLoads(force=self.force, moment=self.moment)

    def varied(self, random: np.random.Generator) -> "TipLoad":
        part = random.random()
        x, y, z = self.inertia
        return TipLoad(
            force=random_vector(random, self.force),
            moment=random_vector(random, self.moment),
            frame=self.frame,
            mass=part * self.mass,
            inertia=(part * x, part * y, part * z),
        )

    def covers(self, other: "TipLoad") -> bool:
        sizes = ((own.mass, size(own.inertia), size(own.force), size(own.moment)) for own in (self, other))
        alike = self.frame == other.frame or not (any(other.force) or any(other.moment))
        return alike and all(most >= needed for most, needed in zip(*sizes, strict=True))


class TipLoadParameters(NamedTuple):
    """The wrench and its frame; the payload is part of the rod's inertia."""

    force: Vector
    moment: Vector
    follows_tip: bool

    def potential_energy(self, mass: Array, position: Array) -> float:
        if any(self.moment) or (self.follows_tip and any(self.force)):
            raise ValueError("a tip load with a moment, or one that follows the tip, has no potential energy")
        return -float(position[-1] @ np.array(self.force))


@adds_wrench(TipLoadParameters)
@kernel
def tip_load_wrench(tip_load, rod, work):
    """The wrench in the tip frame, on the last node."""
    moment, force = tip_load.moment, tip_load.force
    if not tip_load.follows_tip:
        R, _ = tip_pose_of(work.pose)
        moment, force = rotate_back(R, moment), rotate_back(R, force)
    at = (rod.packs - 1) * 6 * LANES + LANES - 1
    for i in range(3):
        work.wrench[at + i * LANES] += moment[i]
        work.wrench[at + (3 + i) * LANES] += force[i]
