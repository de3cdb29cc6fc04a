"""Uniform gravity: the force rho A dX g on every slice of the rod, and m g on a tip mass."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.effects.base import DeadLoads, Effect, random_vector, register_effect, size
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, store3
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.mechanics.terms.loads import adds_wrench
from soft_tendon_env.tools.compilation import kernel

Array = NDArray[np.float64]


@register_effect("gravity")
class Gravity(Effect):
    """`[effects.gravity]`. `acceleration` (x, y, z) [m/s^2] in the world frame, in which the straight rod lies along x."""

    acceleration: tuple[float, float, float]

    def parameters(self) -> "GravityParameters":
        return GravityParameters(*self.acceleration)

    def dead_loads(self) -> DeadLoads:
        return DeadLoads(acceleration=self.acceleration)

    def varied(self, random: np.random.Generator) -> "Gravity":
        return Gravity(acceleration=random_vector(random, self.acceleration))

    def covers(self, other: "Gravity") -> bool:
        return size(self.acceleration) >= size(other.acceleration)


class GravityParameters(NamedTuple):
    """The acceleration [m/s^2] in the world frame."""

    x: float
    y: float
    z: float

    def potential_energy(self, mass: Array, position: Array) -> float:
        return -float(mass @ (position @ np.array([self.x, self.y, self.z])))


@adds_wrench(GravityParameters)
@kernel
def gravity_wrench(gravity, rod, work):
    """The force m R^T g on every node."""
    for pack in range(rod.packs):
        R, _ = load_pose(work.pose, pack * 12 * LANES)
        force_at = (pack * 6 + 3) * LANES
        weight = times(load(rod.inertia, force_at), rotate_back(R, (gravity.x, gravity.y, gravity.z)))
        store3(work.wrench, force_at, plus(load3(work.wrench, force_at), weight))
