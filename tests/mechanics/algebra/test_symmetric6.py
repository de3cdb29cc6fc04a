"""Symmetric 6x6 matrices of sections against NumPy, for every block that differs from the
identity."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.symmetric6 import (
    factorise,
    is_positive,
    load6,
    load21,
    scale6,
    scaled_stiffness,
    solve,
    squared_norm,
    store6,
    store_factor,
    symmetric_product,
    zero6,
    zero21,
)

pytestmark = pytest.mark.no_jit

LOWER = np.tril_indices(6)


def twist(x):
    return tuple(x[:3].tolist()), tuple(x[3:].tolist())


def entries_of(matrix):
    """Lower triangle of a matrix by rows."""
    return tuple(matrix[LOWER].tolist())


def section(seed, block):
    """A positive definite matrix (6, 6), the identity beyond a block."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(block, block))
    matrix = np.eye(6)
    matrix[:block, :block] += root @ root.T
    return matrix


@pytest.mark.parametrize("block", [3, 4, 6])
def test_solutions_are_those_of_numpy(block):
    matrix = section(0, block)
    rng = np.random.default_rng(1)
    right = rng.normal(size=6)
    free = tuple(range(block))
    factor = factorise(entries_of(matrix), free)
    assert is_positive(factor)
    solution = np.ravel(solve(factor, twist(right), free))
    np.testing.assert_allclose(matrix @ solution, right, atol=1e-13)


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("entry", [-1.0, np.nan])
def test_a_matrix_that_is_not_positive_definite_is_told(place, entry):
    matrix = section(0, 6)
    matrix[place, place] = entry
    assert not is_positive(factorise(entries_of(matrix), (0, 1, 2, 3, 4, 5)))


def test_products_and_scales_are_those_of_the_matrix():
    matrix = section(2, 6)
    entries = entries_of(matrix)
    rng = np.random.default_rng(3)
    x, c = rng.normal(size=(2, 6))
    product = symmetric_product(entries, twist(x))
    np.testing.assert_allclose(np.ravel(product), matrix @ x, atol=1e-14)
    scaled = scale6(twist(c), twist(x))
    np.testing.assert_allclose(np.ravel(scaled), c * x)
    assert squared_norm(twist(x)) == pytest.approx(x @ x)
    scale = np.diag(c)
    expected = entries_of(np.eye(6) + scale @ matrix @ scale)
    found = scaled_stiffness(entries, twist(c))
    np.testing.assert_allclose(found, expected, atol=1e-14)


@kernel
def copy_blocks(twists, matrices, twists_out, matrices_out):
    """Copies the second block of fields of twists and of matrices to the first, and leaves zeros in
    its place."""
    store6(twists_out, 0, load6(twists, 1))
    store6(twists_out, 1, zero6())
    store_factor(matrices_out, 0, load21(matrices, 1))
    store_factor(matrices_out, 1, zero21())


def test_blocks_of_fields_are_loaded_and_stored():
    rng = np.random.default_rng(4)
    twists = rng.normal(size=2 * 6 * LANES)
    matrices = rng.normal(size=2 * 21 * LANES)
    twists_out = np.ones_like(twists)
    matrices_out = np.ones_like(matrices)
    copy_blocks(twists, matrices, twists_out, matrices_out)
    for field, out in ((twists, twists_out), (matrices, matrices_out)):
        first, second = np.split(out, 2)
        expected_first = np.split(field, 2)[1]
        np.testing.assert_array_equal(first, expected_first)
        np.testing.assert_array_equal(second, 0.0)
