"""Small symmetric positive definite systems against numpy.linalg."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.linear import cholesky, cholesky_solve, row_stride

pytestmark = pytest.mark.no_jit


def padded(a):
    """Flat rows of whole packs. The upper triangle and the padding are not read: they hold numbers that would show."""
    n = len(a)
    flat = np.full((n, row_stride(n)), 1e3)
    flat[:, :n] = np.where(np.tri(n, dtype=bool), a, 1e3)
    return flat.ravel()


@pytest.mark.parametrize("n", (1, 2, 3, 4, 5, 7, 8, 10, 16, 19, 48))
def test_solution_of_positive_definite_systems(n):
    rng = np.random.default_rng(n)
    a = rng.normal(size=(n, n + 3))
    a, b = a @ a.T, rng.normal(size=n)
    factor, x = padded(a), b.copy()
    assert cholesky(factor, n)
    found, expected = factor.reshape(n, -1)[:, :n], np.linalg.cholesky(a)
    np.testing.assert_allclose(np.tril(found, -1), np.tril(expected, -1), atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(np.diag(found), 1 / np.diag(expected), rtol=1e-10)
    cholesky_solve(factor, x)
    np.testing.assert_allclose(a @ x, b, atol=1e-13 * np.abs(a).max() * np.abs(x).max())


@pytest.mark.parametrize("bad", (0.0, -1.0, np.nan, np.inf))
@pytest.mark.parametrize("where", range(5))
def test_what_is_not_positive_definite_is_refused(bad, where):
    a = np.diag([2.0, 1.0, 3.0, 1.0, 2.0])
    a[where, where] = bad
    with np.errstate(invalid="ignore"):
        assert not cholesky(padded(a), 5)


@pytest.mark.parametrize("bad", (np.nan, np.inf))
def test_nan_and_infinity_off_the_diagonal_are_refused(bad):
    for i, j in zip(*np.tril_indices(6, -1), strict=True):
        a = np.eye(6)
        a[i, j] = bad
        with np.errstate(invalid="ignore"):
            assert not cholesky(padded(a), 6)


def test_an_indefinite_matrix_with_positive_diagonal_is_refused():
    assert not cholesky(padded(np.array([[1.0, 2.0], [2.0, 1.0]])), 2)
