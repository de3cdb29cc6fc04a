"""Lie group SE(3): exponential, logarithm, adjoint and tangent operators in apply form.

They work on numbers or on packs.

Conventions, once for the whole package (paper, Appendices A and B): a twist is the pair `(k, p)`,
angular first, of two 3-tuples; a wrench is `(moment, force)`; a rotation is the 9-tuple of its
rows. `exp` carries a twist Omega to the pose (R, r), and the tangent operator T is the one of the
paper, T = sum ad^n / (n + 1)!, so that the body twist of exp(Omega(t)) is Ad^-1 T Omega_dot.

Every 6x6 operator here (Ad, ad, T) has the shape [[A, 0], [C, A]]. It is kept as the pair `(A, C)`:
a 3x3 matrix over the dual numbers A + eps C, as a twist is a 3-vector k + eps p. The SO(3) formulas
then hold for SE(3) as they stand, with theta^2 = |k|^2 + 2 eps k.p, and no closed form of a 6x6
matrix is needed.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, Pack, lane, largest, sqrt, with_lane

SERIES_LIMIT = 1.0  # theta^2 below which the coefficients come from their Taylor series
SERIES_TERMS = 11  # the last one is below 1e-20 of the first at the limit


class Coefficients(NamedTuple):
    """Coefficients of exp and T, functions of theta^2.

    a = (1 - cos)/theta^2, b = (theta - sin)/theta^3, and f1 = 2 df/d(theta^2).
    """

    a: float
    b: float
    a1: float
    b1: float
    a2: float
    b2: float


def _taylor_table():
    """Rows a, b, a1, b1, a2, b2: coefficients of theta^(2m), highest m first."""
    # a = sum (-1)^m theta^(2m) / (2m + 2)!, b = sum (-1)^m theta^(2m) / (2m + 3)!
    terms = range(SERIES_TERMS + 2)  # each derivative takes one off
    a = [(-1) ** m / math.factorial(2 * m + 2) for m in terms]
    b = [(-1) ** m / math.factorial(2 * m + 3) for m in terms]
    a1 = _twice_derivative(a)
    b1 = _twice_derivative(b)
    a2 = _twice_derivative(a1)
    b2 = _twice_derivative(b1)
    rows = (a, b, a1, b1, a2, b2)
    return [tuple(reversed(row[:SERIES_TERMS])) for row in rows]


def _twice_derivative(series):
    """Coefficients of 2 df/dx, of those of f(x)."""
    return [2 * m * series[m] for m in range(1, len(series))]


_TAYLOR = _taylor_table()
_A = _TAYLOR[0]
_B = _TAYLOR[1]
_A1 = _TAYLOR[2]
_B1 = _TAYLOR[3]
_A2 = _TAYLOR[4]
_B2 = _TAYLOR[5]


@kernel(inline=True)
def _horner(row, x):
    value = row[0] + 0.0 * x
    for m in range(1, SERIES_TERMS):
        value = value * x + row[m]
    return value


@kernel(inline=True)
def _series(x):
    return Coefficients(
        _horner(_A, x),
        _horner(_B, x),
        _horner(_A1, x),
        _horner(_B1, x),
        _horner(_A2, x),
        _horner(_B2, x),
    )


@kernel
def _closed(x):
    """Closed forms, each from the last: f1 = (g - n f) / theta^2.

    g is the next function of the same family.
    """
    theta = math.sqrt(x)
    s = math.sin(theta) / theta
    a = 2.0 * math.sin(0.5 * theta) ** 2 / x
    b = (1.0 - s) / x
    a1 = (s - 2.0 * a) / x
    b1 = (a - 3.0 * b) / x
    a2 = (b - a - 4.0 * a1) / x
    b2 = (a1 - 5.0 * b1) / x
    return Coefficients(a, b, a1, b1, a2, b2)


def coefficients(x):
    """Coefficients at x = theta^2 (float or pack), to 1e-12 relative at any angle.

    b2 just above the switch is the worst, 3e-13.
    """
    if np.max(x) < SERIES_LIMIT:
        return _series(x)
    if np.ndim(x):
        return Coefficients(*np.array([coefficients(number) for number in x]).T)
    return _closed(x)


@kernel
def _coefficients_number(x):
    return _series(x) if x < SERIES_LIMIT else _closed(x)


@kernel
def _coefficients_pack(x):
    if largest(x) < SERIES_LIMIT:
        return _series(x)
    # lane by lane, in packs whose lanes are all written over
    a = x
    b = x
    a1 = x
    b1 = x
    a2 = x
    b2 = x
    for i in range(LANES):
        c = _coefficients_number(lane(x, i))
        a = with_lane(a, i, c.a)
        b = with_lane(b, i, c.b)
        a1 = with_lane(a1, i, c.a1)
        b1 = with_lane(b1, i, c.b1)
        a2 = with_lane(a2, i, c.a2)
        b2 = with_lane(b2, i, c.b2)
    return Coefficients(a, b, a1, b1, a2, b2)


@overload(coefficients)
def _coefficients_overload(x):
    if isinstance(x, Pack):
        return lambda x: _coefficients_pack(x)
    return lambda x: _coefficients_number(x)


@kernel(inline=True)
def dot(x, y):
    """Dot product of two vectors."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@kernel(inline=True)
def cross(x, y):
    """Cross product of two vectors."""
    first = x[1] * y[2] - x[2] * y[1]
    second = x[2] * y[0] - x[0] * y[2]
    third = x[0] * y[1] - x[1] * y[0]
    return first, second, third


@kernel(inline=True)
def plus(x, y):
    """Sum of two vectors."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@kernel(inline=True)
def minus(x, y):
    """Difference of two vectors."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@kernel(inline=True)
def times(s, x):
    """Product of a number and a vector."""
    return s * x[0], s * x[1], s * x[2]


@kernel(inline=True)
def rotate(R, x):
    """Product R x of a matrix and a vector."""
    return dot(R[0:3], x), dot(R[3:6], x), dot(R[6:9], x)


@kernel(inline=True)
def rotate_back(R, x):
    """Product R^T x of a transposed matrix and a vector."""
    return dot(R[0::3], x), dot(R[1::3], x), dot(R[2::3], x)


@kernel(inline=True)
def columns_of(A):
    """Columns of a matrix, three vectors."""
    return A[0::3], A[1::3], A[2::3]


@kernel(inline=True)
def matrix_of(x, y, z):
    """Matrix of three columns."""
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@kernel(inline=True)
def matmul(A, B):
    """Product A B of two matrices."""
    x, y, z = columns_of(B)
    return matrix_of(rotate(A, x), rotate(A, y), rotate(A, z))


@kernel(inline=True)
def skew_times(k, B):
    """Product k~ B of a skew matrix and a matrix."""
    x, y, z = columns_of(B)
    return matrix_of(cross(k, x), cross(k, y), cross(k, z))


@kernel(inline=True)
def times_skew(A, k):
    """Product A k~ of a matrix and a skew matrix."""
    x, y, z = columns_of(A)
    # the columns of k~ are (0, k_z, -k_y), (-k_z, 0, k_x), (k_y, -k_x, 0)
    first = minus(times(k[2], y), times(k[1], z))
    second = minus(times(k[0], z), times(k[2], x))
    third = minus(times(k[1], x), times(k[0], y))
    return matrix_of(first, second, third)


@kernel(inline=True)
def matrix_sum(A, B):
    """Sum of two matrices."""
    first = plus(A[0:3], B[0:3])
    second = plus(A[3:6], B[3:6])
    third = plus(A[6:9], B[6:9])
    return first + second + third


@kernel(inline=True)
def scale_matrix(s, A):
    """Product of a number and a matrix."""
    return times(s, A[0:3]) + times(s, A[3:6]) + times(s, A[6:9])


@kernel(inline=True)
def rodrigues(f, g, k):
    """Matrix I + f k~ + g k~^2: a rotation, or its tangent operator, by Rodrigues' formula."""
    # k~^2 = k k^T - |k|^2 I, of which the diagonal is -(y^2 + z^2), -(x^2 + z^2), -(x^2 + y^2)
    x, y, z = k
    fx = f * x
    fy = f * y
    fz = f * z
    gxx = g * x * x
    gyy = g * y * y
    gzz = g * z * z
    gxy = g * x * y
    gxz = g * x * z
    gyz = g * y * z
    return (
        1.0 - gyy - gzz,
        gxy - fz,
        gxz + fy,
        gxy + fz,
        1.0 - gxx - gzz,
        gyz - fx,
        gxz - fy,
        gyz + fx,
        1.0 - gxx - gyy,
    )


@kernel(inline=True)
def twist_sum(x, y):
    """Sum of two twists or wrenches."""
    return plus(x[0], y[0]), plus(x[1], y[1])


@kernel(inline=True)
def scale_twist(s, x):
    """Product of a number and a twist or wrench."""
    return times(s, x[0]), times(s, x[1])


@kernel(inline=True)
def twist_difference(x, y):
    """Twist or wrench x - y."""
    return twist_sum(x, scale_twist(-1.0, y))


@kernel(inline=True)
def twist_of(x):
    """Six numbers in a row as a twist or a wrench."""
    return (x[0], x[1], x[2]), (x[3], x[4], x[5])


@kernel(inline=True)
def write_twist(x, out):
    """Writes a twist or a wrench as six numbers in a row."""
    for i in range(3):
        out[i] = x[0][i]
        out[3 + i] = x[1][i]


@kernel(inline=True)
def ad_apply(x, y):
    """Lie bracket ad_x y of twists (Appendix A)."""
    # ad_(k, p) (u, v) = (k x u, p x u + k x v)
    linear = plus(cross(x[1], y[0]), cross(x[0], y[1]))
    angular = cross(x[0], y[0])
    return angular, linear


@kernel(inline=True)
def coad_apply(x, w):
    """Coadjoint ad*_x w = -ad_x^T w of a wrench w (Appendix A)."""
    # ad*_(k, p) (m, f) = (k x m + p x f, k x f)
    k, p = x
    own_moment, own_force = w
    moment = plus(cross(k, own_moment), cross(p, own_force))
    force = cross(k, own_force)
    return moment, force


@kernel(inline=True)
def operator_apply(A, C, x):
    """Product [[A, 0], [C, A]] x of a 6x6 operator and a twist."""
    k, p = x
    angular = rotate(A, k)
    linear = plus(rotate(C, k), rotate(A, p))
    return angular, linear


@kernel(inline=True)
def Ad_apply(R, r, x):
    """Adjoint Ad_g x: a twist x of the frame g seen in the base frame (Appendix A)."""
    own_angular, own_linear = x
    angular = rotate(R, own_angular)
    linear = plus(cross(r, angular), rotate(R, own_linear))
    return angular, linear


@kernel(inline=True)
def Ad_inverse_apply(R, r, x):
    """Inverse adjoint Ad_g^-1 x: a twist x of the base frame seen in the frame g."""
    angular, linear = x
    linear_there = minus(linear, cross(r, angular))
    return rotate_back(R, angular), rotate_back(R, linear_there)


@kernel(inline=True)
def angle_coefficients(Omega):
    """Coefficients of a twist, at theta^2 = |k|^2 of its angular part."""
    return coefficients(dot(Omega[0], Omega[0]))


@kernel(inline=True)
def exp_se3(Omega, c):
    """Pose (R, r) = exp(Omega^) (Appendix B); c = angle_coefficients(Omega)."""
    # R = I + sin/theta k~ + a k~^2 and r = (I + a k~ + b k~^2) p
    k, p = Omega
    R = rodrigues(1.0 - c.b * dot(k, k), c.a, k)
    once = cross(k, p)
    twice = cross(k, once)
    turned = plus(times(c.a, once), times(c.b, twice))
    return R, plus(p, turned)


@kernel(inline=True)
def pose_step(R, r, Omega):
    """Pose g exp(Omega^), of a pose g = (R, r)."""
    c = angle_coefficients(Omega)
    R_step, r_step = exp_se3(Omega, c)
    R_next = matmul(R, R_step)
    r_next = plus(r, rotate(R, r_step))
    return R_next, r_next


@kernel(inline=True)
def dexp_operator(Omega, c):
    """The tangent operator T_Omega as the pair (A, C) (Appendix B)."""
    k, p = Omega
    A = rodrigues(c.a, c.b, k)
    # C = a p~ + b (k~ p~ + p~ k~) + (k.p) (a1 k~ + b1 k~^2),
    # with k~ p~ + p~ k~ = k p^T + p k^T - 2 (k.p) I
    x, y, z = k
    u, v, w = p
    kp = dot(k, p)
    f = c.a1 * kp
    g = c.b1 * kp
    e = -2.0 * c.b * kp
    # its skew part, a p~ + f k~
    sx = c.a * u + f * x
    sy = c.a * v + f * y
    sz = c.a * w + f * z
    # its symmetric part, b (k p^T + p k^T) + e I + g k~^2
    xy = c.b * (x * v + y * u) + g * x * y
    xz = c.b * (x * w + z * u) + g * x * z
    yz = c.b * (y * w + z * v) + g * y * z
    twice_b = 2.0 * c.b
    xx = e + twice_b * x * u - g * (y * y + z * z)
    yy = e + twice_b * y * v - g * (x * x + z * z)
    zz = e + twice_b * z * w - g * (x * x + y * y)
    C = (
        xx,
        xy - sz,
        xz + sy,
        xy + sz,
        yy,
        yz - sx,
        xz - sy,
        yz + sx,
        zz,
    )
    return A, C


@kernel(inline=True)
def dexp_dot_apply(Omega, Omega_dot, c, x):
    """Derivative T_dot x of the tangent operator, along Omega_dot with x held.

    Appendix B, corrected.
    """
    # T = I + a ad + b ad^2, so T_dot = a_dot ad + b_dot ad^2 + a ad' + b (ad' ad + ad ad'),
    # where ad' is that of Omega_dot
    once = ad_apply(Omega, x)
    twice = ad_apply(Omega, once)
    turned = ad_apply(Omega_dot, x)
    mixed = twist_sum(ad_apply(Omega_dot, once), ad_apply(Omega, turned))
    # half of d(theta^2)/dt, and its dual part
    k, p = Omega
    k_dot, p_dot = Omega_dot
    kp = dot(k, p)
    rate = dot(k, k_dot)
    rate_dual = dot(k, p_dot) + dot(p, k_dot)
    a_dot = c.a1 * rate
    b_dot = c.b1 * rate
    a_dual = c.a2 * kp * rate + c.a1 * rate_dual
    b_dual = c.b2 * kp * rate + c.b1 * rate_dual
    # numbers times operators, then the dual parts of the numbers, which meet angular parts alone
    by_rate = twist_sum(scale_twist(a_dot, once), scale_twist(b_dot, twice))
    by_turn = twist_sum(scale_twist(c.a, turned), scale_twist(c.b, mixed))
    angular, linear = twist_sum(by_rate, by_turn)
    dual_by_rate = plus(times(a_dual, once[0]), times(b_dual, twice[0]))
    a_turn = c.a1 * kp
    b_turn = c.b1 * kp
    dual_by_turn = plus(times(a_turn, turned[0]), times(b_turn, mixed[0]))
    dual = plus(dual_by_rate, dual_by_turn)
    return angular, plus(linear, dual)


@kernel(inline=True)
def coad_polynomial(Omega, psi, a, b):
    """Wrench psi + a ad* psi + b ad* ad* psi of a wrench psi.

    ad* is that of Omega, and a, b are dual numbers (real, dual).
    """
    once = coad_apply(Omega, psi)
    twice = coad_apply(Omega, once)
    a_real, a_dual = a
    b_real, b_dual = b
    powers = twist_sum(scale_twist(a_real, once), scale_twist(b_real, twice))
    moment, force = twist_sum(psi, powers)
    # the dual parts turn forces into moments
    _, force_once = once
    _, force_twice = twice
    dual = plus(times(a_dual, force_once), times(b_dual, force_twice))
    return plus(moment, dual), force


@kernel(inline=True)
def dexp_transposed_apply(Omega, c, psi):
    """Transposed tangent operator times a wrench, T^T psi, with ad^T = -ad*."""
    kp = dot(Omega[0], Omega[1])
    a = (-c.a, -c.a1 * kp)
    b = (c.b, c.b1 * kp)
    return coad_polynomial(Omega, psi, a, b)


@kernel(inline=True)
def dexp_inverse_transposed_apply(Omega, c, sign, psi):
    """Transposed inverse T^-T psi of the tangent operator of sign Omega.

    T^-1 = I - ad/2 + e ad^2, exact near 0, finite at an angle of pi.
    """
    kp = dot(Omega[0], Omega[1])
    # e = -a1 / (2 a), and its derivative by theta^2 / 2 times the dual part
    e = inverse_coefficient(c)
    e_slope = 0.5 * (c.a1 * c.a1 / c.a - c.a2) / c.a
    half = 0.5 * sign
    return coad_polynomial(Omega, psi, (half, 0.0), (e, e_slope * kp))


@kernel
def quaternion_of(R):
    """Quaternion (w, x, y, z) of R (9-tuple of floats), of any length.

    It is the row of 4 w (w, x, y, z) to 4 z (w, x, y, z) whose square is largest, so that nothing
    cancels; w is not negative.
    """
    trace = R[0] + R[4] + R[8]
    # 4 times products of its components
    wx = R[7] - R[5]
    wy = R[2] - R[6]
    wz = R[3] - R[1]
    xy = R[1] + R[3]
    xz = R[2] + R[6]
    yz = R[5] + R[7]
    ww = 1.0 + trace
    xx = 1.0 + 2.0 * R[0] - trace
    yy = 1.0 + 2.0 * R[4] - trace
    zz = 1.0 + 2.0 * R[8] - trace
    if trace >= R[0] and trace >= R[4] and trace >= R[8]:
        w, x, y, z = ww, wx, wy, wz
    elif R[0] >= R[4] and R[0] >= R[8]:
        w, x, y, z = wx, xx, xy, xz
    elif R[4] >= R[8]:
        w, x, y, z = wy, xy, yy, yz
    else:
        w, x, y, z = wz, xz, yz, zz
    if w < 0.0:
        return -w, -x, -y, -z
    return w, x, y, z


@kernel
def rotation_log(R):
    """Rotation vector of R (9-tuple of floats), by the largest quaternion component.

    It is exact near 0 and near pi.
    """
    w, x, y, z = quaternion_of(R)
    sine = sqrt(x * x + y * y + z * z)
    if sine > 0.0:
        factor = 2.0 * math.atan2(sine, w) / sine
    else:  # the squares of a tiny rotation underflow
        factor = 2.0 / w
    return factor * x, factor * y, factor * z


@kernel
def log_se3(R, r):
    """Twist Omega with exp(Omega^) = (R, r) (floats), |k| <= pi: the robust logarithm.

    It replaces Appendix B's closed form.
    """
    k = rotation_log(R)
    c = coefficients(dot(k, k))
    # the inverse of T on SO(3) is I - k~/2 + e k~^2
    once = cross(k, r)
    twice = cross(k, once)
    e = inverse_coefficient(c)
    without_square = minus(r, times(0.5, once))
    return k, plus(without_square, times(e, twice))


@kernel(inline=True)
def inverse_coefficient(c):
    """Coefficient e of the inverse tangent operator T^-1 = I - ad/2 + e ad^2, -a1 / (2 a)."""
    return -0.5 * c.a1 / c.a
