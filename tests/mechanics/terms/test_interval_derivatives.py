"""What a wrench does on an interval, against the tangent operator T and its differences."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import coefficients, dexp_operator
from soft_tendon_env.mechanics.terms.interval_derivatives import (
    dexp_curvature,
    times_zanna,
    transposed_dexp_jet,
    zanna_times,
)
from soft_tendon_env.mechanics.terms.transposed_kinematics import transposed_dexp, wrench_at_start, zanna_transposed

pytestmark = pytest.mark.no_jit
SIZES = (0.0, 1e-3, 0.3, 1.5, 4.0)  # [rad], on both sides of the series' limit


def twist(x):
    return tuple(x[:3]), tuple(x[3:])


def vector(x):
    return np.array([*x[0], *x[1]])


def skew(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def ad(x):
    return np.block([[skew(x[:3]), np.zeros((3, 3))], [skew(x[3:]), skew(x[:3])]])


def T(Omega):
    A, C = (np.array(part).reshape(3, 3) for part in dexp_operator(twist(Omega), coefficients(float(Omega[:3] @ Omega[:3]))))
    return np.block([[A, np.zeros((3, 3))], [C, A]])


@kernel
def applied(Omega, psi):
    return transposed_dexp(Omega, coefficients(Omega[0][0] ** 2 + Omega[0][1] ** 2 + Omega[0][2] ** 2), psi)


@kernel
def curvature(Omega, psi):
    return dexp_curvature(Omega, coefficients(Omega[0][0] ** 2 + Omega[0][1] ** 2 + Omega[0][2] ** 2), psi)


@kernel
def jet(Omega, Omega_dot, Omega_ddot, psi, psi_dot, psi_ddot):
    c = coefficients(Omega[0][0] ** 2 + Omega[0][1] ** 2 + Omega[0][2] ** 2)
    return transposed_dexp_jet(Omega, Omega_dot, Omega_ddot, c, psi, psi_dot, psi_ddot)


@pytest.fixture(params=SIZES)
def sample(request):
    """Omega of an angle, its first and second derivative, and a wrench with its derivatives: (6, 6)."""
    rows = np.random.default_rng(3).normal(size=(6, 6))
    rows[0, :3] *= request.param / np.linalg.norm(rows[0, :3])
    return rows


def test_transposed_operator(sample):
    Omega, psi = sample[0], sample[3]
    np.testing.assert_allclose(vector(applied(twist(Omega), twist(psi))), T(Omega).T @ psi, atol=1e-13)


def test_curvature_is_the_quadratic_form_of_the_derivative_of_T(sample):
    Omega, x, psi = sample[0], sample[1], sample[3]
    A, C = (np.array(part).reshape(3, 3) for part in curvature(twist(Omega), twist(psi)))
    np.testing.assert_array_equal(A, A.T)
    np.testing.assert_array_equal(C, C.T)
    h = 1e-5
    expected = psi @ (T(Omega + h * x) - T(Omega - h * x)) @ x / (2 * h)
    assert x[:3] @ C @ x[:3] + 2.0 * x[:3] @ A @ x[3:] == pytest.approx(expected, rel=1e-8, abs=1e-9)


def test_derivatives_along_a_motion(sample):
    Omega, Omega_dot, Omega_ddot, psi, psi_dot, psi_ddot = sample

    def at(s):
        return T(Omega + s * Omega_dot + s * s / 2 * Omega_ddot).T @ (psi + s * psi_dot + s * s / 2 * psi_ddot)

    first, second = jet(*map(twist, sample))
    np.testing.assert_allclose(vector(first), (at(1e-5) - at(-1e-5)) / 2e-5, atol=1e-8)
    np.testing.assert_allclose(vector(second), (at(1e-3) - 2.0 * at(0.0) + at(-1e-3)) / 1e-6, atol=2e-5)


def test_products_with_the_zanna_operator():
    rng, mu = np.random.default_rng(0), 0.3
    xi, t, psi, r = rng.normal(size=(4, 6))
    Z = np.eye(6) + mu * ad(xi)
    np.testing.assert_allclose(vector(zanna_transposed(mu, twist(xi), twist(t))), Z.T @ t, atol=1e-14)
    A, C = rng.normal(size=(2, 3, 3))
    D = tuple(A.ravel()), tuple(C.ravel())
    form = np.block([[C, A], [A, np.zeros((3, 3))]])  # x D y of dual matrices, angular first
    for found, expected in ((times_zanna(D, mu, twist(xi)), form @ Z), (zanna_times(mu, twist(xi), D), Z.T @ form)):
        A_found, C_found = (np.array(part).reshape(3, 3) for part in found)
        np.testing.assert_allclose(expected, np.block([[C_found, A_found], [A_found, np.zeros((3, 3))]]), atol=1e-13)


def test_wrench_at_the_start():
    rng = np.random.default_rng(1)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    r, total = rng.normal(size=3), rng.normal(size=6)
    Ad = np.block([[R, np.zeros((3, 3))], [skew(r) @ R, R]])
    np.testing.assert_allclose(vector(wrench_at_start(tuple(R.ravel()), tuple(r), twist(total))), Ad.T @ total, atol=1e-14)
