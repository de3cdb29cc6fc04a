"""Tension allocation: the quadratic program of least task error and cost within tension limits.

Solved by DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method, which starts from
the last solution's multipliers.
"""

from typing import NamedTuple

import daqp
import numpy as np

from soft_tendon_env.tools.types import Array

OPTIMAL = (1, 2)  # exit flags of DAQP: optimal, and optimal with softened constraints


class Rows(NamedTuple):
    """Linear inequality constraints least <= matrix x <= greatest of a program."""

    matrix: Array  # (r, m)
    least: Array  # (r,)
    greatest: Array  # (r,)


class Allocation(NamedTuple):
    """Solution of a bounded program: x (m,), multipliers, and whether it was solved.

    The multipliers (m,), or (m + r,) with r rows, are there to start the next one from.
    """

    x: Array
    multipliers: Array
    solved: bool


def allocate(
    hessian: Array,
    gradient: Array,
    least: Array,
    greatest: Array,
    start: Array | None = None,
    rows: Rows | None = None,
) -> Allocation:
    """Quadratic program with bounds: the x of least x^T hessian x / 2 + gradient^T x.

    Args:
        hessian: (m, m) positive definite.
        gradient: (m,).
        least: bounds (m,) of x.
        greatest: (m,).
        start: multipliers of a similar problem, with as many rows.
        rows: constraints besides the bounds; None: there are none.

    Returns:
        x within the bounds, and multipliers for the next problem. Where the program cannot be
        solved, x is zero within the bounds and `solved` false.
    """
    size = gradient.size
    if rows is None:
        no_matrix = np.empty((0, size))
        no_bound = np.empty(0)
        rows = Rows(no_matrix, no_bound, no_bound)
    nothing = np.zeros(size)
    nearest = np.clip(nothing, least, greatest)
    no_multipliers = np.zeros(size + rows.least.size)
    fallback = Allocation(nearest, no_multipliers, solved=False)
    has_hessian = np.isfinite(hessian).all()
    has_gradient = np.isfinite(gradient).all()
    if not has_hessian or not has_gradient:
        return fallback
    # the solver's tolerances are absolute: a problem of usual size
    unit = np.trace(hessian) / size
    if not np.isfinite(unit) or unit <= 0.0:
        return fallback
    upper = np.concatenate([greatest, rows.greatest])
    lower = np.concatenate([least, rows.least])
    inequalities = np.zeros(upper.size, dtype=np.int32)
    usual_hessian = hessian / unit
    usual_gradient = gradient / unit
    x, _, flag, info = daqp.solve(
        usual_hessian, usual_gradient, rows.matrix, upper, lower, inequalities, dual_start=start
    )
    is_finite = np.isfinite(x).all()
    if flag not in OPTIMAL or not is_finite:
        return fallback
    within = np.clip(x, least, greatest)
    multipliers = np.asarray(info["lam"])
    return Allocation(within, multipliers, solved=True)
