"""Immersion in a still or uniformly streaming fluid: drag, added mass and buoyancy of every slice of the rod.

Per length, with the slice's velocity v = (v_x, v_n) relative to the fluid in its own frame (x along the rod), the local radius r and the
fluid's density rho (J. R. Morison et al., Petroleum Transactions 189, 1950; F. Renda et al., IEEE Transactions on Robotics 30, 2014):

- drag, -1/2 rho (C_n 2 r |v_n| v_n + C_t 2 pi r |v_x| v_x), in the implicit step.
- added mass, C_a rho pi r^2 along both normals: kinetic energy 1/2 m_a |v_n|^2 per length, with all forces of Lagrange's equations. The
  free end is that of a streamlined tip (f = 1 of M. P. Paidoussis, Journal of Fluid Mechanics 26, 1966).
- buoyancy, -rho pi r^2 g, with the g of `[effects.gravity]`: without gravity there is none.

Left out: a payload's volume and drag, pressure drag on the tip's face, viscous moments about the axis, and compression by the hydrostatic
pressure (internal forces are effective tensions). The whole rod is under the surface, however it moves.
"""

from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, register_effect
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, sqrt, store
from soft_tendon_env.mechanics.algebra.lie import minus, plus, rotate_back, times, twist_sum
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.effects import adds_wrench
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import NotNegative, Positive, Triple

STILL = 1e-60  # [m^2/s^2], added to a squared speed that is divided by


@register_effect("fluid")
class Fluid(Effect):
    """`[effects.fluid]`: drag coefficients are those of a cylinder across a stream at Reynolds numbers of 1e3 to 1e5, and of friction."""

    strengths: ClassVar[tuple[str, ...]] = ("density", "current")
    is_uniform: ClassVar[bool] = True

    density: Positive = Field(description="density of the fluid [kg/m^3], 1000 for water")
    current: Triple = Field((0.0, 0.0, 0.0), description="its velocity (x, y, z) [m/s], world frame, everywhere and always the same")
    normal_drag: NotNegative = Field(1.1, description="drag coefficient C_n across the rod [-], 1 to 1.2")
    tangential_drag: NotNegative = Field(0.01, description="drag coefficient C_t along the rod [-], 0.003 to 0.02")
    added_mass: NotNegative = Field(1.0, description="coefficient C_a of the added mass [-], 1 in potential flow")

    def parameters(self, rod: Discretisation) -> "FluidParameters":
        pressure = 0.5 * self.density * rod.over_nodes(lambda arc_length: 2.0 * rod.radius(arc_length)[:, None])
        displaced = self.displaced_mass(rod)
        slices = displaced, self.added_mass * displaced, self.normal_drag * pressure, np.pi * self.tangential_drag * pressure
        gravity = rod.effects.gravity.acceleration if rod.effects.gravity else (0.0, 0.0, 0.0)
        return FluidParameters(*map(node_field, slices), self.current, gravity)

    def displaced_mass(self, rod: Discretisation) -> Array:
        """Mass (nodes, 1) [kg] of the fluid in whose place the slices are."""
        return self.density * rod.over_nodes(lambda arc_length: np.pi * rod.radius(arc_length)[:, None] ** 2)

    def added_inertia(self, rod: Discretisation) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0]) * self.added_mass * self.displaced_mass(rod)

    def potential_energy(self, arm: Configured) -> float:
        if any(self.current):
            raise ValueError("a fluid that streams has no potential energy")
        return float(self.displaced_mass(arm.rod)[:, 0] @ (arm.pose[:, :3, 3] @ np.array(self.parameters(arm.rod).gravity)))


class FluidParameters(Struct):
    """Coefficients of the fluid's forces on the slice of every node."""

    displaced: Array  # nodes [kg], mass of the displaced fluid
    added: Array  # nodes [kg], added mass along the normals
    normal: Array  # nodes [kg/m], drag per squared speed
    tangential: Array  # nodes [kg/m]
    current: Triple  # [m/s], world frame
    gravity: Triple  # [m/s^2], world frame


@adds_wrench(FluidParameters)
@kernel
def fluid_wrench(fluid, nodes):
    """Drag, buoyancy and what the current changes of the inertia on every node, with the drag's derivative -df/dv in the damping."""
    for pack in range(nodes.packs):
        at, moment_at, damping_at = pack * LANES, pack * 6 * LANES, pack * 21 * LANES
        R, _ = load_pose(nodes.pose, pack * 12 * LANES)
        (w, v), stream = load6(nodes.twist, moment_at), rotate_back(R, fluid.current)
        x, y, z = minus(v, stream)
        along, across = sqrt(x * x), sqrt(y * y + z * z)
        tangential, normal = load(fluid.tangential, at) * along, load(fluid.normal, at)
        moment, force = stream_wrench(load(fluid.added, at), w, v, stream)
        buoyancy = times(load(fluid.displaced, at), rotate_back(R, fluid.gravity))
        force = minus(force, plus((tangential * x, normal * across * y, normal * across * z), buoyancy))
        store6(nodes.wrench, moment_at, twist_sum(load6(nodes.wrench, moment_at), (moment, force)))
        slope = normal / sqrt(y * y + z * z + STILL)
        add(nodes.damping, damping_at + 9 * LANES, 2.0 * tangential)  # the entries xx, yy, zy, zz of forces by velocities
        add(nodes.damping, damping_at + 14 * LANES, normal * across + slope * y * y)
        add(nodes.damping, damping_at + 19 * LANES, slope * z * y)
        add(nodes.damping, damping_at + 20 * LANES, normal * across + slope * z * z)


@kernel(inline=True)
def stream_wrench(added, w, v, stream):
    """Wrench of the added mass on a slice that moves with (w, v), less that in fluid at rest: with A = added diag(0, 1, 1) and
    s = v - stream, from the kinetic energies 1/2 s A s and 1/2 v A v, (v x A v - s x A s, w x A stream - A (w x stream))."""
    s = minus(v, stream)
    moment = (0.0 * added, added * (s[0] * s[2] - v[0] * v[2]), added * (v[0] * v[1] - s[0] * s[1]))
    force = (added * (w[1] * stream[2] - w[2] * stream[1]), -added * (w[2] * stream[0]), added * (w[1] * stream[0]))
    return moment, force


@kernel(inline=True)
def add(field, at, value):
    """field[at ..] += value."""
    store(field, at, load(field, at) + value)
