"""Transposed forward kinematics: stresses that do the work of wrenches at the nodes.

It is one sweep from tip to base.

A generalised force J^T f is Phi^T of such a stress field: the body Jacobian J of every coordinate
is not formed.

The displacement of an interval's end in the frame of its start is T Z(delta xi), see kinematics, so
that a wrench psi there does the work t . Z(delta xi) with t = T^T psi. Over the weight h / 2, Z_1 =
1 - mu ad_xi2 and Z_2 = 1 + mu ad_xi1, mu = sqrt(3) h / 6. As in algebra/lie T has the formula of
SO(3) over the dual numbers: T^T psi = psi + a ad^T psi + b ad^T ad^T psi, ad^T psi = -ad*_Omega
psi.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, prefix_sum, spread
from soft_tendon_env.mechanics.algebra.lie import (
    angle_coefficients,
    coad_apply,
    cross,
    dexp_transposed_apply,
    dot,
    exp_se3,
    minus,
    plus,
    rotate,
    rotate_back,
    scale_twist,
    twist_difference,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.dynamics import point_rows, project
from soft_tendon_env.mechanics.terms.kinematics import (
    KAPPA,
    interval_strains,
    load_pose,
    magnus,
    pose_at,
    share_of_second,
    strains_of_part,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_wrench, blocks_of


@kernel(inline=True)
def wrench_at_start(R, r, total):
    """Wrench at the interval's start, in its frame, Ad_g^T of one in the base frame."""
    moment = minus(total[0], cross(r, total[1]))
    return rotate_back(R, moment), rotate_back(R, total[1])


@kernel(inline=True)
def magnus_transposed(h, xi_1, xi_2, psi):
    """Generalised forces Z_1^T T^T psi and Z_2^T T^T psi, over the weight h / 2.

    They are on the strains at the two points of an interval of length h: of a wrench psi on its
    end, in the frame of its start.
    """
    Omega = magnus(h, xi_1, xi_2)
    c = angle_coefficients(Omega)
    t = dexp_transposed_apply(Omega, c, psi)
    return forces_at_points(h, xi_1, xi_2, t)


@kernel(inline=True)
def forces_at_points(h, xi_1, xi_2, t):
    """Generalised forces Z_1^T t and Z_2^T t on the strains at the two points of an interval."""
    mu = 2.0 * KAPPA * h
    first = zanna_transposed(-mu, xi_2, t)
    second = zanna_transposed(mu, xi_1, t)
    return first, second


@kernel(inline=True)
def zanna_transposed(mu, xi, t):
    """Product (1 + mu ad_xi)^T t with a wrench."""
    return twist_sum(t, scale_twist(-mu, coad_apply(xi, t)))


@kernel(inline=True)
def wrench_in_base(R, r, f):
    """Wrench in the base frame, Ad_g^-T f, of one in the frame g."""
    own_moment, own_force = f
    force = rotate(R, own_force)
    moment = plus(rotate(R, own_moment), cross(r, force))
    return moment, force


@kernel(inline=True)
def sum_to_tip(x, beyond):
    """Sums of a pack over the lanes from each one on, and beyond the pack.

    It also gives the sum that the pack before needs.
    """
    total = beyond + lane_sum(x)
    return spread(total) - prefix_sum(x) + x, total


@kernel(inline=True)
def sums_to_tip(x, beyond):
    """sum_to_tip() of the components of a wrench."""
    moment, force = x
    moment_beyond, force_beyond = beyond
    m, m_total = vector_sums_to_tip(moment, moment_beyond)
    f, f_total = vector_sums_to_tip(force, force_beyond)
    return (m, f), (m_total, f_total)


@kernel(inline=True)
def vector_sums_to_tip(x, beyond):
    """sum_to_tip() of the components of a vector."""
    first, first_total = sum_to_tip(x[0], beyond[0])
    second, second_total = sum_to_tip(x[1], beyond[1])
    third, third_total = sum_to_tip(x[2], beyond[2])
    total = (first_total, second_total, third_total)
    return (first, second, third), total


@kernel
def add_wrench_stress(rod, wrench, xi, kinematics, stress):
    """Adds to `stress` (points x 6) that of body wrenches at the nodes (nodes x 6).

    The last of them is the tip; after poses() of strains xi (points x 6).
    """
    beyond = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for back in range(rod.packs):
        pack = rod.packs - 1 - back
        # wrench on all that an interval carries, in the base frame, then in that of its start
        R_end, r_end = load_pose(kinematics.pose, pack)
        own_wrench = load6(wrench, pack)
        at_node = wrench_in_base(R_end, r_end, own_wrench)
        total, beyond = sums_to_tip(at_node, beyond)
        R, r = load_pose(kinematics.start, pack)
        psi = wrench_at_start(R, r, total)
        h = load(rod.length, pack * LANES)
        xi_1, xi_2 = interval_strains(xi, pack)
        # times the weight h / 2
        Omega = magnus(h, xi_1, xi_2)
        c = angle_coefficients(Omega)
        t = dexp_transposed_apply(Omega, c, psi)
        t = scale_twist(0.5 * h, t)
        first, second = forces_at_points(h, xi_1, xi_2, t)
        add_to_block(stress, 2 * pack, first)
        add_to_block(stress, 2 * pack + 1, second)


@kernel(inline=True)
def add_to_block(field, block, x):
    """Adds a twist or a wrench of packs to a field."""
    store6(field, block, twist_sum(load6(field, block), x))


@kernel
def add_tendon_stress(rod, tendons, force, tangent, stress):
    """Adds to `stress` (points x 6) that which does the work of `force` on tendon lengths.

    force is (n_a); see tendon_forces().
    """
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        for block in blocks_of(tendons, i):
            weight = -force[i] * load(rod.weight, block * LANES)
            wrench = actuation_wrench(tendons, blocks, block, i, tangent)
            share = scale_twist(weight, wrench)
            add_to_block(stress, block, share)


@kernel
def add_strain_stress(length, interval, distance, force, stress):
    """Adds to `stress` (points x 6) that which does the work of `force` (m, 6).

    The work is on strains_inside().
    """
    for m in range(interval.size):
        i = interval[m]
        share = share_of_second(length, i, distance[m])
        rest = 1.0 - share
        first = first_point_of(i)
        second = first + 6 * LANES
        for k in range(6):
            component = k * LANES
            stress[first + component] += rest * force[m, k]
            stress[second + component] += share * force[m, k]


@kernel(inline=True)
def index_of_node(node):
    """Index in a field over nodes of the first component at a node."""
    return (node // LANES) * 6 * LANES + node % LANES


@kernel(inline=True)
def first_point_of(interval):
    """Index in a field over points of an interval's first point."""
    return 2 * (interval // LANES) * 6 * LANES + interval % LANES


@kernel
def add_station_forces(rod, stations, force, xi, kinematics, wrench, stress):
    """Adds what does the work of forces (m, 3) on the positions of poses_inside().

    Forces are in the world frame; it is added to `stress` (points x 6) in their own intervals, and
    to body wrenches (nodes x 6) at the nodes where these begin, for add_wrench_stress(); after
    poses() of strains xi (points x 6). stations: intervals (m,) and distances (m,) from their
    start.
    """
    interval, distance = stations
    for m in range(interval.size):
        f = (force[m, 0], force[m, 1], force[m, 2])
        if dot(f, f) == 0.0:
            continue
        i = interval[m]
        part = distance[m]
        h = rod.length[i]
        xi_1, xi_2 = strains_of_part(h, i, part, xi)
        Omega = magnus(part, xi_1, xi_2)
        c = angle_coefficients(Omega)
        # the force at the station as a wrench at the node before, in its frame
        R, _ = pose_at(kinematics.start, i)
        _, r_part = exp_se3(Omega, c)
        way = rotate(R, r_part)
        moment = cross(way, f)
        psi = rotate_back(R, moment), rotate_back(R, f)
        if i > 0:
            add_at(wrench, index_of_node(i - 1), psi)
        # generalised forces on the strains at the two points of the part
        t = dexp_transposed_apply(Omega, c, psi)
        t = scale_twist(0.5 * part, t)
        first, second = forces_at_points(part, xi_1, xi_2, t)
        # and on those at the points of the interval, between which the strain is linear: half of
        # the sum by their mean, and the rest by their difference
        both = twist_sum(first, second)
        apart = twist_difference(second, first)
        middle = 0.5 * math.sqrt(3.0) * (part / h - 1.0)
        by_middle = scale_twist(middle, both)
        by_reach = scale_twist(0.5 * part / h, apart)
        turned = twist_sum(by_middle, by_reach)
        half = scale_twist(0.5, both)
        at = first_point_of(i)
        add_at(stress, at, twist_difference(half, turned))
        add_at(stress, at + 6 * LANES, twist_sum(half, turned))


@kernel(inline=True)
def add_at(field, at, x):
    """Adds a twist or a wrench to one lane of a field."""
    angular, linear = x
    for k in range(3):
        field[at + k * LANES] += angular[k]
        field[at + (3 + k) * LANES] += linear[k]


@kernel
def stress_force(rod, law, Phi, stress, out):
    """Generalised force Phi^T stress of a stress field with the weights in it, out (n)."""
    project(Phi, stress, point_rows(rod), law.pack_begin, law.pack_end, out)
