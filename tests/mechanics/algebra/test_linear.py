"""Small symmetric positive definite systems against numpy.linalg."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.linear import row_stride, solve_positive_definite, solve_symmetric

pytestmark = pytest.mark.no_jit


def system(a, b):
    """Flat rows as the kernel has them. The lower triangle and the padding are not read: they hold numbers that would show."""
    n = len(a)
    flat = np.full((n, row_stride(n + 1)), 1e3)
    flat[:, :n] = np.where(np.tri(n, dtype=bool).T, a, 1e3)
    flat[:, n] = b
    return flat.ravel()


def is_solved(a):
    return solve_positive_definite(system(a, np.ones(len(a))), len(a), np.empty(len(a)))


@pytest.mark.cases("n", (1, 2, 3, 4, 5, 7, 8, 10, 16, 19, 48))
def test_solution_of_positive_definite_systems(n):
    rng = np.random.default_rng(n)
    a = rng.normal(size=(n, n + 3))
    a, b, x = a @ a.T, rng.normal(size=n), np.full(n, np.nan)
    assert solve_positive_definite(system(a, b), n, x)
    np.testing.assert_allclose(a @ x, b, atol=1e-13 * np.abs(a).max() * np.abs(x).max())
    np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=0, atol=1e-14 * np.linalg.cond(a) * np.abs(x).max())


BAD = [((0, 0), 0.0), ((2, 2), -1.0), ((4, 4), np.nan), ((1, 1), np.inf), ((1, 4), np.nan), ((0, 3), np.inf), ((0, 2), 3.0)]


@pytest.mark.cases("place, bad", BAD)
def test_what_is_not_positive_definite_is_refused(place, bad):
    """On the diagonal and off it; the last is an indefinite matrix of positive diagonal."""
    a = np.diag([2.0, 1.0, 3.0, 1.0, 2.0])
    a[place] = bad
    with np.errstate(invalid="ignore"):
        assert not is_solved(a)


@pytest.mark.cases("n, is_positive", [(1, True), (2, False), (6, True), (9, False), (34, True)])
def test_solution_of_symmetric_systems(n, is_positive):
    """Definite or not; the lower triangle is not read."""
    rng = np.random.default_rng(n)
    a, b = rng.normal(size=(n, n + 3)), rng.normal(size=(n, 4))
    a = a @ a.T - (0.0 if is_positive else 2.0 * n * np.diag(np.arange(n) == 1))
    read = np.where(np.tri(n, k=-1, dtype=bool), 1e3, a)
    x = b.copy()
    solve_symmetric(read, x)
    np.testing.assert_allclose(x, np.linalg.solve(a, b), rtol=0, atol=1e-13 * np.linalg.cond(a) * np.abs(x).max())
