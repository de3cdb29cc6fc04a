"""Tendon actuation at one pack of points: tangent, wrench column, share of the section stiffness
and of the bias.

A tendon at d = (0, y, z) runs along t_c = k~ d + p + d' (22) and pulls the section with s u, s = S
t, S = [d~; I]: with the project's sign (positive tension pulls) the actuation column is -s, so that
Psi = -sum (q/|t_c|) S (I - t t^T) S^T (32).
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane_sum, load, spread, sqrt, store
from soft_tendon_env.mechanics.algebra.lie import dot, minus, scale_twist, times, twist_sum
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store3, store6, zero6, zero21
from soft_tendon_env.mechanics.terms.dynamics import point_rows, project


@kernel(inline=True)
def chord(geometry, at, k, p):
    """Chord t_c = k~ d + p + d' of a tendon (22)."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    y_prime, z_prime = load(geometry, at + 2 * LANES), load(geometry, at + 3 * LANES)
    return p[0] + k[1] * z - k[2] * y, p[1] - k[0] * z + y_prime, p[2] + k[0] * y + z_prime


@kernel(inline=True)
def wrench_column(geometry, at, t):
    """Wrench column s = S t = (d x t, t)."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    return (y * t[2] - z * t[1], z * t[0], -y * t[0]), t


@kernel(inline=True)
def chord_rate(geometry, at, xi_dot):
    """Rate of the chord t_c, S^T xi_dot."""
    y, z = load(geometry, at), load(geometry, at + LANES)
    k, p = xi_dot
    return p[0] + k[1] * z - k[2] * y, p[1] - k[0] * z, p[2] + k[0] * y


@kernel(inline=True)
def add_stiffness(h, geometry, at, w, s, free):
    """Adds a tendon's stiffness: h + w S (I - t t^T) S^T, h and the result 21-tuples; w = q /
    |t_c|."""
    (
        h0,
        h1,
        h2,
        h3,
        h4,
        h5,
        h6,
        h7,
        h8,
        h9,
        h10,
        h11,
        h12,
        h13,
        h14,
        h15,
        h16,
        h17,
        h18,
        h19,
        h20,
    ) = h
    y, z = load(geometry, at), load(geometry, at + LANES)
    wy, wz = w * y, w * z
    (s0, s1, s2), (s3, s4, s5) = s
    w0, w1, w2 = w * s0, w * s1, w * s2
    h0, h1, h2 = h0 + (wy * y + wz * z) - w0 * s0, h1 - w1 * s0, h2 + wz * z - w1 * s1
    h3, h4, h5 = h3 - w2 * s0, h4 - wy * z - w2 * s1, h5 + wy * y - w2 * s2
    if len(free) > 3:
        h6, h7, h8, h9 = h6 - w0 * s3, h7 + wz - w1 * s3, h8 - wy - w2 * s3, h9 + w - w * s3 * s3
    if len(free) > 4:
        w3, w4, w5 = w * s3, w * s4, w * s5
        h10, h11, h12, h13, h14 = (
            h10 - wz - w0 * s4,
            h11 - w1 * s4,
            h12 - w2 * s4,
            h13 - w3 * s4,
            h14 + w - w4 * s4,
        )
        h15, h16, h17, h18 = h15 + wy - w0 * s5, h16 - w1 * s5, h17 - w2 * s5, h18 - w3 * s5
        h19, h20 = h19 - w4 * s5, h20 + w - w5 * s5
    return (
        h0,
        h1,
        h2,
        h3,
        h4,
        h5,
        h6,
        h7,
        h8,
        h9,
        h10,
        h11,
        h12,
        h13,
        h14,
        h15,
        h16,
        h17,
        h18,
        h19,
        h20,
    )


@kernel(inline=True)
def tangent_rate(geometry, at, xi_dot, t, inverse):
    """Relative rate of |t_c|, and t_dot (Appendix E)."""
    rate = times(inverse, chord_rate(geometry, at, xi_dot))
    stretch = rate[0] * t[0] + rate[1] * t[1] + rate[2] * t[2]
    return stretch, minus(rate, times(stretch, t))


@kernel(inline=True)
def pull(rod, tendons, block, xi, tau, tangent):
    """Sum of the tendons' wrenches tau s and of their stiffness at one block; leaves the tangents
    in `tangent`."""
    h, total = zero21(), zero6()
    k, p = xi
    blocks, pack = 2 * rod.packs, block // 2
    for i in range(tendons.size):
        if tendons.pack_begin[i] <= pack < tendons.pack_end[i]:
            at = (i * blocks + block) * 5 * LANES
            t_c = chord(tendons.geometry, at, k, p)
            inverse = 1.0 / sqrt(dot(t_c, t_c))
            t = t_c[0] * inverse, t_c[1] * inverse, t_c[2] * inverse
            s = wrench_column(tendons.geometry, at, t)
            tension = tau[i] * load(tendons.geometry, at + 4 * LANES)
            total = twist_sum(total, scale_twist(tension, s))
            h = add_stiffness(h, tendons.geometry, at, tension * inverse, s, rod.free)
            store_at = (i * blocks + block) * 4 * LANES
            store3(tangent, store_at, t)
            store(tangent, store_at + 3 * LANES, inverse)
    return h, total


@kernel(inline=True)
def actuation_wrench(tendons, blocks, block, i, tangent):
    """Actuation wrench Phi_a of a tendon at one block, by the tangents that pull() left."""
    at = i * blocks + block
    presence, t = load(tendons.geometry, (at * 5 + 4) * LANES), load3(tangent, at * 4 * LANES)
    return scale_twist(-presence, wrench_column(tendons.geometry, at * 5 * LANES, t))


@kernel
def actuation_matrix(arm, work, out):
    """Actuation matrix B (n, n_a)."""
    for i in range(arm.tendons.size):
        column = work.extra[0]
        actuation_column(arm, i, work.whole, work, column)
        for j in range(column.size):
            out[j, i] = column[j]


@kernel
def tendon_lengths(rod, tendons, work, out):
    """Lengths out (n_a) of the tendons along the rod strained by work.xi."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        total = spread(0.0)
        for block in range(2 * tendons.pack_begin[i], 2 * tendons.pack_end[i]):
            at, (k, p) = (i * blocks + block) * 5 * LANES, load6(work.xi, block * 6 * LANES)
            t_c = chord(tendons.geometry, at, k, p)
            total = total + load(rod.weight, block * LANES) * load(
                tendons.geometry, at + 4 * LANES
            ) * sqrt(dot(t_c, t_c))
        out[i] = lane_sum(total)


@kernel
def actuation_column(arm, i, share, work, out):
    """Column B_i = int Phi^T Phi_a,i dX (40e) of the actuation matrix, into out (n), with a share
    (tendons x points) of the tension."""
    rod, strain, blocks = arm.rod, arm.strain, 2 * arm.rod.packs
    for block in range(blocks):
        weight = load(rod.weight, block * LANES) * load(share, (i * blocks + block) * LANES)
        store6(
            work.mismatch,
            block * 6 * LANES,
            scale_twist(weight, actuation_wrench(arm.tendons, blocks, block, i, work.tangent)),
        )
    project(work.Phi, work.mismatch, point_rows(rod), strain.pack_begin, strain.pack_end, out)


@kernel
def tendon_forces(rod, tendons, share, tangent, rate, out):
    """Product out (n_a) of B^T (40e) with the coordinates that strain the rod by `rate` (points x
    6): what a newton in each tendon, and `share` (tendons x points) of it along its way, does
    there; from the tangents that pull() left."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        sum_i = spread(0.0)
        for block in range(2 * tendons.pack_begin[i], 2 * tendons.pack_end[i]):
            at = i * blocks + block
            weight = (
                load(rod.weight, block * LANES)
                * load(share, at * LANES)
                * load(tendons.geometry, at * 5 * LANES + 4 * LANES)
            )
            t, moved = (
                load3(tangent, at * 4 * LANES),
                chord_rate(tendons.geometry, at * 5 * LANES, load6(rate, block * 6 * LANES)),
            )
            sum_i = sum_i - weight * (t[0] * moved[0] + t[1] * moved[1] + t[2] * moved[2])
        out[i] = lane_sum(sum_i)
