"""Immersion in a still or uniformly streaming fluid: drag, added mass and buoyancy.

They act on every slice of the rod.

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
from soft_tendon_env.effects.base import Array, Configured, Discretisation, Effect
from soft_tendon_env.effects.loads import weights
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, sqrt, store
from soft_tendon_env.mechanics.algebra.lie import minus, plus, rotate_back, times
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.algebra.symmetric6 import load6
from soft_tendon_env.mechanics.effects import adds_wrench
from soft_tendon_env.mechanics.terms.kinematics import load_pose
from soft_tendon_env.mechanics.terms.transposed_kinematics import add_to_block
from soft_tendon_env.mechanics.types import node_field
from soft_tendon_env.tools.registry import register
from soft_tendon_env.tools.types import NotNegative, Positive, Triple

STILL = 1e-60  # added to the square of what is divided by


@register("effect", "fluid")
class Fluid(Effect):
    """`[effects.fluid]`: drag, added mass and buoyancy of the whole arm in a fluid.

    Drag coefficients are those of a cylinder across a stream at Reynolds numbers of 1e3 to 1e5, and
    of friction.
    """

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
        height, width, perimeter, faces, volume, added_y, added_z = _outside(rod)
        half = 0.5 * self.density
        added = self.added_mass * self.density
        # a and c of the drag across, 1/3 (a v_y^2 + c v_z^2)^(3/2)
        across = half * self.normal_drag
        normal_y = (across * height) ** (2.0 / 3.0)
        normal_z = (across * width) ** (2.0 / 3.0)
        rubbed = self.tangential_drag * perimeter
        met = self.disc_drag * faces
        tangential = half * (rubbed + met)
        gravity = (0.0, 0.0, 0.0)
        if rod.effects.gravity is not None:
            gravity = rod.effects.gravity.acceleration
        displaced = self.density * volume
        return FluidParameters(
            displaced=node_field(displaced[:, None]),
            added_y=node_field((added * added_y)[:, None]),
            added_z=node_field((added * added_z)[:, None]),
            normal_y=node_field(normal_y[:, None]),
            normal_z=node_field(normal_z[:, None]),
            tangential=node_field(tangential[:, None]),
            current=self.current,
            gravity=gravity,
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
        displaced = self.displaced_mass(arm.rod)[:, 0]
        gravity = np.array(self.parameters(arm.rod).gravity)
        position = arm.pose[:, :3, 3]
        # buoyancy pushes against gravity
        along_gravity = position @ gravity
        return float(displaced @ along_gravity)


def _outside(rod: Discretisation) -> Array:
    """Outside of the slices and their discs, (7, nodes): areas and volumes.

    They are areas [m^2] that motions along y and z meet, of the surface and of the discs' faces,
    the volume [m^3], and the volumes [m^3] of the added mass along y and z where C_a is 1.
    """

    def per_length(arc_length: Array) -> Array:
        width, height, perimeter, area = rod.hull(arc_length)
        no_faces = 0.0 * area
        # of a flat plate that moves broadside on: pi / 4 of its squared width
        added_y = 0.25 * np.pi * height**2
        added_z = 0.25 * np.pi * width**2
        columns = [height, width, perimeter, no_faces, area, added_y, added_z]
        return np.stack(columns, axis=1)

    slices = rod.over_nodes(per_length).T
    if rod.discs.size:
        # what a disc has beyond the outline of the rod
        place, _, radius, thickness = rod.discs.T
        height, width, _, _, area, added_y, added_z = per_length(place).T
        diameter = 2.0 * radius
        full = np.pi * radius**2
        met_y = (diameter - height) * thickness
        met_z = (diameter - width) * thickness
        no_surface = 0.0 * full
        areas = np.stack([met_y, met_z, no_surface, full - area])
        of_rod = np.stack([area, added_y, added_z])
        volumes = thickness * (full - of_rod)
        slices[:4] += areas @ weights(rod, place, 2)  # of two nodes none is negative
        slices[4:] += volumes @ weights(rod, place)
    return slices


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
    """Adds drag, buoyancy and the current's share of the inertia to every node.

    The drag's derivative -df/dv goes into the damping.
    """
    for pack in range(nodes.packs):
        at = pack * LANES
        R, _ = load_pose(nodes.pose, pack)
        w, v = load6(nodes.twist, pack)
        stream = rotate_back(R, fluid.current)
        x, y, z = minus(v, stream)
        # drag along the rod, and across it the gradient of 1/3 (a v_y^2 + c v_z^2)^(3/2)
        tangential = load(fluid.tangential, at) * sqrt(x * x)
        normal_y = load(fluid.normal_y, at)
        normal_z = load(fluid.normal_z, at)
        drag_y = normal_y * y
        drag_z = normal_z * z
        squared = drag_y * y + drag_z * z
        across = sqrt(squared)
        drag = (tangential * x, across * drag_y, across * drag_z)
        # added mass and buoyancy
        added_y = load(fluid.added_y, at)
        added_z = load(fluid.added_z, at)
        moment, force = stream_wrench((added_y, added_z), w, v, stream)
        down = rotate_back(R, fluid.gravity)
        buoyancy = times(load(fluid.displaced, at), down)
        force = minus(force, plus(drag, buoyancy))
        add_to_block(nodes.wrench, pack, (moment, force))
        # -df/dv: the entries xx, yy, zy, zz of forces by velocities
        slope = 1.0 / sqrt(squared + STILL)
        by_xx = 2.0 * tangential
        by_yy = normal_y * across + slope * drag_y * drag_y
        by_zy = slope * drag_z * drag_y
        by_zz = normal_z * across + slope * drag_z * drag_z
        damping_at = pack * 21 * LANES
        add(nodes.damping, damping_at + 9 * LANES, by_xx)
        add(nodes.damping, damping_at + 14 * LANES, by_yy)
        add(nodes.damping, damping_at + 19 * LANES, by_zy)
        add(nodes.damping, damping_at + 20 * LANES, by_zz)


@kernel(inline=True)
def stream_wrench(added, w, v, stream):
    """Wrench of the added mass on a slice that moves with (w, v), less that in fluid at rest.

    With A = diag(0, *added) and s = v - stream it is, from the kinetic energies 1/2 s A s and 1/2 v
    A v, (v x A v - s x A s, w x A stream - A (w x stream)).
    """
    a, b = added
    more = b - a
    v_x, v_y, v_z = v
    s_x, s_y, s_z = minus(v, stream)
    # v x A v - s x A s
    about_x = more * (v_y * v_z - s_y * s_z)
    about_y = b * (s_x * s_z - v_x * v_z)
    about_z = a * (v_x * v_y - s_x * s_y)
    # w x A stream - A (w x stream)
    w_x, w_y, w_z = w
    u_x, u_y, u_z = stream
    along_x = b * (w_y * u_z) - a * (w_z * u_y)
    along_y = -(more * (w_x * u_z)) - a * (w_z * u_x)
    along_z = b * (w_y * u_x) - more * (w_x * u_y)
    return (about_x, about_y, about_z), (along_x, along_y, along_z)


@kernel(inline=True)
def add(field, at, value):
    """field[at ..] += value."""
    store(field, at, load(field, at) + value)
