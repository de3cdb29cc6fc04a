"""From commands to tensions, see effects.Transmission: elastic tendons, and friction along them.

An elastic tendon pulls with k (u - shortening), between nothing and the strength of its actuator.
Friction leaves T exp(-mu z phi) of its tension at an angle phi, by which the path has turned on the
way from the actuator (the capstan equation), with z = v / sqrt(v^2 + v_s^2) of the rate v at which
the whole tendon is pulled in: a regularised Coulomb friction without internal states. See
motion.implicit_euler for how both enter a step.

Who gives tensions instead of commands calls none of this.
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

# of an interval, what lies before its first Gauss point and after its second
BEFORE = 0.5 - math.sqrt(3.0) / 6.0
WITHIN = 1.0 - 2.0 * BEFORE  # of an interval, what lies between its Gauss points


def _cut(part):
    """Shortening of the chord of a part of a curve against the part, as a share of that of the
    chord of both parts, which add up to 1: of third order."""
    return part**2 / (3.0 * (1.0 - part))


CUT_ACROSS = _cut(2.0 * BEFORE)  # of the part across the end of an interval
CUT_INSIDE = _cut(WITHIN)  # of the part between the Gauss points of one
SMALL_ANGLE = 0.01  # mu phi z, below which a mean of exponentials is its series


@kernel(inline=True)
def tendons_transmit(arm):
    """Whether tensions are other than commands: tendons are elastic, or rub."""
    path = arm.effects.transmission
    return path.elastic or path.friction > 0.0


@kernel(inline=True)
def tendons_rub(arm):
    """Whether there is friction along the tendons."""
    return arm.effects.transmission.friction > 0.0


@kernel(refcount=True)
def actuator_tensions(arm, command, xi, tendons):
    """Tensions (n_a) at the actuators under a command (n_a) at strains xi (points x 6): the command
    itself where nothing is between."""
    if not tendons_transmit(arm):
        return command
    transmit(arm, command, xi, tendons)
    return tendons.tension


@phase
def transmit(arm, command, xi, tendons):
    """Tensions under a command into tendons.tension, and of elastic tendons the shortening into
    tendons.shortening."""
    path = arm.effects.transmission
    copy(command, tendons.tension)
    if path.elastic:
        shortening = tendons.shortening
        tendon_lengths(arm.rod, arm.tendons, xi, shortening)
        for i in range(command.size):
            shortening[i] = path.length[i] - shortening[i]
            taut = path.stiffness[i] * (command[i] - shortening[i])
            tendons.tension[i] = min(max(taut, 0.0), path.strength[i])


@phase
def find_columns(arm, strain, friction, ones, stress, tendons):
    """Columns of the forces of elastic tendons and of those that rub, into tendons.columns,
    tendons.rubbed and tendons.rubbing; overwrites `stress` (points x 6)."""
    path = arm.effects.transmission
    for i in range(arm.tendons.size):
        column = tendons.columns[i]
        actuation_column(arm, i, ones.tendon, strain, stress, column)
        copy(column, tendons.rubbed[i])
        if path.friction > 0.0:
            if path.elastic:
                actuation_column(arm, i, friction.share, strain, stress, tendons.rubbed[i])
            rubbing = tendons.rubbing[i]
            actuation_column(arm, i, friction.slip, strain, stress, rubbing)
            for a in range(rubbing.size):
                rubbing[a] *= tendons.tension[i]


@kernel
def add_tendon_matrices(arm, tendons, friction, damping, stiffness):
    """Adds what elastic tendons and those that rub have of D and G, sum c B_i B_i^T and k B_i
    B_i^T; after find_columns()."""
    path = arm.effects.transmission
    if not tendons_transmit(arm):
        return
    n = stiffness.shape[0]
    for i in range(arm.tendons.size):
        slope = 0.0
        if path.elastic:
            slope = tension_slope(path, i, tendons)
        # c: the derivative of friction by the rate at which the tendon is pulled in
        steepness = 0.0
        if path.friction > 0.0:
            speed = math.hypot(tendons.pull_rate[i], path.stiction_speed)
            steepness = friction.grip[i] * (path.stiction_speed / speed) ** 2 / speed
        column = tendons.columns[i]
        rubbed = tendons.rubbed[i]
        for a in range(n):
            for b in range(n):
                stiffness[a, b] += slope * rubbed[a] * column[b]
                damping[a, b] += steepness * column[a] * column[b]


@kernel
def tension_slope(path, i, tendons):
    """Derivative of a tendon's tension by its command, where transmit() has just been."""
    if not path.elastic:
        return 1.0
    if 0.0 < tendons.tension[i] < path.strength[i]:
        return path.stiffness[i]
    return 0.0


@kernel
def find_shares(arm, strain, tendons, friction):
    """Shares of the tensions that friction leaves along the tendons that are pulled in at
    tendons.pull_rate, which it writes, and their derivatives by the direction of sliding, into
    `friction`."""
    path = arm.effects.transmission
    friction.share[:] = 1.0
    # the rate at which a tendon is pulled in is B^T q_dot
    tendon_forces(
        arm.rod,
        arm.tendons,
        friction.share,
        strain.tangent,
        strain.xi_dot,
        tendons.pull_rate,
    )
    for i in range(arm.tendons.size):
        rate = tendons.pull_rate[i]
        z = rate / math.hypot(rate, path.stiction_speed)
        turned = path.friction * find_share(arm, i, path.friction, z, strain, friction)
        friction.grip[i] = turned * mean_slope(turned * z) * tendons.tension[i]


@kernel
def mean_slope(a):
    """Mean of u exp(-a u) over u from 0 to 1: how the mean tension of a tendon falls with a."""
    if abs(a) > SMALL_ANGLE:
        return (1.0 - (1.0 + a) * math.exp(-a)) / (a * a)
    return 0.5 - a / 3.0 + a * a / 8.0


@kernel
def tangent_at(arm, i, pack, z, m, strain):
    """Unit tangent of a tendon at the z-th point of interval m of a pack, and its rate of turning
    with the section by arc length."""
    block = 2 * pack + z
    at = (i * 2 * arm.rod.packs + block) * 4 * LANES + m
    tangent = strain.tangent
    t = (tangent[at], tangent[at + LANES], tangent[at + 2 * LANES])
    curvature, _ = twist_at(strain.xi, block, m)
    return t, cross(curvature, t)


@kernel
def tangent_change(first, second, distance):
    """How the tangent of a path turns between two points at this distance: within the section, and
    with it."""
    within = minus(second[0], first[0])
    with_section = times(0.5 * distance, plus(first[1], second[1]))
    return plus(within, with_section)


@kernel(inline=True)
def size_of(x):
    """Length of a vector."""
    return math.sqrt(dot(x, x))


@kernel
def find_share(arm, i, coefficient, z, strain, friction):
    """Shares exp(-mu z phi) of the tension of a tendon that are left at the points, into
    friction.share, and their derivatives; the whole angle phi."""
    rod = arm.rod
    geometry = arm.tendons.geometry
    blocks = 2 * rod.packs
    angle = 0.0
    before = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    width_before = 0.0
    for pack in range(arm.tendons.pack_begin[i], arm.tendons.pack_end[i]):
        row = i * blocks + 2 * pack
        for m in range(LANES):
            width = 2.0 * rod.weight[2 * pack * LANES + m]
            presence = geometry[(row * 5 + 4) * LANES + m]
            if width == 0.0 or presence == 0.0:
                continue
            first = tangent_at(arm, i, pack, 0, m, strain)
            second = tangent_at(arm, i, pack, 1, m, strain)
            turned_inside = tangent_change(first, second, WITHIN * width)
            inside = size_of(turned_inside)
            if width_before > 0.0:
                # chords cut corners: both angles grow by what the chord of both lacks
                turned = tangent_change(before, first, BEFORE * (width + width_before))
                across = size_of(turned)
                both = size_of(plus(turned, turned_inside))
                cut = inside + across - both
                angle = angle + across + CUT_ACROSS * cut
                inside = inside + CUT_INSIDE * cut
            else:  # where the tendon begins it turns on as between the points
                angle += BEFORE / WITHIN * inside
            write_share(friction, row * LANES + m, coefficient, z, angle)
            write_share(friction, (row + 1) * LANES + m, coefficient, z, angle + inside)
            angle += inside
            before = second
            width_before = width
    return angle


@kernel(inline=True)
def write_share(friction, at, coefficient, z, angle):
    """Share of the tension that is left at a point, and its derivative."""
    share = math.exp(-z * (coefficient * angle))
    friction.share[at] = share
    friction.slip[at] = coefficient * angle * share


@kernel
def add_lost_stress(arm, strain, tension, share, stress):
    """Adds to `stress` the wrench that friction takes from the tendons, - sum tau (1 - share) s."""
    tendons = arm.tendons
    blocks = 2 * arm.rod.packs
    for block in range(blocks):
        total = load6(stress, block)
        for i in range(tendons.size):
            if tendons.pack_begin[i] <= block // 2 < tendons.pack_end[i]:
                left = load(share, (i * blocks + block) * LANES)
                lost = tension[i] * (spread(1.0) - left)
                wrench = actuation_wrench(tendons, blocks, block, i, strain.tangent)
                total = twist_sum(total, scale_twist(lost, wrench))
        store6(stress, block, total)
