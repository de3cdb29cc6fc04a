"""Loads that the arm carries: gravity, a wrench at the tip, a payload."""

from typing import Literal

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, DeadLoads, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load
from soft_tendon_env.mechanics.algebra.lie import plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, store3
from soft_tendon_env.mechanics.effects import adds_wrench
from soft_tendon_env.mechanics.terms.kinematics import load_pose, tip_pose_of
from soft_tendon_env.tools.types import NotNegative, Triple


@register_effect("gravity")
class Gravity(Effect):
    """`[effects.gravity]`: weight of the rod and its payload, in the world frame, in which the straight rod lies along x."""

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


@register_effect("tip_load")
class TipLoad(Effect):
    """`[effects.tip_load]`: a wrench at the tip, and a payload fixed to it."""

    force: Triple = Field((0.0, 0.0, 0.0), description="force (x, y, z) at the tip [N]")
    moment: Triple = Field((0.0, 0.0, 0.0), description="moment (x, y, z) at the tip [N m]")
    frame: Literal["world", "tip"] = Field("world", description="frame of their components: a dead load, or one that follows the tip")
    mass: NotNegative = Field(0.0, description="mass of a payload with its centre at the tip [kg]")
    inertia: tuple[NotNegative, NotNegative, NotNegative] = Field((0.0, 0.0, 0.0), description="its moments about the tip's axes [kg m^2]")

    @property
    def acts(self) -> bool:
        return any(self.force) or any(self.moment)

    def parameters(self, rod: Discretisation) -> "TipLoadParameters":
        return TipLoadParameters(self.force, self.moment, self.frame == "tip")

    @property
    def payload(self) -> Array:
        return np.array([*self.inertia, self.mass, self.mass, self.mass])

    def potential_energy(self, arm: Configured) -> float:
        if any(self.moment) or (self.frame == "tip" and any(self.force)):
            raise ValueError("a tip load with a moment, or one that follows the tip, has no potential energy")
        return -float(arm.pose[-1, :3, 3] @ np.array(self.force))

    def dead_loads(self) -> DeadLoads | None:
        follows = self.frame == "tip" and (any(self.force) or any(self.moment))
        return None if follows else DeadLoads(force=self.force, moment=self.moment)


class TipLoadParameters(Struct):
    """The wrench and its frame; the payload is part of the rod's inertia."""

    force: Triple
    moment: Triple
    follows_tip: bool


@adds_wrench(TipLoadParameters)
@kernel
def tip_load_wrench(tip_load, nodes):
    """The wrench in the tip frame, on the last node."""
    moment, force = tip_load.moment, tip_load.force
    if not tip_load.follows_tip:
        R, _ = tip_pose_of(nodes.pose)
        moment, force = rotate_back(R, moment), rotate_back(R, force)
    at = (nodes.packs - 1) * 6 * LANES + LANES - 1
    for i in range(3):
        nodes.wrench[at + i * LANES] += moment[i]
        nodes.wrench[at + (3 + i) * LANES] += force[i]
