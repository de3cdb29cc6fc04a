"""Small systems against NumPy's solutions, and bounded ones against the conditions that define
them."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import aligned_zeros
from soft_tendon_env.mechanics.algebra.linear import (
    AT_GREATEST,
    AT_LEAST,
    BETWEEN,
    add_product,
    copy,
    copy_matrix,
    place_between,
    product,
    row_stride,
    solve_again,
    solve_bounded,
    solve_columns,
    solve_part,
    solve_positive_definite,
    solve_symmetric,
    total,
)

pytestmark = pytest.mark.no_jit

SIZES = range(1, 10)
"""Whole packs, and sizes beside them."""


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def positive_definite(rng, n):
    """A symmetric matrix (n, n) whose eigenvalues are at least 1."""
    root = rng.normal(size=(n, n))
    return root @ root.T + np.eye(n)


def packed_system(matrix, right):
    """The rows that solve_positive_definite() reads: coefficients, then the right-hand side."""
    n = right.size
    rows = aligned_zeros(n, row_stride(n + 1))
    rows[:, :n] = np.triu(matrix)  # what is left of the diagonal is not read
    rows[:, n] = right
    return rows.ravel()


@pytest.mark.parametrize("n", SIZES)
def test_products_sums_and_copies_are_those_of_numpy(rng, n):
    x, y = rng.normal(size=(2, n))
    assert product(x, y) == pytest.approx(x @ y, abs=1e-14)
    assert total(x) == pytest.approx(x.sum(), abs=1e-14)
    copied = np.zeros(n)
    copy(x, copied)
    np.testing.assert_array_equal(copied, x)
    matrix = rng.normal(size=(n, 3))
    copied_matrix = np.zeros((n, 3))
    copy_matrix(matrix, copied_matrix)
    np.testing.assert_array_equal(copied_matrix, matrix)
    right = rng.normal(size=(3, 2))
    right[1, 0] = 0.0
    start = rng.normal(size=(n, 2))
    added = start.copy()
    add_product(matrix, right, added)
    expected_added = start + matrix @ right
    np.testing.assert_allclose(added, expected_added, atol=1e-14)


@pytest.mark.parametrize("n", SIZES)
def test_positive_definite_systems_are_solved_and_solved_again(rng, n):
    matrix = positive_definite(rng, n)
    first, second = rng.normal(size=(2, n))
    system = packed_system(matrix, first)
    x = np.zeros(n)
    assert solve_positive_definite(system, n, x)
    np.testing.assert_allclose(matrix @ x, first, atol=1e-12)
    x[:] = second
    solve_again(system, n, x)
    np.testing.assert_allclose(matrix @ x, second, atol=1e-12)


@pytest.mark.parametrize("pivot", [0.0, -1.0, np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 2])
def test_what_is_not_positive_definite_is_told(pivot, place):
    matrix = np.eye(3)
    matrix[place, place] = pivot
    assert not solve_positive_definite(packed_system(matrix, np.ones(3)), 3, np.zeros(3))


@pytest.mark.parametrize("n", SIZES)
def test_symmetric_systems_of_several_right_hand_sides(rng, n):
    """Indefinite ones too, of which the upper triangle alone is read."""
    matrix = positive_definite(rng, n)
    matrix[-1, -1] = -5.0
    right = rng.normal(size=(n, 3))
    upper = np.triu(matrix)
    x = right.copy()
    solve_symmetric(upper, x)
    np.testing.assert_allclose(matrix @ x, right, atol=1e-10)


def solve_by_columns(matrix, right):
    """What solve_columns() makes of a matrix (n, n) and right-hand sides (n, m): whether it is
    solved, and solutions (n, m)."""
    n, m = right.shape
    width = n + m
    stride = row_stride(width)
    system = aligned_zeros(row_stride(n), stride)
    system[:n, :n] = matrix
    beside = system[:n, n:width]
    beside[:] = right
    is_solved = solve_columns(system.ravel(), n, stride, m)
    return is_solved, beside


@pytest.mark.parametrize("n", SIZES)
def test_systems_that_are_not_symmetric_have_several_right_hand_sides(rng, n):
    right = rng.normal(size=(n, 3))
    matrix = p_matrix(rng, n)
    is_solved, x = solve_by_columns(matrix, right)
    assert is_solved
    np.testing.assert_allclose(matrix @ x, right, atol=1e-10)


@pytest.mark.parametrize("n", SIZES[1:])
@pytest.mark.parametrize("pivot", [0.0, 1e-9, -1.0])
def test_small_and_negative_pivots_are_exchanged(rng, n, pivot):
    matrix = rng.normal(size=(n, n))
    matrix[0, 0] = pivot
    right = rng.normal(size=(n, 2))
    is_solved, x = solve_by_columns(matrix, right)
    assert is_solved
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan])
def test_systems_without_a_solution_are_told(value):
    matrix = np.eye(3)
    matrix[1, 1] = value
    is_solved, _ = solve_by_columns(matrix, np.ones((3, 1)))
    assert not is_solved


def test_singular_symmetric_systems_have_no_finite_solution():
    x = np.ones((2, 1))
    with np.errstate(all="ignore"):
        solve_symmetric(np.ones((2, 2)), x)
    assert not np.isfinite(x).any()


def test_places_between_bounds():
    places = [place_between(x, -1.0, 2.0) for x in (-3.0, -1.0, 0.0, 2.0, 5.0)]
    assert places == [AT_LEAST, AT_LEAST, BETWEEN, AT_GREATEST, AT_GREATEST]


def p_matrix(rng, n):
    """A matrix that is not symmetric and whose principal minors are positive: its symmetric part is
    positive definite."""
    turn = rng.normal(size=(n, n))
    return positive_definite(rng, n) + 3.0 * (turn - turn.T)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_part_of_the_unknowns_is_solved_and_the_others_stay_at_their_bounds(rng, n):
    matrix = p_matrix(rng, n)
    right = rng.normal(size=n)
    least = np.full(n, -0.5)
    greatest = np.full(n, 0.25)
    part = np.arange(n) % 3 - 1
    x = np.zeros(n)
    solve_part(matrix, right, least, greatest, x, part, np.zeros((n, n + 1)))
    np.testing.assert_array_equal(x[part == AT_LEAST], -0.5)
    np.testing.assert_array_equal(x[part == AT_GREATEST], 0.25)
    is_free = part == BETWEEN
    np.testing.assert_allclose((matrix @ x)[is_free], right[is_free], atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_bounded_systems_meet_the_conditions_of_complementarity(seed):
    """a x = b between the bounds, a x > b where x is at its least, a x < b at its greatest; from
    wherever the search begins."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 6
    matrix = p_matrix(rng, n)
    right = 5.0 * rng.normal(size=n)
    least = np.zeros(n)
    greatest = rng.uniform(0.1, 1.0, n)
    for start in (np.zeros(n), greatest, 0.5 * greatest):
        x = start.copy()
        sides = np.zeros(n, dtype=np.int64)
        system = np.zeros((n, n + 1))
        solve_bounded(matrix, right, least, greatest, x, sides, system)
        rest = matrix @ x - right
        at_least = x == least
        at_greatest = x == greatest
        assert ((x >= least) & (x <= greatest)).all()
        assert (rest[at_least] >= -1e-12).all()
        assert (rest[at_greatest] <= 1e-12).all()
        np.testing.assert_allclose(rest[~at_least & ~at_greatest], 0.0, atol=1e-12)


def test_a_search_that_would_go_in_circles_ends():
    """Murty's example, of which all unknowns at once go round: one at a time they come to an
    end."""
    matrix = np.array([[1.0, 2.0, 0.0], [0.0, 1.0, 2.0], [2.0, 0.0, 1.0]])
    right = np.ones(3)
    least = np.zeros(3)
    greatest = np.full(3, 1e6)
    for start in np.eye(3):
        x = start.copy()
        solve_bounded(
            matrix, right, least, greatest, x, np.zeros(3, dtype=np.int64), np.zeros((3, 4))
        )
        np.testing.assert_allclose(x, 1.0 / 3.0)
