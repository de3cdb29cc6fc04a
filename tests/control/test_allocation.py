"""The small quadratic program against another solver and against the conditions of its optimum."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from soft_tendon_env.control.allocation import allocate


@pytest.fixture(params=range(12))
def problem(request):
    """A random full-rank task |A x - b|^2 with bounds: A (m + 2, m), b, least, greatest."""
    rng = np.random.default_rng(request.param)
    size = rng.integers(1, 13)
    A, b = rng.normal(size=(size + 2, size)), 3.0 * rng.normal(size=size + 2)
    unit = 10.0 ** rng.uniform(-3.0, 3.0)
    return unit * A, unit * b, rng.uniform(-1.0, 0.0, size), rng.uniform(0.0, 1.0, size)


def test_another_solver_agrees_and_the_conditions_of_an_optimum_hold(problem):
    """Where bounds are loose the slope is zero, at the least it does not fall inwards, at the greatest neither."""
    A, b, least, greatest = problem
    found = allocate(A.T @ A, -A.T @ b, least, greatest)
    assert found.solved
    np.testing.assert_allclose(found.x, lsq_linear(A, b, (least, greatest), method="bvls", tol=1e-14).x, atol=1e-7)
    slope = A.T @ (A @ found.x - b) / np.trace(A.T @ A)
    at_least, at_greatest = found.x - least < 1e-9, greatest - found.x < 1e-9
    assert (found.x >= least).all() and (found.x <= greatest).all()
    assert (slope[at_least] > 0.0).all() and (slope[at_greatest] < 0.0).all()
    np.testing.assert_allclose(slope[~at_least & ~at_greatest], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.multipliers, -slope * slope.size, atol=1e-9)  # what the bounds push back with
