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
    y = load(geometry, at)
    z = load(geometry, at + LANES)
    y_prime = load(geometry, at + 2 * LANES)
    z_prime = load(geometry, at + 3 * LANES)
    k_x, k_y, k_z = k
    p_x, p_y, p_z = p
    along = p_x + k_y * z - k_z * y
    across_y = p_y - k_x * z + y_prime
    across_z = p_z + k_x * y + z_prime
    return along, across_y, across_z


@kernel(inline=True)
def wrench_column(geometry, at, t):
    """Wrench column s = S t = (d x t, t)."""
    y = load(geometry, at)
    z = load(geometry, at + LANES)
    t_x, t_y, t_z = t
    about_x = y * t_z - z * t_y
    about_y = z * t_x
    about_z = -y * t_x
    return (about_x, about_y, about_z), t


@kernel(inline=True)
def chord_rate(geometry, at, xi_dot):
    """Rate of the chord t_c, S^T xi_dot."""
    y = load(geometry, at)
    z = load(geometry, at + LANES)
    k, p = xi_dot
    k_x, k_y, k_z = k
    p_x, p_y, p_z = p
    along = p_x + k_y * z - k_z * y
    across_y = p_y - k_x * z
    across_z = p_z + k_x * y
    return along, across_y, across_z


@kernel(inline=True)
def presence_of(geometry, at):
    """Presence of a tendon: 1 where it is, 0 beyond its ends."""
    return load(geometry, at + 4 * LANES)


@kernel(inline=True)
def add_stiffness(h, geometry, at, w, s, free):
    """Adds a tendon's stiffness: h + w S (I - t t^T) S^T, h and the result 21-tuples; w = q /
    |t_c|."""
    # S (I - t t^T) S^T = S S^T - s s^T, with S S^T = [[-d~^2, d~], [-d~, I]] and d = (0, y, z)
    y = load(geometry, at)
    z = load(geometry, at + LANES)
    wy = w * y
    wz = w * z
    s_angular, s_linear = s
    s0, s1, s2 = s_angular
    s3, s4, s5 = s_linear
    w0 = w * s0
    w1 = w * s1
    w2 = w * s2
    # -d~^2 has y^2 + z^2, z^2 and y^2 on its diagonal
    wyy = wy * y
    wzz = wz * z
    rows_0_to_2 = (
        h[0] + (wyy + wzz) - w0 * s0,
        h[1] - w1 * s0,
        h[2] + wzz - w1 * s1,
        h[3] - w2 * s0,
        h[4] - wy * z - w2 * s1,
        h[5] + wyy - w2 * s2,
    )
    row_3 = h[6:10]
    if len(free) > 3:
        row_3 = (
            h[6] - w0 * s3,
            h[7] + wz - w1 * s3,
            h[8] - wy - w2 * s3,
            h[9] + w - w * s3 * s3,
        )
    rows_4_and_5 = h[10:21]
    if len(free) > 4:
        w3 = w * s3
        w4 = w * s4
        w5 = w * s5
        rows_4_and_5 = (
            h[10] - wz - w0 * s4,
            h[11] - w1 * s4,
            h[12] - w2 * s4,
            h[13] - w3 * s4,
            h[14] + w - w4 * s4,
            h[15] + wy - w0 * s5,
            h[16] - w1 * s5,
            h[17] - w2 * s5,
            h[18] - w3 * s5,
            h[19] - w4 * s5,
            h[20] + w - w5 * s5,
        )
    return rows_0_to_2 + row_3 + rows_4_and_5


@kernel(inline=True)
def tangent_rate(geometry, at, xi_dot, t, inverse):
    """Relative rate of |t_c|, and t_dot (Appendix E)."""
    moved = chord_rate(geometry, at, xi_dot)
    rate = times(inverse, moved)
    stretch = dot(rate, t)
    along = times(stretch, t)
    return stretch, minus(rate, along)


@kernel(inline=True)
def is_present(table, i, pack):
    """Tells whether the i-th tendon or coordinate of a table strains a pack of the rod."""
    return table.pack_begin[i] <= pack < table.pack_end[i]


@kernel(inline=True)
def blocks_of(tendons, i):
    """Range of the blocks of points at which a tendon is present."""
    return range(2 * tendons.pack_begin[i], 2 * tendons.pack_end[i])


@kernel(inline=True)
def pull(rod, tendons, block, xi, tau, tangent):
    """Sum of the tendons' wrenches tau s and of their stiffness at one block; leaves the tangents
    in `tangent`."""
    h = zero21()
    total = zero6()
    k, p = xi
    blocks = 2 * rod.packs
    pack = block // 2
    for i in range(tendons.size):
        if is_present(tendons, i, pack):
            row = i * blocks + block
            at = row * 5 * LANES
            t_c = chord(tendons.geometry, at, k, p)
            inverse = 1.0 / sqrt(dot(t_c, t_c))
            t = times(inverse, t_c)
            s = wrench_column(tendons.geometry, at, t)
            tension = tau[i] * presence_of(tendons.geometry, at)
            total = twist_sum(total, scale_twist(tension, s))
            w = tension * inverse
            h = add_stiffness(h, tendons.geometry, at, w, s, rod.free)
            tangent_at = row * 4 * LANES
            store3(tangent, tangent_at, t)
            store(tangent, tangent_at + 3 * LANES, inverse)
    return h, total


@kernel(inline=True)
def actuation_wrench(tendons, blocks, block, i, tangent):
    """Actuation wrench Phi_a of a tendon at one block, by the tangents that pull() left."""
    row = i * blocks + block
    t = load3(tangent, row * 4 * LANES)
    at = row * 5 * LANES
    column = wrench_column(tendons.geometry, at, t)
    presence = presence_of(tendons.geometry, at)
    return scale_twist(-presence, column)


@kernel
def actuation_matrix(arm, strain, share, spare, out):
    """Actuation matrix B (n, n_a), with a share (tendons x points) of the tensions; overwrites the
    matrix and the stress of `spare`."""
    column = spare.matrix[0]
    for i in range(arm.tendons.size):
        actuation_column(arm, i, share, strain, spare.stress, column)
        for j in range(column.size):
            out[j, i] = column[j]


@kernel
def tendon_lengths(rod, tendons, xi, out):
    """Lengths out (n_a) of the tendons along the rod with strain xi (points x 6)."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        length = spread(0.0)
        # int |t_c| dX over the part of the rod where the tendon is
        for block in blocks_of(tendons, i):
            at = (i * blocks + block) * 5 * LANES
            k, p = load6(xi, block)
            t_c = chord(tendons.geometry, at, k, p)
            size = sqrt(dot(t_c, t_c))
            presence = presence_of(tendons.geometry, at)
            weight = load(rod.weight, block * LANES) * presence
            length = length + weight * size
        out[i] = lane_sum(length)


@kernel
def actuation_column(arm, i, share, strain, stress, out):
    """Column B_i = int Phi^T Phi_a,i dX (40e) of the actuation matrix, into out (n), with a share
    (tendons x points) of the tension; overwrites `stress` (points x 6)."""
    rod = arm.rod
    law = arm.strain
    blocks = 2 * rod.packs
    for block in range(blocks):
        row = i * blocks + block
        left = load(share, row * LANES)
        weight = load(rod.weight, block * LANES) * left
        wrench = actuation_wrench(arm.tendons, blocks, block, i, strain.tangent)
        store6(stress, block, scale_twist(weight, wrench))
    rows = point_rows(rod)
    project(strain.Phi, stress, rows, law.pack_begin, law.pack_end, out)


@kernel
def tendon_forces(rod, tendons, share, tangent, rate, out):
    """Product out (n_a) of B^T (40e) with the coordinates that strain the rod by `rate` (points x
    6): what a newton in each tendon, and `share` (tendons x points) of it along its way, does
    there; from the tangents that pull() left."""
    blocks = 2 * rod.packs
    for i in range(tendons.size):
        force = spread(0.0)
        # Phi_a . rate = -t . S^T rate
        for block in blocks_of(tendons, i):
            row = i * blocks + block
            at = row * 5 * LANES
            left = load(share, row * LANES)
            weight = load(rod.weight, block * LANES) * left
            present = weight * presence_of(tendons.geometry, at)
            t = load3(tangent, row * 4 * LANES)
            strained = load6(rate, block)
            moved = chord_rate(tendons.geometry, at, strained)
            force = force - present * dot(t, moved)
        out[i] = lane_sum(force)
