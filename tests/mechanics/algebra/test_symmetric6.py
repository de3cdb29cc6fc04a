"""The 6x6 factorisation and the products with its factors, against numpy.linalg, on floats and on packs."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, store
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    apply21,
    factorise,
    inverse_diagonal,
    load6,
    load21,
    load_factor,
    scaled,
    solve,
    solve_lower,
    solve_upper,
    squared_norm,
    store6,
    store_factor,
)

pytestmark = pytest.mark.no_jit

LOWER = np.tril_indices(6)
BELOW = np.tril_indices(6, -1)


@kernel
def products(h, b, free, factor, out):
    """The factor to `factor` (21 packs) and the products, one twist-shaped pack each, to `out`."""
    own, x = load21(h, 0), load6(b, 0)
    f = factorise(own, free)
    store_factor(factor, 0, f)
    f = load_factor(factor, 0)
    store6(out, 0, solve(f, x, free))
    store6(out, 6 * LANES, solve_lower(f, x, free))
    store6(out, 12 * LANES, solve_upper(f, x, free))
    store6(out, 18 * LANES, apply21(h, 0, x))
    store6(out, 24 * LANES, inverse_diagonal(f))
    store6(out, 30 * LANES, scaled(x, x))
    store(out, 36 * LANES, squared_norm(x))


def products_of(matrices, vectors, free=6):
    """Factors (LANES, 21), products (LANES, 6, 6), squared norms (LANES,)."""
    h = np.ascontiguousarray(np.array([matrix[LOWER] for matrix in matrices]).T).ravel()
    factor, out = np.empty(21 * LANES), np.empty(37 * LANES)
    products(h, np.ascontiguousarray(vectors.T).ravel(), tuple(range(free)), factor, out)
    return factor.reshape(21, LANES).T, out[: 36 * LANES].reshape(6, 6, LANES).transpose(2, 0, 1), out[36 * LANES :]


def positive_definite(rng, spread):
    """Random, with a condition number of about 10^spread."""
    rotation = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    return rotation @ np.diag(10.0 ** rng.uniform(0, spread, size=6)) @ rotation.T


@pytest.mark.cases("free", (3, 4, 6))
@pytest.mark.cases("seed", range(5))
def test_factor_and_products_of_positive_definite_matrices(seed, free):
    rng = np.random.default_rng(seed)
    matrices, vectors = np.array([positive_definite(rng, 3) for _ in range(LANES)]), rng.normal(size=(LANES, 6))
    matrices[:, free:], matrices[:, :, free:] = np.eye(6)[free:], np.eye(6)[:, free:]  # rigid strains
    factors, found, norms = products_of(matrices, vectors, free)
    for matrix, b, f, got in zip(matrices, vectors, factors, found, strict=True):
        L = np.eye(6)
        L[BELOW] = f[:15]
        np.testing.assert_allclose(L @ np.diag(1 / f[15:]) @ L.T, matrix, atol=1e-14 * np.abs(matrix).max())
        expected = [
            np.linalg.solve(matrix, b), np.linalg.solve(L, b), np.linalg.solve(L.T, b), matrix @ b, f[15:], b * b,
        ]  # fmt: skip
        for one, other in zip(got, expected, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-11 * np.abs(other).max())
    np.testing.assert_allclose(norms, (vectors**2).sum(axis=1), rtol=1e-15)


@pytest.mark.parametrize("negative", range(1, 6))
def test_as_many_pivots_are_negative_as_eigenvalues(negative):
    """Sylvester's law of inertia: what makes 1/D the test for a strain at its limit. One lane does not disturb the others."""
    rng = np.random.default_rng(negative)
    matrices = np.array([positive_definite(rng, 1) for _ in range(LANES)])
    rotation = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    matrices[1] = rotation @ np.diag(np.r_[-rng.uniform(1, 2, negative), rng.uniform(1, 2, 6 - negative)]) @ rotation.T
    factors, found, _ = products_of(matrices, np.ones((LANES, 6)))
    assert [(f[15:] < 0).sum() for f in factors] == [0, negative, 0, 0]
    np.testing.assert_allclose(found[:, 0], np.linalg.solve(matrices, np.ones((LANES, 6, 1)))[..., 0], rtol=1e-9)
