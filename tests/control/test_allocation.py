"""The quadratic program with bounds against another solver and the conditions of its optimum, and
its answer where there is none."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from soft_tendon_env.control.allocation import Rows, allocate

LEAST = np.array([-1.0, 0.5])
GREATEST = np.array([1.0, 2.0])


@pytest.fixture(params=range(12))
def problem(request):
    """A random full-rank task |A x - b|^2 with bounds: A (m + 2, m), b, least, greatest."""
    rng = np.random.default_rng(request.param)
    size = rng.integers(1, 13)
    conditions = size + 2
    A = rng.normal(size=(conditions, size))
    b = 3.0 * rng.normal(size=conditions)
    magnitude = rng.uniform(-3.0, 3.0)
    unit = 10.0**magnitude
    least = rng.uniform(-1.0, 0.0, size)
    greatest = rng.uniform(0.0, 1.0, size)
    return unit * A, unit * b, least, greatest


def test_another_solver_agrees_and_the_conditions_of_an_optimum_hold(problem):
    """Where bounds are loose the slope is zero, at the least it does not fall inwards, at the
    greatest neither."""
    A, b, least, greatest = problem
    allocation = allocate(A.T @ A, -A.T @ b, least, greatest)
    x = allocation.x
    assert allocation.solved
    other_solver = lsq_linear(A, b, (least, greatest), method="bvls", tol=1e-14)
    np.testing.assert_allclose(x, other_solver.x, atol=1e-7)
    slope = A.T @ (A @ x - b) / np.trace(A.T @ A)
    is_least = x - least < 1e-9
    is_greatest = greatest - x < 1e-9
    assert (x >= least).all()
    assert (x <= greatest).all()
    assert (slope[is_least] > 0.0).all()
    assert (slope[is_greatest] < 0.0).all()
    np.testing.assert_allclose(slope[~is_least & ~is_greatest], 0.0, atol=1e-9)
    # what the bounds push back with
    expected_multipliers = -slope * slope.size
    np.testing.assert_allclose(allocation.multipliers, expected_multipliers, atol=1e-9)


def test_a_warm_start_ends_where_a_cold_one_does(problem):
    A, b, least, greatest = problem
    hessian = A.T @ A
    gradient = -A.T @ b
    cold = allocate(hessian, gradient, least, greatest)
    opposite = allocate(hessian, -gradient, least, greatest)
    starts = [cold.multipliers, opposite.multipliers, 0.0 * least]
    for start in starts:
        warm = allocate(hessian, gradient, least, greatest, start)
        assert warm.solved
        np.testing.assert_allclose(warm.x, cold.x, atol=1e-9)


@pytest.mark.parametrize(
    ("hessian", "gradient"),
    [
        (np.zeros((2, 2)), np.ones(2)),
        (-np.eye(2), np.ones(2)),
        (np.diag([np.nan, 1.0]), np.ones(2)),
        (np.diag([np.inf, 1.0]), np.ones(2)),
        (1e308 * np.eye(2), np.ones(2)),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), np.ones(2)),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2)),
        (np.eye(2), np.array([np.nan, 0.0])),
        (np.eye(2), np.array([np.inf, 0.0])),
    ],
)
def test_what_cannot_be_solved_is_answered_by_zero_within_the_bounds(hessian, gradient):
    with np.errstate(over="ignore"):
        allocation = allocate(hessian, gradient, LEAST, GREATEST)
    assert not allocation.solved
    np.testing.assert_array_equal(allocation.x, [0.0, 0.5])
    np.testing.assert_array_equal(allocation.multipliers, 0.0)


def test_tendons_that_do_the_same_stay_within_their_bounds():
    """Of a singular program whatever is answered is allowed."""
    task = np.array([[1.0, 1.0, 0.0]])
    allocation = allocate(task.T @ task, -task[0] * 5.0, np.zeros(3), np.ones(3))
    assert (allocation.x >= 0.0).all()
    assert (allocation.x <= 1.0).all()
    assert np.isfinite(allocation.multipliers).all()


def test_rows_are_bounds_of_other_variables(problem):
    """With x = M^-1 z and bounds of z alone, the least is that of the problem in z."""
    A, b, least, greatest = problem
    size = least.size
    M = np.eye(size) - 0.7 * np.eye(size, k=-1)  # changes from one to the next
    A_of_z = A @ np.linalg.inv(M)
    of_z = allocate(A_of_z.T @ A_of_z, -A_of_z.T @ b, least, greatest)
    hessian = A.T @ A
    gradient = -A.T @ b
    wide = np.full(size, 1e6)
    rows = Rows(M, least, greatest)
    of_x = allocate(hessian, gradient, -wide, wide, rows=rows)
    assert of_x.solved
    z = M @ of_x.x
    np.testing.assert_allclose(z, of_z.x, atol=1e-7)
    warm = allocate(hessian, gradient, -wide, wide, of_x.multipliers, rows)
    np.testing.assert_allclose(warm.x, of_x.x, atol=1e-9)
