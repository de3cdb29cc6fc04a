"""Forward kinematics by fourth-order Magnus steps (11)-(13), Appendix C.

They are poses, body Jacobian and twists at the nodes.

With the Zanna operator written out, Omega_dot = Z(xi_dot) and J(X + h) = Ad^-1 (J + T Z(Phi))
become in the base frame running sums: with W_1 = Ad_g T (h/2 - kappa ad_xi2) and W_2 = Ad_g T (h/2
+ kappa ad_xi1), kappa = sqrt(3) h^2 / 12, the column of the base-frame Jacobian grows by W_1 Phi_1
+ W_2 Phi_2 over an interval. All intervals of a pack are taken together.
"""

import math
from typing import NamedTuple

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, lane, load, prefix_sum, spread
from soft_tendon_env.mechanics.algebra.lie import (
    Ad_apply,
    Ad_inverse_apply,
    Coefficients,
    ad_apply,
    angle_coefficients,
    dexp_dot_apply,
    dexp_operator,
    exp_se3,
    matmul,
    matrix_sum,
    operator_apply,
    plus,
    pose_step,
    rotate,
    scale_matrix,
    scale_twist,
    skew_times,
    times_skew,
    twist_difference,
    twist_of,
    twist_sum,
    write_twist,
)
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.algebra.symmetric6 import load3, load6, store6

KAPPA = math.sqrt(3.0) / 12.0  # of h^2, in the Magnus expansion


@kernel(inline=True)
def magnus(h, xi_1, xi_2):
    """Magnus expansion Omega(h) = h/2 (xi_1 + xi_2) + sqrt(3) h^2/12 ad_xi_1 xi_2 (Appendix C)."""
    mean = scale_twist(0.5 * h, twist_sum(xi_1, xi_2))
    bracket = ad_apply(xi_1, xi_2)
    turning = scale_twist(KAPPA * h * h, bracket)
    return twist_sum(mean, turning)


@kernel(inline=True)
def zanna(h, xi_1, xi_2, x_1, x_2):
    """Zanna operator Z_h(x): the derivative of Omega along x (Appendix C)."""
    mean = scale_twist(0.5 * h, twist_sum(x_1, x_2))
    bracket = twist_difference(ad_apply(xi_1, x_2), ad_apply(xi_2, x_1))
    turning = scale_twist(KAPPA * h * h, bracket)
    return twist_sum(mean, turning)


@kernel(inline=True)
def load_pose(field, pack):
    """Poses (R, r) of a pack of a field."""
    at = pack * 12 * LANES
    first = load3(field, at)
    second = load3(field, at + 3 * LANES)
    third = load3(field, at + 6 * LANES)
    r = load3(field, at + 9 * LANES)
    return first + second + third, r


@kernel(inline=True)
def interval_strains(xi, pack):
    """Strains at the two points of the intervals of a pack."""
    return load6(xi, 2 * pack), load6(xi, 2 * pack + 1)


@kernel
def poses(rod, base, xi, kinematics):
    """Poses at the start and at the end of every interval.

    They are products of the exponentials exp(Omega) (11) from a base at base[:12], for strains xi
    (points x 6).
    """
    for pack in range(rod.packs):
        h = load(rod.length, pack * LANES)
        xi_1, xi_2 = interval_strains(xi, pack)
        Omega = magnus(h, xi_1, xi_2)
        c = angle_coefficients(Omega)
        R, r = exp_se3(Omega, c)
        # twelve numbers, as two twists
        store6(kinematics.relative, 2 * pack, (R[0:3], R[3:6]))
        store6(kinematics.relative, 2 * pack + 1, (R[6:9], r))
    chain(rod.packs, base, kinematics)


@kernel(inline=True)
def _gather(field, at):
    """Pose (R, r) of one lane of a field of poses as numbers."""
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
    r = (
        field[at + 9 * LANES],
        field[at + 10 * LANES],
        field[at + 11 * LANES],
    )
    return R, r


@kernel(inline=True)
def triple(rows, i, first):
    """Three numbers of a row as a vector."""
    return rows[i, first], rows[i, first + 1], rows[i, first + 2]


@kernel(inline=True)
def matrix_pose(poses, row):
    """(R, r) of one of the poses (rows, 4, 4)."""
    g = poses[row]
    first = triple(g, 0, 0)
    second = triple(g, 1, 0)
    third = triple(g, 2, 0)
    r = (g[0, 3], g[1, 3], g[2, 3])
    return first + second + third, r


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
    R = (b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7], b[8])
    return R, (b[9], b[10], b[11])


@kernel
def chain(packs, base, kinematics):
    """Products of the interval poses, one after the other from the base."""
    R, r = pose_of_base(base)
    for pack in range(packs):
        for i in range(LANES):
            at = pack * 12 * LANES + i
            _scatter(kinematics.start, at, R, r)
            R_step, r_step = _gather(kinematics.relative, at)
            r = plus(r, rotate(R, r_step))
            R = matmul(R, R_step)
            _scatter(kinematics.pose, at, R, r)


@kernel(inline=True)
def twist_at(field, block, lane_index):
    """Twist-shaped numbers of one lane of a field over points or nodes."""
    at = block * 6 * LANES + lane_index
    k_x = field[at]
    k_y = field[at + LANES]
    k_z = field[at + 2 * LANES]
    p_x = field[at + 3 * LANES]
    p_y = field[at + 4 * LANES]
    p_z = field[at + 5 * LANES]
    return (k_x, k_y, k_z), (p_x, p_y, p_z)


@kernel(inline=True)
def strains_at_points(field, interval):
    """Twist-shaped numbers of a field over points at the two points of one interval."""
    block = 2 * (interval // LANES)
    lane_index = interval % LANES
    first = twist_at(field, block, lane_index)
    second = twist_at(field, block + 1, lane_index)
    return first, second


@kernel(inline=True)
def strains_of_part(h, interval, part, xi):
    """Strains at the two points of the first `part` of an interval of length h.

    They are linear between the interval's own two.
    """
    # the points are sqrt(3)/6 of a length from its middle, so h / sqrt(3) apart
    xi_1, xi_2 = strains_at_points(xi, interval)
    difference = twist_difference(xi_2, xi_1)
    slope = scale_twist(math.sqrt(3.0) / h, difference)
    mean = scale_twist(0.5, twist_sum(xi_1, xi_2))
    from_middle = scale_twist(0.5 * (part - h), slope)
    middle = twist_sum(mean, from_middle)
    reach = scale_twist(part * math.sqrt(3.0) / 6.0, slope)
    return twist_difference(middle, reach), twist_sum(middle, reach)


@kernel(inline=True)
def pose_at(field, node):
    """Pose (R, r) of one node, or of the start of its interval, as numbers."""
    return _gather(field, node // LANES * 12 * LANES + node % LANES)


@kernel
def poses_inside(length, interval, distance, xi, kinematics, out):
    """Poses out (m, 4, 4) at `distance` (m,) from the start of the intervals (m,).

    The strain is linear between the two points.
    """
    for m in range(interval.size):
        i = interval[m]
        part = distance[m]
        xi_1, xi_2 = strains_of_part(length[i], i, part, xi)
        Omega = magnus(part, xi_1, xi_2)
        R_start, r_start = pose_at(kinematics.start, i)
        R, r = pose_step(R_start, r_start, Omega)
        write_pose(R, r, out[m])


@kernel(inline=True)
def share_of_second(length, interval, distance):
    """Share of an interval's second point in what is linear between its two.

    It is at a distance from the interval's start.
    """
    return math.sqrt(3.0) * (distance / length[interval] - 0.5) + 0.5


@kernel
def strains_inside(length, interval, distance, field, out):
    """A field over points as out (m, 6) at `distance` (m,) from the start of intervals (m,).

    It is linear between their two points.
    """
    for m in range(interval.size):
        i = interval[m]
        share = share_of_second(length, i, distance[m])
        xi_1, xi_2 = strains_at_points(field, i)
        first = scale_twist(1.0 - share, xi_1)
        second = scale_twist(share, xi_2)
        write_twist(twist_sum(first, second), out[m])


@kernel
def columns_inside(length, interval, distance, columns, out):
    """Fields (n, ...) over points as out (n, m, 6), each as in `strains_inside`."""
    for k in range(len(columns)):
        strains_inside(length, interval, distance, columns[k], out[k])


class IntervalOperators(NamedTuple):
    """Operators of the intervals of a pack, pairs (A, C), in the base frame.

    It also has Omega and its coefficients.
    """

    W_1: tuple[tuple[float, ...], tuple[float, ...]]  # Ad_g T (half - kappa ad_xi2)
    W_2: tuple[tuple[float, ...], tuple[float, ...]]  # Ad_g T (half + kappa ad_xi1)
    Ad_T: tuple[tuple[float, ...], tuple[float, ...]]  # Ad_g T
    Omega: tuple[tuple[float, ...], tuple[float, ...]]
    c: Coefficients


@kernel(inline=True)
def interval_operators(h, half, kappa, xi_1, xi_2, R, r):
    """IntervalOperators, for a pose (R, r) at the start of the interval."""
    Omega = magnus(h, xi_1, xi_2)
    c = angle_coefficients(Omega)
    # Ad_g T = [[R, 0], [r~ R, R]] [[T, 0], [T_dual, T]]
    T, T_dual = dexp_operator(Omega, c)
    A = matmul(R, T)
    C = matrix_sum(matmul(R, T_dual), skew_times(r, A))
    # [[A, 0], [C, A]] ad_xi = [[A k~, 0], [C k~ + A p~, A k~]]
    k_1, p_1 = xi_1
    k_2, p_2 = xi_2
    A_ad_1 = times_skew(A, k_1)
    A_ad_2 = times_skew(A, k_2)
    C_ad_1 = matrix_sum(times_skew(C, k_1), times_skew(A, p_1))
    C_ad_2 = matrix_sum(times_skew(C, k_2), times_skew(A, p_2))
    # W_1 = Ad_g T (half - kappa ad_xi2) and W_2 = Ad_g T (half + kappa ad_xi1)
    A_half = scale_matrix(half, A)
    C_half = scale_matrix(half, C)
    A_1 = matrix_sum(A_half, scale_matrix(-kappa, A_ad_2))
    A_2 = matrix_sum(A_half, scale_matrix(kappa, A_ad_1))
    C_1 = matrix_sum(C_half, scale_matrix(-kappa, C_ad_2))
    C_2 = matrix_sum(C_half, scale_matrix(kappa, C_ad_1))
    return IntervalOperators((A_1, C_1), (A_2, C_2), (A, C), Omega, c)


@kernel(inline=True)
def growth_over(operators, x_1, x_2):
    """Growth W_1 x_1 + W_2 x_2 of a sum in the base frame over the intervals of a pack."""
    A_1, C_1 = operators.W_1
    A_2, C_2 = operators.W_2
    first = operator_apply(A_1, C_1, x_1)
    second = operator_apply(A_2, C_2, x_2)
    return twist_sum(first, second)


@kernel(inline=True)
def running_sum(carry, row, x):
    """Sums of x over the intervals up to each lane, on top of the carried one.

    That moves on to the pack's end.
    """
    at = row * 6
    (k_x, k_y, k_z), (p_x, p_y, p_z) = x
    k = (
        prefix_sum(k_x) + carry[at],
        prefix_sum(k_y) + carry[at + 1],
        prefix_sum(k_z) + carry[at + 2],
    )
    p = (
        prefix_sum(p_x) + carry[at + 3],
        prefix_sum(p_y) + carry[at + 4],
        prefix_sum(p_z) + carry[at + 5],
    )
    last = LANES - 1
    for i in range(3):
        carry[at + i] = lane(k[i], last)
        carry[at + 3 + i] = lane(p[i], last)
    return k, p


@kernel(inline=True)
def carried_sum(carry, row):
    """The carried sum in every lane."""
    at = 6 * row
    k, p = twist_of(carry[at : at + 6])
    return spread_vector(k), spread_vector(p)


@kernel(inline=True)
def spread_vector(x):
    """A vector of numbers in every lane."""
    return spread(x[0]), spread(x[1]), spread(x[2])


@kernel
def sweep(rod, law, strain, kinematics):
    """Twist eta = J q_dot at every node, its bias J_dot q_dot, and the columns of J (17)-(18).

    It runs after poses().
    """
    n = law.size
    packs = rod.packs
    carry = kinematics.carry
    # sums begin at zero, those of eta and of its bias at twist and acceleration of the base
    carry[:] = 0.0
    copy(kinematics.base[12:24], carry[n * 6 : (n + 2) * 6])
    for pack in range(packs):
        h = load(rod.length, pack * LANES)
        kappa = KAPPA * h * h
        xi_1, xi_2 = interval_strains(strain.xi, pack)
        R, r = load_pose(kinematics.start, pack)
        R_end, r_end = load_pose(kinematics.pose, pack)
        operators = interval_operators(h, 0.5 * h, kappa, xi_1, xi_2, R, r)

        # eta (17)
        rate_1, rate_2 = interval_strains(strain.xi_dot, pack)
        growth = growth_over(operators, rate_1, rate_2)
        eta_end = running_sum(carry, n, growth)
        eta_start = twist_difference(eta_end, growth)
        eta = Ad_inverse_apply(R_end, r_end, eta_end)
        store6(kinematics.eta, pack, eta)

        # J_dot q_dot (18): rates of Z and of T at constant xi_dot, xi_bias, and the turning frame
        A, C = operators.Ad_T
        Omega_dot = zanna(h, xi_1, xi_2, rate_1, rate_2)
        bracket = ad_apply(rate_1, rate_2)
        bracket_rate = scale_twist(2.0 * KAPPA * h * h, bracket)
        turned = dexp_dot_apply(operators.Omega, Omega_dot, operators.c, Omega_dot)
        change = operator_apply(A, C, bracket_rate)
        change = twist_sum(change, Ad_apply(R, r, turned))
        bias_1, bias_2 = interval_strains(strain.xi_bias, pack)
        change = twist_sum(change, growth_over(operators, bias_1, bias_2))
        change = twist_sum(change, ad_apply(eta_start, growth))
        bias_end = running_sum(carry, n + 1, change)
        eta_bias = Ad_inverse_apply(R_end, r_end, bias_end)
        store6(kinematics.eta_bias, pack, eta_bias)

        # J
        for j in range(n):
            if law.pack_begin[j] > pack:
                continue
            row = j * packs + pack
            if pack < law.pack_end[j]:
                phi_1, phi_2 = interval_strains(strain.Phi, row)
                of_column = growth_over(operators, phi_1, phi_2)
                column_end = running_sum(carry, j, of_column)
            else:
                column_end = carried_sum(carry, j)
            column = Ad_inverse_apply(R_end, r_end, column_end)
            store6(kinematics.J, row, column)


@kernel
def node_twists(rod, strain, kinematics):
    """Body twists eta at the nodes from xi_dot; after poses().

    As sweep() has them, without columns.
    """
    carry = kinematics.carry
    copy(kinematics.base[12:18], carry[:6])
    for pack in range(rod.packs):
        h = load(rod.length, pack * LANES)
        kappa = KAPPA * h * h
        xi_1, xi_2 = interval_strains(strain.xi, pack)
        rate_1, rate_2 = interval_strains(strain.xi_dot, pack)
        R, r = load_pose(kinematics.start, pack)
        R_end, r_end = load_pose(kinematics.pose, pack)
        operators = interval_operators(h, 0.5 * h, kappa, xi_1, xi_2, R, r)
        growth = growth_over(operators, rate_1, rate_2)
        eta_end = running_sum(carry, 0, growth)
        eta = Ad_inverse_apply(R_end, r_end, eta_end)
        store6(kinematics.eta, pack, eta)


@kernel(inline=True)
def tip_twist_of(eta):
    """Body twist (angular, linear) of the last node as numbers."""
    return twist_at(eta, eta.size // (6 * LANES) - 1, LANES - 1)
