"""Capstan friction along tendons: turns of their paths, sliding, and what tension is left.

A tendon is fixed where it ends. What slides past a point of the rod, towards the actuator, is the
rate v = -d/dt of the length between there and the end. Where the path turns by an angle dphi the
tension falls by a factor exp(-mu z dphi), with the direction z = v / sqrt(v^2 + v_s^2) of v
there: a Coulomb friction that is regularised below the speed v_s, without internal states.

The tensions T_k at the points of a tendon pull with sum_k T_k a_k, where a_k q_dot is what the
length of the point's part of the rod loses in a second. Summed by parts that is, with the border
before each point, w_k = a_k + a_k+1 + ..., and T at the actuator,

    T w_0 + sum_k (T_k - T_k-1) w_k,

and v_k = w_k q_dot is what slides past that border: the power of friction, sum_k (T_k - T_k-1) v_k,
is never positive, to round-off.
"""

import math

from soft_tendon_env.compiler.compilation import kernel, phase
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, load, spread, store
from soft_tendon_env.mechanics.algebra.lie import (
    cross,
    dot,
    minus,
    plus,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import row_stride
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store6
from soft_tendon_env.mechanics.terms.kinematics import twist_at
from soft_tendon_env.mechanics.terms.tendons import (
    actuation_wrench,
    blocks_of,
    chord_rate,
    is_present,
    presence_of,
)

# of an interval, what lies before its first Gauss point and after its second
BEFORE = 0.5 - math.sqrt(3.0) / 6.0
WITHIN = 1.0 - 2.0 * BEFORE  # of an interval, what lies between its Gauss points
PER_PACK = 2 * LANES  # points of a pack


def _cut(part):
    """Shortening of the chord of a part of a curve against the part, as a share of that of the
    chord of both parts, which add up to 1: of third order."""
    return part**2 / (3.0 * (1.0 - part))


CUT_ACROSS = _cut(2.0 * BEFORE)  # of the part across the end of an interval
CUT_INSIDE = _cut(WITHIN)  # of the part between the Gauss points of one


@kernel(inline=True)
def tendons_rub(arm):
    """Whether there is friction along the tendons."""
    return arm.effects.transmission.friction > 0.0


@kernel(inline=True)
def smooth_speed(rate, slow):
    """Regularised size of a speed, sqrt(v^2 + v_s^2), by which v has the direction z."""
    return math.sqrt(rate * rate + slow * slow)


@kernel
def tangent_at(arm, i, pack, z, m, strain):
    """Unit tangent of a tendon at the z-th point of interval m of a pack, and its rate of turning.

    The rate is that with the section, by arc length.
    """
    block = 2 * pack + z
    row = i * 2 * arm.rod.packs + block
    at = row * 4 * LANES + m
    tangent = strain.tangent
    t_x = tangent[at]
    t_y = tangent[at + LANES]
    t_z = tangent[at + 2 * LANES]
    t = (t_x, t_y, t_z)
    curvature, _ = twist_at(strain.xi, block, m)
    turning = cross(curvature, t)
    return t, turning


@kernel
def tangent_change(first, second, distance):
    """Change of a path's tangent between two points at a distance: in the section and with it."""
    t_first, turning_first = first
    t_second, turning_second = second
    within = minus(t_second, t_first)
    turning = plus(turning_first, turning_second)
    with_section = times(0.5 * distance, turning)
    return plus(within, with_section)


@kernel(inline=True)
def size_of(x):
    """Length of a vector."""
    return math.sqrt(dot(x, x))


@kernel
def find_turns(arm, i, strain, turn):
    """Finds the angles by which the path of a tendon turns before each of its points, times mu.

    They go into turn (n_a x points, in their order along the rod).
    """
    rod = arm.rod
    geometry = arm.tendons.geometry
    coefficient = arm.effects.transmission.friction
    blocks = 2 * rod.packs
    before = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    width_before = 0.0
    for pack in range(arm.tendons.pack_begin[i], arm.tendons.pack_end[i]):
        for m in range(LANES):
            k = i * blocks * LANES + pack * PER_PACK + 2 * m
            first_block = 2 * pack
            width = 2.0 * rod.weight[first_block * LANES + m]
            row = i * blocks + first_block
            presence = geometry[(row * 5 + 4) * LANES + m]
            if width == 0.0 or presence == 0.0:
                turn[k] = 0.0
                turn[k + 1] = 0.0
                continue
            first = tangent_at(arm, i, pack, 0, m, strain)
            second = tangent_at(arm, i, pack, 1, m, strain)
            turned_inside = tangent_change(first, second, WITHIN * width)
            inside = size_of(turned_inside)
            if width_before > 0.0:
                # chords cut corners: both angles grow by what the chord of both lacks
                distance = BEFORE * (width + width_before)
                turned = tangent_change(before, first, distance)
                across = size_of(turned)
                both = size_of(plus(turned, turned_inside))
                cut = inside + across - both
                across = across + CUT_ACROSS * cut
                inside = inside + CUT_INSIDE * cut
            else:  # where the tendon begins it turns on as between the points
                across = BEFORE / WITHIN * inside
            turn[k] = coefficient * across
            turn[k + 1] = coefficient * inside
            before = second
            width_before = width


@phase
def find_borders(arm, strain, borders):
    """Finds rows w_k of the tendons' borders and how much their paths turn there.

    Columns are those of an evaluation.
    """
    law = arm.strain
    tendons = arm.tendons
    blocks = 2 * arm.rod.packs
    row = row_stride(law.size + 1)
    rows = borders.row
    for i in range(tendons.size):
        find_turns(arm, i, strain, borders.turn)
        first_point = i * blocks * LANES
        for block in blocks_of(tendons, i):
            pack = block // 2
            weight = load(arm.rod.weight, block * LANES)
            wrench = actuation_wrench(tendons, blocks, block, i, strain.tangent)
            moment, force = scale_twist(weight, wrench)
            first = first_point + pack * PER_PACK + block % 2
            for j in range(law.size):
                own = spread(0.0)
                if is_present(law, j, pack):
                    k, p = load6(strain.Phi, j * blocks + block)
                    own = dot(moment, k) + dot(force, p)
                for m in range(LANES):
                    rows[(first + 2 * m) * row + j] = lane(own, m)
        # w_k = a_k + w_k+1
        begin = first_point + PER_PACK * tendons.pack_begin[i]
        last = first_point + PER_PACK * tendons.pack_end[i] - 1
        for at in range(last * row - LANES, begin * row - LANES, -LANES):
            behind = load(rows, at + row)
            store(rows, at, load(rows, at) + behind)


@phase
def find_shares(arm, strain, tendons, friction):
    """Finds the shares of the tensions that are left at the points, and how the tendons slide.

    They are those at the strain rate strain.xi_dot, from the tangents that pull() left, and go into
    `friction`.
    """
    rod = arm.rod
    geometry = arm.tendons.geometry
    slow = arm.effects.transmission.stiction_speed
    blocks = 2 * rod.packs
    for i in range(arm.tendons.size):
        find_turns(arm, i, strain, friction.turn)
        first_point = i * blocks * LANES
        begin = first_point + PER_PACK * arm.tendons.pack_begin[i]
        end = first_point + PER_PACK * arm.tendons.pack_end[i]
        # how fast the tendon moves along its path, from each point on
        for block in blocks_of(arm.tendons, i):
            row = i * blocks + block
            at = row * 5 * LANES
            weight = load(rod.weight, block * LANES) * presence_of(geometry, at)
            t = load3(strain.tangent, row * 4 * LANES)
            strained = load6(strain.xi_dot, block)
            moved = chord_rate(geometry, at, strained)
            own = weight * dot(t, moved)
            first = first_point + block // 2 * PER_PACK + block % 2
            for m in range(LANES):
                friction.rate[first + 2 * m] = -lane(own, m)
        for k in range(end - 2, begin - 1, -1):
            friction.rate[k] += friction.rate[k + 1]
        # what is left falls by the angles, as the tendon slides there
        turned = 0.0
        for k in range(begin, end):
            rate = friction.rate[k]
            turn = math.copysign(friction.turn[k], tendons.tension[i])
            turned += turn * rate / smooth_speed(rate, slow)
            place = k - first_point
            block = place // PER_PACK * 2 + place % 2
            m = place % PER_PACK // 2
            share_at = (i * blocks + block) * LANES + m
            friction.share[share_at] = math.exp(-turned)


@kernel
def add_lost_stress(arm, strain, tension, share, stress):
    """Adds to `stress` the wrench that friction takes from the tendons, - sum tau (1 - share) s."""
    tendons = arm.tendons
    blocks = 2 * arm.rod.packs
    for block in range(blocks):
        total = load6(stress, block)
        pack = block // 2
        for i in range(tendons.size):
            if is_present(tendons, i, pack):
                row = i * blocks + block
                left = load(share, row * LANES)
                lost = tension[i] * (spread(1.0) - left)
                wrench = actuation_wrench(tendons, blocks, block, i, strain.tangent)
                total = twist_sum(total, scale_twist(lost, wrench))
        store6(stress, block, total)


@phase
def add_friction_damping(arm, tendons, friction, borders, damping):
    """Adds to D what friction damps, sum_k |T_k dphi_k| mu dz/dv w_k w_k^T.

    That is its derivative but for how a tension depends on the directions before it.
    """
    slow = arm.effects.transmission.stiction_speed
    n = damping.shape[0]
    row = row_stride(n + 1)
    points = 2 * arm.rod.packs * LANES
    for i in range(arm.tendons.size):
        tension = tendons.tension[i]
        turned = 0.0
        begin = i * points + PER_PACK * arm.tendons.pack_begin[i]
        end = i * points + PER_PACK * arm.tendons.pack_end[i]
        for k in range(begin, end):
            rate = friction.rate[k]
            turn = math.copysign(borders.turn[k], tension)
            speed = smooth_speed(rate, slow)
            z = rate / speed
            turned += turn * z
            # dz/dv, times what the tension has left
            slope = (1.0 - z * z) / speed
            left = math.exp(-turned)
            drag = tension * left * turn * slope
            first = k * row
            w = borders.row[first : first + n]
            for a in range(n):
                for b in range(n):
                    damping[a, b] += drag * w[a] * w[b]
