"""Immersion in a still or uniformly streaming fluid: drag, added mass and buoyancy of every slice
of the rod.

Per length, with the slice's velocity v = (v_x, v_y, v_z) relative to the fluid in its own frame (x
along the rod), the widths b, h of its outline along y and z, its perimeter p and area A (of a
circle 2 r, 2 r, 2 pi r and pi r^2) and the fluid's density rho (J. R. Morison et al., Petroleum
Transactions 189, 1950; F. Renda et al., IEEE Transactions on Robotics 30, 2014):

- drag, -1/2 rho C_t p |v_x| v_x, and -1/2 rho C_n 2 r |v_n| v_n across a circle, in the implicit
  step. Across others it is the derivative of 1/3 (a v_y^2 + c v_z^2)^(3/2), with a^(3/2) = 1/2 rho
  C_n h and c^(3/2) = 1/2 rho C_n b: that of their widths along both axes.
- added mass, C_a rho pi (h/2)^2 along y and C_a rho pi (b/2)^2 along z, in potential flow exact for
  ellipses (J. N. Newman, Marine Hydrodynamics, 1977, table 4.3): kinetic energy 1/2 m_a v^2 per
  length, with all forces of Lagrange's equations. The free end is that of a streamlined tip (f = 1
  of M. P. Paidoussis, Journal of Fluid Mechanics 26, 1966).
- buoyancy, -rho A g, with the g of `[effects.gravity]`: without gravity there is none.

A spacer disc has its volume, drag across of its thickness, and drag along the rod of its face, all
beyond the rod's outline. Left out: a payload's volume and drag, added mass of discs along the rod,
pressure drag on the tip's face, viscous moments about the axis, and compression by the hydrostatic
pressure (internal forces are effective tensions). The whole rod is under the surface, however it
moves.
"""

from typing import ClassVar

import numpy as np
from pydantic import Field

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect, register_effect
from soft_tendon_env.effects.loads import weights
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, sqrt, store
from soft_tendon_env.mechanics.algebra.lie import minus, plus, rotate_back, times, twist_sum
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.effects import adds_wrench
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.types import NotNegative, Positive, Triple

STILL = 1e-60  # added to the square of what is divided by


@register_effect("fluid")
class Fluid(Effect):
    """`[effects.fluid]`: drag coefficients are those of a cylinder across a stream at Reynolds
    numbers of 1e3 to 1e5, and of friction."""

    strengths: ClassVar[tuple[str, ...]] = ("density", "current")
    is_uniform: ClassVar[bool] = True

    density: Positive = Field(description="density of the fluid [kg/m^3], 1000 for water")
    current: Triple = Field(
        (0.0, 0.0, 0.0),
        description="its velocity (x, y, z) [m/s], world frame, everywhere and always the same",
    )
    normal_drag: NotNegative = Field(
        1.1, description="drag coefficient C_n across the rod [-], 1 to 1.2"
    )
    tangential_drag: NotNegative = Field(
        0.01, description="drag coefficient C_t along the rod [-], 0.003 to 0.02"
    )
    added_mass: NotNegative = Field(
        1.0,
        description="coefficient C_a of the added mass [-], in potential flow 1, of squares 1.5",
    )
    disc_drag: NotNegative = Field(
        1.1,
        description="drag coefficient of a spacer disc's face along the rod [-], 1.1 of one alone",
    )

    def parameters(self, rod: Discretisation) -> "FluidParameters":
        half, (height, width, perimeter, faces, volume, *added) = 0.5 * self.density, _outside(rod)
        normal = (half * self.normal_drag * np.stack([height, width])) ** (2.0 / 3.0)
        tangential = half * (self.tangential_drag * perimeter + self.disc_drag * faces)
        gravity = rod.effects.gravity.acceleration if rod.effects.gravity else (0.0, 0.0, 0.0)
        slices = (
            self.density * volume,
            *(self.added_mass * self.density * part for part in added),
            *normal,
            tangential,
        )
        return FluidParameters(
            *(node_field(values[:, None]) for values in slices), self.current, gravity
        )

    def displaced_mass(self, rod: Discretisation) -> Array:
        """Mass (nodes, 1) [kg] of the fluid in whose place the slices are."""
        return self.density * _outside(rod)[4][:, None]

    def added_inertia(self, rod: Discretisation) -> Array:
        added = self.added_mass * self.density * _outside(rod)[5:]
        return np.concatenate([np.zeros((4, rod.node.size)), added]).T

    def potential_energy(self, arm: Configured) -> float:
        if any(self.current):
            raise ValueError("a fluid that streams has no potential energy")
        return float(
            self.displaced_mass(arm.rod)[:, 0]
            @ (arm.pose[:, :3, 3] @ np.array(self.parameters(arm.rod).gravity))
        )


def _outside(rod: Discretisation) -> Array:
    """Outside of the slices and their discs, (7, nodes): areas [m^2] that motions along y and z
    meet, of the surface and of the discs' faces, the volume [m^3], and the volumes [m^3] of the
    added mass along y and z where C_a is 1."""

    def per_length(arc_length: Array) -> Array:
        width, height, perimeter, area = rod.hull(arc_length)
        return np.stack(
            [
                height,
                width,
                perimeter,
                0.0 * area,
                area,
                0.25 * np.pi * height**2,
                0.25 * np.pi * width**2,
            ],
            axis=1,
        )

    found = rod.over_nodes(per_length).T
    if rod.discs.size:
        place, _, radius, thickness = rod.discs.T
        height, width, _, _, area, added_y, added_z = per_length(place).T
        full = np.pi * radius**2
        met = np.stack(
            [
                (2.0 * radius - height) * thickness,
                (2.0 * radius - width) * thickness,
                0.0 * full,
                full - area,
            ]
        )
        found[:4] += met @ weights(rod, place, 2)  # of two nodes none is negative
        found[4:] += thickness * (full - np.stack([area, added_y, added_z])) @ weights(rod, place)
    return found


class FluidParameters(Struct):
    """Coefficients of the fluid's forces on the slice of every node."""

    displaced: Array  # nodes [kg], mass of the displaced fluid
    added_y: Array  # nodes [kg], added mass along y
    added_z: Array
    normal_y: Array  # nodes [(kg/m)^(2/3)], the power 2/3 of the drag per squared speed along y
    normal_z: Array
    tangential: Array  # nodes [kg/m]
    current: Triple  # [m/s], world frame
    gravity: Triple  # [m/s^2], world frame


@adds_wrench(FluidParameters)
@kernel
def fluid_wrench(fluid, nodes):
    """Drag, buoyancy and what the current changes of the inertia on every node, with the drag's
    derivative -df/dv in the damping."""
    for pack in range(nodes.packs):
        at, damping_at = pack * LANES, pack * 21 * LANES
        R, _ = load_pose(nodes.pose, pack)
        (w, v), stream = load6(nodes.twist, pack), rotate_back(R, fluid.current)
        x, y, z = minus(v, stream)
        normal_y, normal_z, tangential = (
            load(fluid.normal_y, at),
            load(fluid.normal_z, at),
            load(fluid.tangential, at) * sqrt(x * x),
        )
        drag_y, drag_z = normal_y * y, normal_z * z
        squared = drag_y * y + drag_z * z
        across, slope = sqrt(squared), 1.0 / sqrt(squared + STILL)
        moment, force = stream_wrench(
            (load(fluid.added_y, at), load(fluid.added_z, at)), w, v, stream
        )
        buoyancy = times(load(fluid.displaced, at), rotate_back(R, fluid.gravity))
        force = minus(force, plus((tangential * x, across * drag_y, across * drag_z), buoyancy))
        store6(nodes.wrench, pack, twist_sum(load6(nodes.wrench, pack), (moment, force)))
        add(
            nodes.damping, damping_at + 9 * LANES, 2.0 * tangential
        )  # the entries xx, yy, zy, zz of forces by velocities
        add(nodes.damping, damping_at + 14 * LANES, normal_y * across + slope * drag_y * drag_y)
        add(nodes.damping, damping_at + 19 * LANES, slope * drag_z * drag_y)
        add(nodes.damping, damping_at + 20 * LANES, normal_z * across + slope * drag_z * drag_z)


@kernel(inline=True)
def stream_wrench(added, w, v, stream):
    """Wrench of the added mass on a slice that moves with (w, v), less that in fluid at rest: with
    A = diag(0, *added) and s = v - stream, from the kinetic energies 1/2 s A s and 1/2 v A v, (v x
    A v - s x A s, w x A stream - A (w x stream))."""
    (a, b), s = added, minus(v, stream)
    more = b - a
    moment = (
        more * (v[1] * v[2] - s[1] * s[2]),
        b * (s[0] * s[2] - v[0] * v[2]),
        a * (v[0] * v[1] - s[0] * s[1]),
    )
    along = b * (w[1] * stream[2]) - a * (w[2] * stream[1])
    return moment, (
        along,
        -(more * (w[0] * stream[2])) - a * (w[2] * stream[0]),
        b * (w[1] * stream[0]) - more * (w[0] * stream[1]),
    )


@kernel(inline=True)
def add(field, at, value):
    """field[at ..] += value."""
    store(field, at, load(field, at) + value)
