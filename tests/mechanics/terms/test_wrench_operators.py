"""What a wrench does on an interval, against the tangent operator T."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lie import coefficients, dexp_operator
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


@pytest.fixture(params=SIZES)
def sample(request):
    """Omega of an angle, and a wrench: (2, 6)."""
    rows = np.random.default_rng(3).normal(size=(2, 6))
    rows[0, :3] *= request.param / np.linalg.norm(rows[0, :3])
    return rows


def test_transposed_operator(sample):
    Omega, psi = sample
    np.testing.assert_allclose(vector(applied(twist(Omega), twist(psi))), T(Omega).T @ psi, atol=1e-13)


def test_products_with_the_zanna_operator():
    rng, mu = np.random.default_rng(0), 0.3
    xi, t = rng.normal(size=(2, 6))
    Z = np.eye(6) + mu * ad(xi)
    np.testing.assert_allclose(vector(zanna_transposed(mu, twist(xi), twist(t))), Z.T @ t, atol=1e-14)


def test_wrench_at_the_start():
    rng = np.random.default_rng(1)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    r, total = rng.normal(size=3), rng.normal(size=6)
    Ad = np.block([[R, np.zeros((3, 3))], [skew(r) @ R, R]])
    np.testing.assert_allclose(vector(wrench_at_start(tuple(R.ravel()), tuple(r), twist(total))), Ad.T @ total, atol=1e-14)
