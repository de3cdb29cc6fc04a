"""Generalised force of a wrench at the end of a Magnus interval on its two strains, and its first and second derivatives along a motion.

The displacement of the end in the frame of the start is T Z(delta xi), see kinematics, so that a wrench psi there does the work
t . Z(delta xi) with t = T^T psi. Over the weight h / 2, Z_1 = 1 - mu ad_xi2 and Z_2 = 1 + mu ad_xi1, mu = sqrt(3) h / 6. As in
algebra/lie the formulas are those of SO(3) over the dual numbers: a wrench (m, f) is the dual vector f + eps m, and
T^T psi = psi - a k x psi + b k x (k x psi).
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import (
    ad_apply,
    dot,
    matrix_scaled,
    matrix_sum,
    skew_times,
    third_coefficients,
    times_skew,
    twist_scaled,
    twist_sum,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import dual_times, swapped


@kernel(inline=True)
def dual_dot(x, y):
    """Scalar product of dual vectors."""
    return dot(x[0], y[0]), dot(x[0], y[1]) + dot(x[1], y[0])


@kernel(inline=True)
def dual_product(s, t):
    """Product of dual numbers."""
    return s[0] * t[0], s[0] * t[1] + s[1] * t[0]


@kernel(inline=True)
def dual_sum(s, t):
    """Sum of dual numbers."""
    return s[0] + t[0], s[1] + t[1]


@kernel(inline=True)
def _symmetric_outer(v, k):
    """Symmetric outer product (v k^T + k v^T) / 2."""
    xy, xz, yz = 0.5 * (v[0] * k[1] + v[1] * k[0]), 0.5 * (v[0] * k[2] + v[2] * k[0]), 0.5 * (v[1] * k[2] + v[2] * k[1])
    return v[0] * k[0], xy, xz, xy, v[1] * k[1], yz, xz, yz, v[2] * k[2]


@kernel(inline=True)
def _with_diagonal(A, s):
    """Sum A + s I."""
    return A[0] + s, A[1], A[2], A[3], A[4] + s, A[5], A[6], A[7], A[8] + s


@kernel(inline=True)
def dexp_curvature(Omega, c, psi):
    """Symmetric dual matrix D = (A, C) with psi . T_dot[x] x = x . D x, the derivative of T along x: x_k C x_k + 2 x_k A x_p."""
    kp, w = dot(Omega[0], Omega[1]), swapped(psi)
    once = ad_apply(Omega, w)
    v = dual_times((-c.a1, -c.a2 * kp), once)
    v = twist_sum(v, dual_times((c.b1, c.b2 * kp), ad_apply(Omega, once)))
    v = twist_sum(v, dual_times((-c.b, -c.b1 * kp), w))
    s = dual_product((c.b, c.b1 * kp), dual_dot(Omega, w))
    A = _with_diagonal(_symmetric_outer(v[0], Omega[0]), s[0])
    C = matrix_sum(_symmetric_outer(v[0], Omega[1]), _symmetric_outer(v[1], Omega[0]))
    return A, _with_diagonal(C, s[1])


@kernel(inline=True)
def times_zanna(D, mu, xi):
    """Product D (1 + mu ad_xi) of dual matrices."""
    A, C = D
    return (
        matrix_sum(A, matrix_scaled(mu, times_skew(A, xi[0]))),
        matrix_sum(C, matrix_scaled(mu, matrix_sum(times_skew(C, xi[0]), times_skew(A, xi[1])))),
    )


@kernel(inline=True)
def zanna_times(mu, xi, D):
    """Product (1 + mu ad_xi)^T D of dual matrices."""
    A, C = D
    return (
        matrix_sum(A, matrix_scaled(-mu, skew_times(xi[0], A))),
        matrix_sum(C, matrix_scaled(-mu, matrix_sum(skew_times(xi[0], C), skew_times(xi[1], A)))),
    )


@kernel(inline=True)
def transposed_dexp_jet(Omega, Omega_dot, Omega_ddot, c, psi, psi_dot, psi_ddot):
    """First and second derivative of T^T psi along a motion."""
    w, w_dot, w_ddot = swapped(psi), swapped(psi_dot), swapped(psi_ddot)
    kp = dot(Omega[0], Omega[1])
    a3, b3 = third_coefficients(dot(Omega[0], Omega[0]), c)
    rate = dual_dot(Omega, Omega_dot)
    rate_dot = dual_sum(dual_dot(Omega_dot, Omega_dot), dual_dot(Omega, Omega_ddot))
    squared = dual_product(rate, rate)
    a, a_dot = (c.a, c.a1 * kp), dual_product((c.a1, c.a2 * kp), rate)
    b, b_dot = (c.b, c.b1 * kp), dual_product((c.b1, c.b2 * kp), rate)
    a_ddot = dual_sum(dual_product((c.a2, a3 * kp), squared), dual_product((c.a1, c.a2 * kp), rate_dot))
    b_ddot = dual_sum(dual_product((c.b2, b3 * kp), squared), dual_product((c.b1, c.b2 * kp), rate_dot))
    once = ad_apply(Omega, w)
    once_dot = twist_sum(ad_apply(Omega_dot, w), ad_apply(Omega, w_dot))
    once_ddot = twist_sum(twist_sum(ad_apply(Omega_ddot, w), ad_apply(Omega, w_ddot)), twist_scaled(2.0, ad_apply(Omega_dot, w_dot)))
    twice = ad_apply(Omega, once)
    twice_dot = twist_sum(ad_apply(Omega_dot, once), ad_apply(Omega, once_dot))
    twice_ddot = twist_sum(ad_apply(Omega_ddot, once), ad_apply(Omega, once_ddot))
    twice_ddot = twist_sum(twice_ddot, twist_scaled(2.0, ad_apply(Omega_dot, once_dot)))
    t_dot = twist_sum(w_dot, _leibniz(b_dot, b, twice, twice_dot))
    t_dot = twist_sum(t_dot, twist_scaled(-1.0, _leibniz(a_dot, a, once, once_dot)))
    t_ddot = twist_sum(w_ddot, _second_leibniz(b_ddot, b_dot, b, twice, twice_dot, twice_ddot))
    t_ddot = twist_sum(t_ddot, twist_scaled(-1.0, _second_leibniz(a_ddot, a_dot, a, once, once_dot, once_ddot)))
    return swapped(t_dot), swapped(t_ddot)


@kernel(inline=True)
def _leibniz(s_dot, s, x, x_dot):
    return twist_sum(dual_times(s_dot, x), dual_times(s, x_dot))


@kernel(inline=True)
def _second_leibniz(s_ddot, s_dot, s, x, x_dot, x_ddot):
    return twist_sum(twist_sum(dual_times(s_ddot, x), dual_times(s, x_ddot)), twist_scaled(2.0, dual_times(s_dot, x_dot)))
