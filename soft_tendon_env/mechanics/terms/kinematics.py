"""Forward kinematics: poses, body Jacobian and twists at the nodes by fourth-order Magnus steps
(11)-(13), Appendix C.

With the Zanna operator written out, Omega_dot = Z(xi_dot) and J(X + h) = Ad^-1 (J + T Z(Phi))
become in the base frame running sums: with W_1 = Ad_g T (h/2 - kappa ad_xi2) and W_2 = Ad_g T (h/2
+ kappa ad_xi1), kappa = sqrt(3) h^2 / 12, the column of the base-frame Jacobian grows by W_1 Phi_1
+ W_2 Phi_2 over an interval. All intervals of a pack are taken together.
"""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, load, prefix_sum, spread
from soft_tendon_env.mechanics.algebra.lie import (
    Ad_apply,
    Ad_inverse_apply,
    ad_apply,
    coefficients,
    dexp_dot_apply,
    dexp_operator,
    dot,
    exp_se3,
    matmul,
    matrix_sum,
    operator_apply,
    plus,
    rotate,
    scale_matrix,
    scale_twist,
    skew_times,
    times_skew,
    twist_sum,
)
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store6

KAPPA = math.sqrt(3.0) / 12.0


@kernel(inline=True)
def magnus(h, xi_1, xi_2):
    """Magnus expansion Omega(h) = h/2 (xi_1 + xi_2) + sqrt(3) h^2/12 ad_xi_1 xi_2 (Appendix C)."""
    return twist_sum(
        scale_twist(0.5 * h, twist_sum(xi_1, xi_2)),
        scale_twist(KAPPA * h * h, ad_apply(xi_1, xi_2)),
    )


@kernel(inline=True)
def zanna(h, xi_1, xi_2, x_1, x_2):
    """Zanna operator Z_h(x): the derivative of Omega along x (Appendix C)."""
    bracket = twist_sum(ad_apply(xi_1, x_2), scale_twist(-1.0, ad_apply(xi_2, x_1)))
    return twist_sum(scale_twist(0.5 * h, twist_sum(x_1, x_2)), scale_twist(KAPPA * h * h, bracket))


@kernel(inline=True)
def load_pose(field, at):
    R = load3(field, at) + load3(field, at + 3 * LANES) + load3(field, at + 6 * LANES)
    return R, load3(field, at + 9 * LANES)


@kernel
def poses(rod, work):
    """Poses at the start and at the end of every interval, products of the exponentials exp(Omega)
    (11)."""
    for pack in range(rod.packs):
        h = load(rod.length, pack * LANES)
        at = 2 * pack * 6 * LANES
        Omega = magnus(h, load6(work.xi, at), load6(work.xi, at + 6 * LANES))
        R, r = exp_se3(Omega, coefficients(dot(Omega[0], Omega[0])))
        store6(work.relative, pack * 12 * LANES, ((R[0], R[1], R[2]), (R[3], R[4], R[5])))
        store6(work.relative, (pack * 12 + 6) * LANES, ((R[6], R[7], R[8]), r))
    chain(rod.packs, work)


@kernel(inline=True)
def _gather(field, at):
    R = (
        field[at],
        field[at + LANES],
        field[at + 2 * LANES],
        field[at + 3 * LANES],
        field[at + 4 * LANES],
        field[at + 5 * LANES],
        field[at + 6 * LANES],
        field[at + 7 * LANES],
        field[at + 8 * LANES],
    )
    return R, (field[at + 9 * LANES], field[at + 10 * LANES], field[at + 11 * LANES])


@kernel(inline=True)
def write_pose(R, r, out):
    """Writes (R, r) as the upper rows of a matrix out (4, 4), whose last row is there already."""
    for row in range(3):
        for column in range(3):
            out[row, column] = R[3 * row + column]
        out[row, 3] = r[row]


@kernel(inline=True)
def tip_pose_of(pose):
    """Pose (R, r) of the last node as numbers."""
    return _gather(pose, pose.size - 11 * LANES - 1)


@kernel(inline=True)
def _scatter(field, at, R, r):
    for i in range(9):
        field[at + i * LANES] = R[i]
    for i in range(3):
        field[at + (9 + i) * LANES] = r[i]


@kernel(inline=True)
def pose_of_base(b):
    """Pose (R, r) of the base as numbers, of 12 and more in a row."""
    return (b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8]), (b[9], b[10], b[11])


@kernel
def chain(packs, work):
    """Products of the interval poses, one after the other from the base."""
    R, r = pose_of_base(work.base)
    for pack in range(packs):
        for i in range(LANES):
            at = pack * 12 * LANES + i
            _scatter(work.start, at, R, r)
            R_step, r_step = _gather(work.relative, at)
            R, r = matmul(R, R_step), plus(r, rotate(R, r_step))
            _scatter(work.pose, at, R, r)


@kernel(inline=True)
def twist_at(field, block, lane_index):
    """Twist-shaped numbers of one lane of a field over points or nodes."""
    at = block * 6 * LANES + lane_index
    k = field[at], field[at + LANES], field[at + 2 * LANES]
    return k, (field[at + 3 * LANES], field[at + 4 * LANES], field[at + 5 * LANES])


@kernel(inline=True)
def strains_of_part(h, interval, part, work):
    """Strains at the two points of the first `part` of an interval of length h, linear between its
    own two."""
    pack, lane_index = interval // LANES, interval % LANES
    xi_1, xi_2 = (
        twist_at(work.xi, 2 * pack, lane_index),
        twist_at(work.xi, 2 * pack + 1, lane_index),
    )
    slope = scale_twist(math.sqrt(3.0) / h, twist_sum(xi_2, scale_twist(-1.0, xi_1)))
    middle = twist_sum(
        scale_twist(0.5, twist_sum(xi_1, xi_2)), scale_twist(0.5 * (part - h), slope)
    )
    reach = scale_twist(part * math.sqrt(3.0) / 6.0, slope)
    return twist_sum(middle, scale_twist(-1.0, reach)), twist_sum(middle, reach)


@kernel(inline=True)
def pose_at(field, node):
    """Pose (R, r) of one node, or of the start of its interval, as numbers."""
    return _gather(field, node // LANES * 12 * LANES + node % LANES)


@kernel
def poses_inside(length, interval, distance, work, out):
    """Poses out (m, 4, 4) at `distance` (m,) from the start of the intervals (m,), with the strain
    linear between the two points."""
    for m in range(interval.size):
        i, part = interval[m], distance[m]
        xi_1, xi_2 = strains_of_part(length[i], i, part, work)
        Omega = magnus(part, xi_1, xi_2)
        R_part, r_part = exp_se3(Omega, coefficients(dot(Omega[0], Omega[0])))
        R, r = pose_at(work.start, i)
        R, r = matmul(R, R_part), plus(r, rotate(R, r_part))
        write_pose(R, r, out[m])


@kernel
def strains_inside(length, interval, distance, field, out):
    """A field over points as out (m, 6) at `distance` (m,) from the start of the intervals (m,),
    linear between their two points."""
    for m in range(interval.size):
        i = interval[m]
        pack, lane_index = i // LANES, i % LANES
        share = math.sqrt(3.0) * (distance[m] / length[i] - 0.5) + 0.5
        xi_1, xi_2 = (
            twist_at(field, 2 * pack, lane_index),
            twist_at(field, 2 * pack + 1, lane_index),
        )
        k, p = twist_sum(scale_twist(1.0 - share, xi_1), scale_twist(share, xi_2))
        for i in range(3):
            out[m, i] = k[i]
            out[m, 3 + i] = p[i]


@kernel(inline=True)
def interval_operators(h, half, kappa, xi_1, xi_2, R, r):
    """Operators W_1 = Ad_g T (half - kappa ad_xi2), W_2 = Ad_g T (half + kappa ad_xi1) and Ad_g T,
    pairs (A, C); Omega, coefficients."""
    Omega = magnus(h, xi_1, xi_2)
    c = coefficients(dot(Omega[0], Omega[0]))
    T, T_dual = dexp_operator(Omega, c)
    A = matmul(R, T)
    C = matrix_sum(matmul(R, T_dual), skew_times(r, A))
    A_1 = matrix_sum(scale_matrix(half, A), scale_matrix(-kappa, times_skew(A, xi_2[0])))
    A_2 = matrix_sum(scale_matrix(half, A), scale_matrix(kappa, times_skew(A, xi_1[0])))
    C_1 = matrix_sum(
        scale_matrix(half, C),
        scale_matrix(-kappa, matrix_sum(times_skew(C, xi_2[0]), times_skew(A, xi_2[1]))),
    )
    C_2 = matrix_sum(
        scale_matrix(half, C),
        scale_matrix(kappa, matrix_sum(times_skew(C, xi_1[0]), times_skew(A, xi_1[1]))),
    )
    return (A_1, C_1), (A_2, C_2), A, C, Omega, c


@kernel(inline=True)
def running_sum(carry, row, x):
    """Sums of x over the intervals up to each lane, on top of the carried one, which moves on to
    the pack's end."""
    at = row * 6
    k = (
        prefix_sum(x[0][0]) + carry[at],
        prefix_sum(x[0][1]) + carry[at + 1],
        prefix_sum(x[0][2]) + carry[at + 2],
    )
    p = (
        prefix_sum(x[1][0]) + carry[at + 3],
        prefix_sum(x[1][1]) + carry[at + 4],
        prefix_sum(x[1][2]) + carry[at + 5],
    )
    for i in range(3):
        carry[at + i] = lane(k[i], LANES - 1)
        carry[at + 3 + i] = lane(p[i], LANES - 1)
    return k, p


@kernel
def sweep(rod, strain, columns, work):
    """Twist eta = J q_dot at every node, its bias J_dot q_dot, and the first `columns` columns of J
    (17)-(18); after poses()."""
    n, packs = strain.size, rod.packs
    blocks = 2 * packs
    work.carry[:] = 0.0
    copy(work.base[12:24], work.carry[n * 6 : (n + 2) * 6])
    for pack in range(packs):
        at = 2 * pack * 6 * LANES
        h = load(rod.length, pack * LANES)
        xi_1, xi_2 = load6(work.xi, at), load6(work.xi, at + 6 * LANES)
        R, r = load_pose(work.start, pack * 12 * LANES)
        W_1, W_2, A, C, Omega, c = interval_operators(h, 0.5 * h, KAPPA * h * h, xi_1, xi_2, R, r)
        R_end, r_end = load_pose(work.pose, pack * 12 * LANES)

        rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
        growth = twist_sum(
            operator_apply(W_1[0], W_1[1], rate_1), operator_apply(W_2[0], W_2[1], rate_2)
        )
        Omega_dot = zanna(h, xi_1, xi_2, rate_1, rate_2)
        change = operator_apply(A, C, scale_twist(2.0 * KAPPA * h * h, ad_apply(rate_1, rate_2)))
        change = twist_sum(change, Ad_apply(R, r, dexp_dot_apply(Omega, Omega_dot, c, Omega_dot)))
        eta_end = running_sum(work.carry, n, growth)
        eta_start = twist_sum(eta_end, scale_twist(-1.0, growth))
        store6(work.eta, pack * 6 * LANES, Ad_inverse_apply(R_end, r_end, eta_end))

        bias_1, bias_2 = load6(work.xi_bias, at), load6(work.xi_bias, at + 6 * LANES)
        change = twist_sum(
            change,
            twist_sum(
                operator_apply(W_1[0], W_1[1], bias_1), operator_apply(W_2[0], W_2[1], bias_2)
            ),
        )
        bias_end = running_sum(work.carry, n + 1, twist_sum(change, ad_apply(eta_start, growth)))
        store6(work.eta_bias, pack * 6 * LANES, Ad_inverse_apply(R_end, r_end, bias_end))

        for j in range(columns):
            if strain.pack_begin[j] > pack:
                continue
            if pack < strain.pack_end[j]:
                field_at = (j * blocks + 2 * pack) * 6 * LANES
                phi_1, phi_2 = load6(work.Phi, field_at), load6(work.Phi, field_at + 6 * LANES)
                growth = twist_sum(
                    operator_apply(W_1[0], W_1[1], phi_1), operator_apply(W_2[0], W_2[1], phi_2)
                )
                column = running_sum(work.carry, j, growth)
            else:
                sums = work.carry[6 * j : 6 * j + 6]
                column = (
                    (spread(sums[0]), spread(sums[1]), spread(sums[2])),
                    (spread(sums[3]), spread(sums[4]), spread(sums[5])),
                )
            store6(work.J, (j * packs + pack) * 6 * LANES, Ad_inverse_apply(R_end, r_end, column))


@kernel
def node_twists(rod, work):
    """Body twists eta at the nodes from xi_dot; after poses(). As sweep() has them, without
    columns."""
    copy(work.base[12:18], work.carry[:6])
    for pack in range(rod.packs):
        at = 2 * pack * 6 * LANES
        R, r = load_pose(work.start, pack * 12 * LANES)
        h, xi_1, xi_2 = (
            load(rod.length, pack * LANES),
            load6(work.xi, at),
            load6(work.xi, at + 6 * LANES),
        )
        W_1, W_2, A, C, Omega, c = interval_operators(h, 0.5 * h, KAPPA * h * h, xi_1, xi_2, R, r)
        rate_1, rate_2 = load6(work.xi_dot, at), load6(work.xi_dot, at + 6 * LANES)
        growth = twist_sum(
            operator_apply(W_1[0], W_1[1], rate_1), operator_apply(W_2[0], W_2[1], rate_2)
        )
        R_end, r_end = load_pose(work.pose, pack * 12 * LANES)
        store6(
            work.eta,
            pack * 6 * LANES,
            Ad_inverse_apply(R_end, r_end, running_sum(work.carry, 0, growth)),
        )


@kernel
def tip_twist(rod, work):
    """Body twist (angular, linear) of the tip from xi_dot, as numbers; after poses()."""
    node_twists(rod, work)
    return twist_at(work.eta, rod.packs - 1, LANES - 1)
