"""Lie group SE(3): exponential, logarithm, adjoint and tangent operators in apply form, on numbers
or on packs.

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
    """The functions of theta^2 in exp and T: a = (1 - cos)/theta^2, b = (theta - sin)/theta^3, and
    f1 = 2 df/d(theta^2)."""

    a: float
    b: float
    a1: float
    b1: float
    a2: float
    b2: float


def _taylor_table():
    """Rows a, b, a1, b1, a2, b2: coefficients of theta^(2m), highest m first."""
    terms = range(SERIES_TERMS + 2)
    a = [(-1) ** m / math.factorial(2 * m + 2) for m in terms]
    b = [(-1) ** m / math.factorial(2 * m + 3) for m in terms]
    rows = [a, b]
    for _ in range(2):
        a, b = ([2 * (m + 1) * f[m + 1] for m in range(len(f) - 1)] for f in (a, b))
        rows += [a, b]
    return tuple(tuple(reversed(row[:SERIES_TERMS])) for row in rows)


_TAYLOR = _taylor_table()
_A, _B, _A1, _B1, _A2, _B2 = _TAYLOR


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
    """Closed forms, each from the last: f1 = (g - n f) / theta^2, with g the next function of the
    same family."""
    theta = math.sqrt(x)
    s = math.sin(theta) / theta
    a = 2.0 * math.sin(0.5 * theta) ** 2 / x
    b = (1.0 - s) / x
    a1 = (s - 2.0 * a) / x
    b1 = (a - 3.0 * b) / x
    return Coefficients(a, b, a1, b1, (b - a - 4.0 * a1) / x, (a1 - 5.0 * b1) / x)


def coefficients(x):
    """Coefficients at x = theta^2 (float or pack), to 1e-12 relative at any angle (b2 just above
    the switch is the worst, 3e-13)."""
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
    a, b, a1, b1, a2, b2 = x, x, x, x, x, x
    for i in range(LANES):
        c = _coefficients_number(lane(x, i))
        a, b = with_lane(a, i, c.a), with_lane(b, i, c.b)
        a1, b1 = with_lane(a1, i, c.a1), with_lane(b1, i, c.b1)
        a2, b2 = with_lane(a2, i, c.a2), with_lane(b2, i, c.b2)
    return Coefficients(a, b, a1, b1, a2, b2)


@overload(coefficients)
def _coefficients_overload(x):
    if isinstance(x, Pack):
        return lambda x: _coefficients_pack(x)
    return lambda x: _coefficients_number(x)


@kernel(inline=True)
def dot(x, y):
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@kernel(inline=True)
def cross(x, y):
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]


@kernel(inline=True)
def plus(x, y):
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@kernel(inline=True)
def minus(x, y):
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@kernel(inline=True)
def times(s, x):
    return s * x[0], s * x[1], s * x[2]


@kernel(inline=True)
def rotate(R, x):
    return dot(R[0:3], x), dot(R[3:6], x), dot(R[6:9], x)


@kernel(inline=True)
def rotate_back(R, x):
    return dot(R[0::3], x), dot(R[1::3], x), dot(R[2::3], x)


@kernel(inline=True)
def columns_of(x, y, z):
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@kernel(inline=True)
def matmul(A, B):
    x = rotate(A, (B[0], B[3], B[6]))
    y = rotate(A, (B[1], B[4], B[7]))
    z = rotate(A, (B[2], B[5], B[8]))
    return columns_of(x, y, z)


@kernel(inline=True)
def skew_times(x, B):
    """Product x~ B of a skew matrix and a matrix."""
    return columns_of(
        cross(x, (B[0], B[3], B[6])), cross(x, (B[1], B[4], B[7])), cross(x, (B[2], B[5], B[8]))
    )


@kernel(inline=True)
def times_skew(A, x):
    """Product A x~ of a matrix and a skew matrix."""
    u, v, w = (A[0], A[3], A[6]), (A[1], A[4], A[7]), (A[2], A[5], A[8])
    return columns_of(
        minus(times(x[2], v), times(x[1], w)),
        minus(times(x[0], w), times(x[2], u)),
        minus(times(x[1], u), times(x[0], v)),
    )


@kernel(inline=True)
def matrix_sum(A, B):
    return (
        A[0] + B[0],
        A[1] + B[1],
        A[2] + B[2],
        A[3] + B[3],
        A[4] + B[4],
        A[5] + B[5],
        A[6] + B[6],
        A[7] + B[7],
        A[8] + B[8],
    )


@kernel(inline=True)
def scale_matrix(s, A):
    return s * A[0], s * A[1], s * A[2], s * A[3], s * A[4], s * A[5], s * A[6], s * A[7], s * A[8]


@kernel(inline=True)
def rodrigues(f, g, k):
    """Matrix I + f k~ + g k~^2: a rotation, or its tangent operator, by Rodrigues' formula."""
    x, y, z = k
    xx, yy, zz, xy, xz, yz = g * x * x, g * y * y, g * z * z, g * x * y, g * x * z, g * y * z
    fx, fy, fz = f * x, f * y, f * z
    return (
        1.0 - yy - zz,
        xy - fz,
        xz + fy,
        xy + fz,
        1.0 - xx - zz,
        yz - fx,
        xz - fy,
        yz + fx,
        1.0 - xx - yy,
    )


@kernel(inline=True)
def twist_sum(x, y):
    return plus(x[0], y[0]), plus(x[1], y[1])


@kernel(inline=True)
def scale_twist(s, x):
    return times(s, x[0]), times(s, x[1])


@kernel(inline=True)
def ad_apply(x, y):
    """Lie bracket ad_x y of twists (Appendix A)."""
    return cross(x[0], y[0]), plus(cross(x[1], y[0]), cross(x[0], y[1]))


@kernel(inline=True)
def coad_apply(x, w):
    """Coadjoint ad*_x w = -ad_x^T w of a wrench w (Appendix A)."""
    return plus(cross(x[0], w[0]), cross(x[1], w[1])), cross(x[0], w[1])


@kernel(inline=True)
def operator_apply(A, C, x):
    """Product [[A, 0], [C, A]] x of a 6x6 operator and a twist."""
    return rotate(A, x[0]), plus(rotate(C, x[0]), rotate(A, x[1]))


@kernel(inline=True)
def Ad_apply(R, r, x):
    """Adjoint Ad_g x: a twist x of the frame g seen in the base frame (Appendix A)."""
    k = rotate(R, x[0])
    return k, plus(cross(r, k), rotate(R, x[1]))


@kernel(inline=True)
def Ad_inverse_apply(R, r, x):
    """Inverse adjoint Ad_g^-1 x: a twist x of the base frame seen in the frame g."""
    return rotate_back(R, x[0]), rotate_back(R, minus(x[1], cross(r, x[0])))


@kernel(inline=True)
def exp_se3(Omega, c):
    """Pose (R, r) = exp(Omega^) (Appendix B); c = coefficients(|k|^2)."""
    k, p = Omega
    R = rodrigues(1.0 - c.b * dot(k, k), c.a, k)
    u = cross(k, p)
    return R, plus(p, plus(times(c.a, u), times(c.b, cross(k, u))))


@kernel(inline=True)
def dexp_operator(Omega, c):
    """The tangent operator T_Omega as the pair (A, C) (Appendix B)."""
    k, p = Omega
    kp = dot(k, p)
    x, y, z = k
    u, v, w = p
    A = rodrigues(c.a, c.b, k)
    # C = a p~ + b (k~ p~ + p~ k~) + (k.p) (a1 k~ + b1 k~^2), with k~ p~ + p~ k~ = k p^T + p k^T - 2
    # (k.p) I
    f, g, e = c.a1 * kp, c.b1 * kp, -2.0 * c.b * kp
    sx, sy, sz = c.a * u + f * x, c.a * v + f * y, c.a * w + f * z
    xy, xz, yz = (
        c.b * (x * v + y * u) + g * x * y,
        c.b * (x * w + z * u) + g * x * z,
        c.b * (y * w + z * v) + g * y * z,
    )
    xx = e + 2.0 * c.b * x * u - g * (y * y + z * z)
    yy = e + 2.0 * c.b * y * v - g * (x * x + z * z)
    zz = e + 2.0 * c.b * z * w - g * (x * x + y * y)
    return A, (xx, xy - sz, xz + sy, xy + sz, yy, yz - sx, xz - sy, yz + sx, zz)


@kernel(inline=True)
def dexp_dot_apply(Omega, Omega_dot, c, x):
    """Derivative T_dot x of the tangent operator, along Omega_dot with x held (Appendix B,
    corrected)."""
    kp = dot(Omega[0], Omega[1])
    rate = dot(Omega[0], Omega_dot[0])  # d(theta^2)/dt / 2, its dual part next
    rate_dual = dot(Omega[0], Omega_dot[1]) + dot(Omega[1], Omega_dot[0])
    once = ad_apply(Omega, x)
    twice = ad_apply(Omega, once)
    turned = ad_apply(Omega_dot, x)
    mixed = twist_sum(ad_apply(Omega_dot, once), ad_apply(Omega, turned))
    a_dot, b_dot = c.a1 * rate, c.b1 * rate
    a_dual, b_dual = c.a2 * kp * rate + c.a1 * rate_dual, c.b2 * kp * rate + c.b1 * rate_dual
    y = twist_sum(
        twist_sum(scale_twist(a_dot, once), scale_twist(b_dot, twice)),
        twist_sum(scale_twist(c.a, turned), scale_twist(c.b, mixed)),
    )
    dual = plus(
        plus(times(a_dual, once[0]), times(b_dual, twice[0])),
        plus(times(c.a1 * kp, turned[0]), times(c.b1 * kp, mixed[0])),
    )
    return y[0], plus(y[1], dual)


@kernel
def rotation_log(R):
    """Rotation vector of R (9-tuple of floats), by the largest quaternion component: exact near 0
    and near pi."""
    trace = R[0] + R[4] + R[8]
    if trace >= R[0] and trace >= R[4] and trace >= R[8]:
        w, x, y, z = 1.0 + trace, R[7] - R[5], R[2] - R[6], R[3] - R[1]
    elif R[0] >= R[4] and R[0] >= R[8]:
        w, x, y, z = R[7] - R[5], 1.0 + 2.0 * R[0] - trace, R[1] + R[3], R[2] + R[6]
    elif R[4] >= R[8]:
        w, x, y, z = R[2] - R[6], R[1] + R[3], 1.0 + 2.0 * R[4] - trace, R[5] + R[7]
    else:
        w, x, y, z = R[3] - R[1], R[2] + R[6], R[5] + R[7], 1.0 + 2.0 * R[8] - trace
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = sqrt(x * x + y * y + z * z)
    factor = (
        2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 2.0 / w
    )  # the squares of a tiny rotation underflow
    return factor * x, factor * y, factor * z


@kernel
def log_se3(R, r):
    """Twist Omega with exp(Omega^) = (R, r) (floats), |k| <= pi: the robust logarithm that replaces
    Appendix B's closed form."""
    k = rotation_log(R)
    x = dot(k, k)
    c = coefficients(x)
    u = cross(k, r)
    # the inverse of T on SO(3) is I - k~/2 + e k~^2 with e = -a1 / (2 a)
    return k, plus(minus(r, times(0.5, u)), times(-0.5 * c.a1 / c.a, cross(k, u)))
