"""The factorisation of packs of symmetric matrices in memory, against numpy.linalg."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.packed_ldl import SIX, entry, ldl_factorise, ldl_solve, ldl_solve_six

pytestmark = pytest.mark.no_jit


def packed(matrices):
    """Lower triangles of matrices (LANES, m, m) in a flat vector, and room that is not read."""
    m = matrices.shape[-1]
    out = np.full((m * (m + 1) // 2 + 1) * LANES, np.nan)
    for i in range(m):
        for j in range(i + 1):
            out[entry(i, j) : entry(i, j) + LANES] = matrices[:, i, j]
    return out


def symmetric(m, seed):
    """Indefinite symmetric matrices (LANES, m, m) with leading minors far from zero."""
    rng = np.random.default_rng(seed)
    lower = np.tril(rng.normal(size=(LANES, m, m)), -1) + np.eye(m)
    pivots = rng.uniform(0.5, 2.0, (LANES, m)) * np.where(np.arange(m) == 1, -1.0, 1.0)
    return lower @ (pivots[..., None] * np.swapaxes(lower, 1, 2)), pivots


@pytest.mark.parametrize("m", [2, 6, 8, 12])
def test_solutions_and_the_least_pivot(m):
    matrices, pivots = symmetric(m, m)
    a, rng = packed(matrices), np.random.default_rng(1)
    assert ldl_factorise(a, m) == pytest.approx(pivots.min(), rel=1e-12)
    x = rng.normal(size=(m, LANES))
    found = x.ravel().copy()
    ldl_solve(a, m, found)
    expected = np.linalg.solve(matrices, x.T[..., None])[..., 0].T
    np.testing.assert_allclose(found.reshape(m, LANES), expected, rtol=1e-10, atol=1e-11 * np.abs(expected).max())

    six = rng.normal(size=(SIX, m, LANES))
    found = np.pad(six.reshape(SIX, -1), ((0, 0), (0, 2 * LANES)), constant_values=np.nan)  # rows may be longer
    ldl_solve_six(a, m, found)
    expected = np.linalg.solve(matrices[None], np.moveaxis(six, -1, 1)[..., None])[..., 0]
    got = found[:, : m * LANES].reshape(SIX, m, LANES)
    np.testing.assert_allclose(np.moveaxis(got, -1, 1), expected, rtol=1e-10, atol=1e-11 * np.abs(expected).max())


def test_nan_shows_in_the_least_pivot():
    matrices, _ = symmetric(4, 0)
    matrices[2, 3, 1] = matrices[2, 1, 3] = np.nan
    assert np.isnan(ldl_factorise(packed(matrices), 4))
