"""Tension allocation: the quadratic program of least task error and cost within tension limits.

Solved by DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method, which starts from
the last solution's multipliers.
"""

from typing import NamedTuple

import daqp
import numpy as np

from soft_tendon_env.tools.types import Array

OPTIMAL = (1, 2)  # exit flags of DAQP: optimal, and optimal with softened constraints


class Allocation(NamedTuple):
    """x (m,), the multipliers (m,) to start the next one from, and whether the program was
    solved."""

    x: Array
    multipliers: Array
    solved: bool


def allocate(
    hessian: Array, gradient: Array, least: Array, greatest: Array, start: Array | None = None
) -> Allocation:
    """The x within least <= x <= greatest (m,) of least x^T hessian x / 2 + gradient^T x; hessian
    (m, m) positive definite.

    start: multipliers of a similar problem. Where the program cannot be solved, x is zero within
    the bounds and `solved` false.
    """
    size = gradient.size
    unit = np.trace(hessian) / size
    fallback = Allocation(np.clip(np.zeros(size), least, greatest), np.zeros(size), False)
    if not (
        np.isfinite(hessian).all()
        and np.isfinite(unit)
        and unit > 0.0
        and np.isfinite(gradient).all()
    ):
        return fallback
    bounds = [np.array(bound, dtype=np.float64) for bound in (greatest, least)]
    none, sense = (
        np.empty((0, size)),
        np.zeros(size, dtype=np.int32),
    )  # of constraints but the bounds
    x, _, flag, info = daqp.solve(
        hessian / unit, gradient / unit, none, *bounds, sense, dual_start=start
    )
    if flag not in OPTIMAL or not np.isfinite(x).all():
        return fallback
    return Allocation(np.clip(x, least, greatest), np.asarray(info["lam"]), True)
