"""Transposed forward kinematics: stresses that do the work of wrenches at the nodes, in one sweep
from tip to base.

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
    coad_apply,
    coefficients,
    cross,
    dot,
    exp_se3,
    minus,
    plus,
    rotate,
    rotate_back,
    scale_twist,
    times,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6
from soft_tendon_env.mechanics.terms.dynamics import point_rows, project
from soft_tendon_env.mechanics.terms.kinematics import (
    KAPPA,
    load_pose,
    magnus,
    pose_at,
    strains_of_part,
)
from soft_tendon_env.mechanics.terms.tendons import actuation_wrench


@kernel(inline=True)
def wrench_at_start(R, r, total):
    """Wrench at the interval's start, in its frame, Ad_g^T of one in the base frame."""
    return rotate_back(R, minus(total[0], cross(r, total[1]))), rotate_back(R, total[1])


@kernel(inline=True)
def transposed_dexp(Omega, c, psi):
    """Transposed tangent operator times a wrench, T^T psi."""
    kp, once = dot(Omega[0], Omega[1]), coad_apply(Omega, psi)
    twice = coad_apply(Omega, once)
    t = twist_sum(psi, twist_sum(scale_twist(-c.a, once), scale_twist(c.b, twice)))
    return plus(t[0], plus(times(-c.a1 * kp, once[1]), times(c.b1 * kp, twice[1]))), t[1]


@kernel(inline=True)
def zanna_transposed(mu, xi, t):
    """Product (1 + mu ad_xi)^T t with a wrench."""
    return twist_sum(t, scale_twist(-mu, coad_apply(xi, t)))


@kernel(inline=True)
def wrench_in_base(R, r, f):
    """Wrench in the base frame, Ad_g^-T f, of one in the frame g."""
    force = rotate(R, f[1])
    return plus(rotate(R, f[0]), cross(r, force)), force


@kernel(inline=True)
def sums_to_tip(x, beyond):
    """Sums of the components of a wrench over the lanes from each one on, and beyond the pack, with
    the sums that the pack before needs."""
    (a, b, c), (d, e, f) = x
    (p, q, r), (s, t, u) = beyond
    p, q, r, s, t, u = (
        p + lane_sum(a),
        q + lane_sum(b),
        r + lane_sum(c),
        s + lane_sum(d),
        t + lane_sum(e),
        u + lane_sum(f),
    )
    k = spread(p) - prefix_sum(a) + a, spread(q) - prefix_sum(b) + b, spread(r) - prefix_sum(c) + c
    m = spread(s) - prefix_sum(d) + d, spread(t) - prefix_sum(e) + e, spread(u) - prefix_sum(f) + f
    return (k, m), ((p, q, r), (s, t, u))


@kernel
def add_wrench_stress(rod, wrench, work, stress):
    """Adds to `stress` (points x 6) that of body wrenches at the nodes (nodes x 6), of which the
    last is the tip; after poses()."""
    beyond = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for back in range(rod.packs):
        pack = rod.packs - 1 - back
        at, node_at = 2 * pack * 6 * LANES, pack * 6 * LANES
        R_end, r_end = load_pose(work.pose, pack * 12 * LANES)
        total, beyond = sums_to_tip(wrench_in_base(R_end, r_end, load6(wrench, node_at)), beyond)
        R, r = load_pose(work.start, pack * 12 * LANES)
        h = load(rod.length, pack * LANES)
        xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        Omega = magnus(h, xi_1, xi_2)
        t = transposed_dexp(
            Omega, coefficients(dot(Omega[0], Omega[0])), wrench_at_start(R, r, total)
        )
        t, mu = scale_twist(0.5 * h, t), (2.0 * KAPPA) * h
        store6(stress, at, twist_sum(load6(stress, at), zanna_transposed(-mu, xi_2, t)))
        store6(
            stress,
            at + 6 * LANES,
            twist_sum(load6(stress, at + 6 * LANES), zanna_transposed(mu, xi_1, t)),
        )


@kernel
def add_tendon_stress(rod, tendons, force, tangent, stress):
    """Adds to `stress` (points x 6) that which does the work of `force` (n_a) on the lengths of the
    tendons; see tendon_forces()."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        for block in range(2 * tendons.pack_begin[i], 2 * tendons.pack_end[i]):
            weight = -force[i] * load(rod.weight, block * LANES)
            wrench = scale_twist(weight, actuation_wrench(tendons, blocks, block, i, tangent))
            store6(stress, block * 6 * LANES, twist_sum(load6(stress, block * 6 * LANES), wrench))


@kernel
def add_strain_stress(length, interval, distance, force, stress):
    """Adds to `stress` (points x 6) that which does the work of `force` (m, 6) on
    strains_inside()."""
    for m in range(interval.size):
        i = interval[m]
        share = math.sqrt(3.0) * (distance[m] / length[i] - 0.5) + 0.5
        at = 2 * (i // LANES) * 6 * LANES + i % LANES
        for k in range(6):
            stress[at + k * LANES] += (1.0 - share) * force[m, k]
            stress[at + (6 + k) * LANES] += share * force[m, k]


@kernel
def add_station_forces(length, interval, distance, force, work, wrench, stress):
    """Adds what does the work of forces (m, 3), world frame, on the positions of poses_inside(): to
    `stress` (points x 6) in their own intervals, and to body wrenches (nodes x 6) at the nodes
    where these begin, for add_wrench_stress(); after poses()."""
    for m in range(interval.size):
        f = force[m, 0], force[m, 1], force[m, 2]
        if dot(f, f) == 0.0:
            continue
        i, part, h = interval[m], distance[m], length[interval[m]]
        xi_1, xi_2 = strains_of_part(h, i, part, work)
        Omega = magnus(part, xi_1, xi_2)
        c = coefficients(dot(Omega[0], Omega[0]))
        R = pose_at(work.start, i)[0]
        way = rotate(R, exp_se3(Omega, c)[1])
        at_start = rotate_back(R, cross(way, f)), rotate_back(R, f)
        if i > 0:
            add_at(wrench, ((i - 1) // LANES) * 6 * LANES + (i - 1) % LANES, at_start)
        t, mu = scale_twist(0.5 * part, transposed_dexp(Omega, c, at_start)), 2.0 * KAPPA * part
        first, second = zanna_transposed(-mu, xi_2, t), zanna_transposed(mu, xi_1, t)
        both, apart = twist_sum(first, second), twist_sum(second, scale_twist(-1.0, first))
        turned = twist_sum(
            scale_twist(0.5 * math.sqrt(3.0) * (part / h - 1.0), both),
            scale_twist(0.5 * part / h, apart),
        )
        at = 2 * (i // LANES) * 6 * LANES + i % LANES
        add_at(stress, at, twist_sum(scale_twist(0.5, both), scale_twist(-1.0, turned)))
        add_at(stress, at + 6 * LANES, twist_sum(scale_twist(0.5, both), turned))


@kernel(inline=True)
def add_at(field, at, x):
    """Adds a twist or a wrench to one lane of a field."""
    for k in range(3):
        field[at + k * LANES] += x[0][k]
        field[at + (3 + k) * LANES] += x[1][k]


@kernel
def stress_force(rod, strain, work, stress, out):
    """Generalised force Phi^T stress of a stress field with the weights in it, out (n)."""
    project(work.Phi, stress, point_rows(rod), strain.pack_begin, strain.pack_end, out)
