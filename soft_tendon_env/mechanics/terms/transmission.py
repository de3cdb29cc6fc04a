"""From commands to tensions, see effects.Transmission: elastic tendons, and friction along them.

An elastic tendon pulls with k (u - shortening), between nothing and the strength of its actuator.
Friction leaves T exp(-mu z phi) of its tension at an angle phi, by which the path has turned on the
way from the actuator (the capstan equation), with z = v / sqrt(v^2 + v_s^2) of the rate v at which
the whole tendon is pulled in: a regularised Coulomb friction without internal states. See
motion.implicit_euler for how both enter a step.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread
from soft_tendon_env.mechanics.algebra.lie import (
    cross,
    dot,
    minus,
    plus,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.kinematics import twist_at
from soft_tendon_env.mechanics.terms.tendons import (
    actuation_column,
    actuation_wrench,
    tendon_forces,
    tendon_lengths,
)

BEFORE = (
    0.5 - math.sqrt(3.0) / 6.0
)  # of an interval, what lies before its first Gauss point and after its second
CUT_ACROSS, CUT_INSIDE = (
    (part**2 / (3.0 * (1.0 - part))) for part in (2.0 * BEFORE, 1.0 - 2.0 * BEFORE)
)
"""Shortening of the chord of a part of a curve against the part, as a share of that of the chord of
both parts: of third order."""


@kernel(refcount=True)
def actuator_tensions(arm, u, work):
    """Tensions (n_a) at the actuators under u, where it is a command, in the strain of work.xi; u
    itself where nothing is between."""
    path = arm.effects.transmission
    if work.u_is_command[0] == 0.0 or not (path.elastic or path.friction > 0.0):
        return u
    transmit(arm, u, work)
    return work.tension


@phase
def transmit(arm, u, work):
    """Tensions under the command u into work.tension, and of elastic tendons the shortening into
    work.shortening."""
    path = arm.effects.transmission
    copy(u, work.tension)
    if path.elastic:
        tendon_lengths(arm.rod, arm.tendons, work, work.shortening)
        for i in range(u.size):
            work.shortening[i] = path.length[i] - work.shortening[i]
            work.tension[i] = min(
                max(path.stiffness[i] * (u[i] - work.shortening[i]), 0.0), path.strength[i]
            )


@kernel
def find_columns(arm, work):
    """Columns of the forces of elastic tendons and of those that rub, into work.columns,
    work.rubbed and work.rubbing."""
    path = arm.effects.transmission
    if work.u_is_command[0] == 0.0 or not (path.elastic or path.friction > 0.0):
        return
    for i in range(arm.tendons.size):
        actuation_column(arm, i, work.whole, work, work.columns[i])
        copy(work.columns[i], work.rubbed[i])
        if path.friction > 0.0:
            if path.elastic:
                actuation_column(arm, i, work.share, work, work.rubbed[i])
            actuation_column(arm, i, work.slip, work, work.rubbing[i])
            for a in range(work.rubbing.shape[1]):
                work.rubbing[i, a] *= work.tension[i]


@kernel
def add_tendon_matrices(arm, work, damping, stiffness):
    """Adds what elastic tendons and those that rub have of D and G, sum c B_i B_i^T and k B_i
    B_i^T; after find_columns()."""
    path = arm.effects.transmission
    for i in range(arm.tendons.size if path.elastic or path.friction > 0.0 else 0):
        slope, steepness = tension_slope(path, i, work) if path.elastic else 0.0, 0.0
        if path.friction > 0.0:
            speed = math.hypot(work.pull_rate[i], path.stiction_speed)
            steepness = work.grip[i] * (path.stiction_speed / speed) ** 2 / speed
        for a in range(stiffness.shape[0]):
            for b in range(stiffness.shape[0]):
                stiffness[a, b] += slope * work.rubbed[i, a] * work.columns[i, b]
                damping[a, b] += steepness * work.columns[i, a] * work.columns[i, b]


@kernel
def tension_slope(path, i, work):
    """Derivative of a tendon's tension by its command, where transmit() has just been."""
    if not path.elastic:
        return 1.0
    return path.stiffness[i] if 0.0 < work.tension[i] < path.strength[i] else 0.0


@kernel
def find_shares(arm, work):
    """Shares of the tensions that friction leaves along the tendons, in work.share, and its
    derivatives by their direction of sliding, in work.slip and work.grip; True if there is
    friction."""
    friction, tendons = arm.effects.transmission, arm.tendons
    if friction.friction == 0.0 or work.u_is_command[0] == 0.0:
        return False
    work.share[:] = 1.0
    tendon_forces(arm.rod, tendons, work.share, work.tangent, work.xi_dot, work.pull_rate)
    for i in range(tendons.size):
        z = work.pull_rate[i] / math.hypot(work.pull_rate[i], friction.stiction_speed)
        turned = friction.friction * find_share(arm, i, friction.friction, z, work)
        a = (
            turned * z
        )  # the mean tension falls with it by the mean of u exp(-a u) over u from 0 to 1
        slope = (
            (1.0 - (1.0 + a) * math.exp(-a)) / (a * a)
            if abs(a) > 0.01
            else 0.5 - a / 3.0 + a * a / 8.0
        )
        work.grip[i] = turned * slope * work.tension[i]
    return True


@kernel
def tangent_at(arm, i, pack, z, m, work):
    """Unit tangent of a tendon at the z-th point of interval m of a pack, and its rate of turning
    with the section by arc length."""
    block = 2 * pack + z
    at = (i * 2 * arm.rod.packs + block) * 4 * LANES + m
    t = work.tangent[at], work.tangent[at + LANES], work.tangent[at + 2 * LANES]
    return t, cross(twist_at(work.xi, block, m)[0], t)


@kernel
def tangent_change(one, other, distance):
    """How the tangent of a path turns between two points at this distance: within the section, and
    with it."""
    return plus(minus(other[0], one[0]), times(0.5 * distance, plus(one[1], other[1])))


@kernel
def find_share(arm, i, friction, z, work):
    """Shares exp(-mu z phi) of the tension of a tendon that are left at the points, into
    work.share; the whole angle phi."""
    rod, geometry, blocks = arm.rod, arm.tendons.geometry, 2 * arm.rod.packs
    angle, before, width_before = 0.0, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0
    for pack in range(arm.tendons.pack_begin[i], arm.tendons.pack_end[i]):
        for m in range(LANES):
            width, first = 2.0 * rod.weight[2 * pack * LANES + m], i * blocks + 2 * pack
            if width == 0.0 or geometry[(first * 5 + 4) * LANES + m] == 0.0:
                continue
            one, other = tangent_at(arm, i, pack, 0, m, work), tangent_at(arm, i, pack, 1, m, work)
            turned_inside = tangent_change(one, other, (1.0 - 2.0 * BEFORE) * width)
            inside = math.sqrt(dot(turned_inside, turned_inside))
            if width_before > 0.0:
                turned = tangent_change(before, one, BEFORE * (width + width_before))
                across, both = math.sqrt(dot(turned, turned)), plus(turned, turned_inside)
                cut = inside + across - math.sqrt(dot(both, both))
                angle, inside = angle + across + CUT_ACROSS * cut, inside + CUT_INSIDE * cut
            else:
                angle += BEFORE / (1.0 - 2.0 * BEFORE) * inside
            for at, phi in ((first * LANES + m, angle), ((first + 1) * LANES + m, angle + inside)):
                work.share[at] = math.exp(-z * (friction * phi))
                work.slip[at] = friction * phi * work.share[at]
            angle += inside
            before, width_before = other, width
    return angle


@kernel
def add_lost_stress(arm, work):
    """Adds to work.stress the wrench that friction takes from the tendons, - sum tau (1 - share)
    s."""
    tendons, blocks = arm.tendons, 2 * arm.rod.packs
    for block in range(blocks):
        at, total = block * 6 * LANES, load6(work.stress, block * 6 * LANES)
        for i in range(tendons.size):
            if tendons.pack_begin[i] <= block // 2 < tendons.pack_end[i]:
                lost = work.tension[i] * (
                    spread(1.0) - load(work.share, (i * blocks + block) * LANES)
                )
                total = twist_sum(
                    total,
                    scale_twist(lost, actuation_wrench(tendons, blocks, block, i, work.tangent)),
                )
        store6(work.stress, at, total)
