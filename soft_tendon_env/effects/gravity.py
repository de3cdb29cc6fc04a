"""Uniform gravity: the force rho A dX g on every slice of the rod, and m g on a tip mass."""

from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Configured, DeadLoads, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, store3
from soft_tendon_env.mechanics.effects import adds_wrench
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.tools.types import Triple


@register_effect("gravity")
class Gravity(Effect):
    """`[effects.gravity]`, in the world frame, in which the straight rod lies along x."""

    strengths: ClassVar[tuple[str, ...]] = ("acceleration",)

    acceleration: Triple = Field(description="acceleration (x, y, z) [m/s^2]")

    def parameters(self, rod: Discretisation) -> "GravityParameters":
        return GravityParameters(self.acceleration)

    def potential_energy(self, arm: Configured) -> float:
        return -float(arm.mass @ (arm.pose[:, :3, 3] @ np.array(self.acceleration)))

    def dead_loads(self) -> DeadLoads:
        return DeadLoads(acceleration=self.acceleration)


class GravityParameters(Struct):
    """The acceleration [m/s^2] in the world frame."""

    acceleration: Triple


@adds_wrench(GravityParameters)
@kernel
def gravity_wrench(gravity, nodes):
    """The force m R^T g on every node."""
    for pack in range(nodes.packs):
        at, down = (pack * 6 + 3) * LANES, rotate_back(load_pose(nodes.pose, pack * 12 * LANES)[0], gravity.acceleration)
        store3(nodes.wrench, at, plus(load3(nodes.wrench, at), times(load(nodes.mass, pack * LANES), down)))
