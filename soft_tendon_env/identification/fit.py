"""Least squares with priors: the parameters at which simulated and measured marker positions agree best.

Minimises sum (r / sigma)^2 + sum (x / prior)^2 within bounds (trust-region reflective, scipy.optimize.least_squares). Where sigma is not
given it is estimated with the parameters, since it decides how much the priors weigh.
"""

from typing import Literal, NamedTuple

import numpy as np

from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.statics import NoHoldError
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

Loss = Literal["linear", "soft_l1", "cauchy"]
FIRST_SIGMA = 0.02
"""Standard deviation of readings that an unknown one is at first, as a share of the rod's length."""
SAME_SIGMA, MOST_ROUNDS = 0.02, 10
LEAST_SIGMA = 1e-9
"""Standard deviation [m] that one is at least: data without noise are fitted exactly."""
TOLERANCE, ROOM = 1e-8, 0.02
"""Tolerances of the method, and the distance from bounds, of that of both, at which it begins."""
ROBUST = {"linear": lambda z: np.ones_like(z), "soft_l1": lambda z: (1.0 + z) ** -0.5, "cauchy": lambda z: 1.0 / (1.0 + z)}
"""Weights of squared readings, rho'(z) at z = (r / sigma)^2."""


class Fit(NamedTuple):
    """Estimate, and the linearised readings there."""

    x: Array  # (k,) dimensionless coordinates
    residual: Array  # (N,) [m]
    jacobian: Array  # (N, k) [m]
    sigma: float  # [m], standard deviation of a reading
    weight: Array  # (N,) of readings, 1 but for a robust loss
    prior: Array  # (k,) inverse variances of the coordinates, 0 without a prior
    evaluations: int

    @property
    def information(self) -> Array:
        """Information of the data about the coordinates (k, k), J^T J / sigma^2, without the priors."""
        return np.asarray((self.jacobian.T * self.weight) @ self.jacobian) / self.sigma**2


def fit(readings: Readings, sigma: float | None = None, loss: Loss = "linear", start: Array | None = None) -> Fit:
    """Estimate of the parameters. `sigma` [m]: standard deviation of the readings, None: unknown.

    Raises ValueError for fewer readings than parameters without priors, NoHoldError where the scene itself does not hold the data.
    """
    parameters = readings.plants.parameters
    prior = np.array([0.0 if own.prior is None else (own.scale / own.prior) ** 2 for own in parameters])
    free, count = int((prior == 0.0).sum()), readings.recording.size
    if count <= free:
        raise ValueError(f"there are {count} readings for {free} parameters without priors: record more holds, or estimate fewer")
    x = np.zeros(len(parameters)) if start is None else start
    length, evaluations = readings.plants.length, 0
    here = FIRST_SIGMA * length if sigma is None else sigma
    rounds = MOST_ROUNDS if sigma is None and (prior.any() or loss != "linear") else 1  # where sigma changes the estimate
    for _ in range(rounds):
        found = _solved(readings, x, here, prior, loss)
        x, evaluations = found.x, evaluations + found.evaluations
        before, here = here, _sigma(found) if sigma is None else sigma
        if abs(here - before) <= SAME_SIGMA * before:
            break
    return found._replace(sigma=here, evaluations=evaluations)


def _solved(readings: Readings, x: Array, sigma: float, prior: Array, loss: Loss) -> Fit:
    """Estimate at a given standard deviation, from coordinates x (k,) on."""
    from scipy.optimize import least_squares  # here: it takes longer to import than all else that most scenes need

    root = np.sqrt(prior)
    kept = np.flatnonzero(root)
    bounds = np.array([own.bounds for own in readings.plants.parameters]).T
    inside = ROOM * np.ptp(bounds, axis=0)  # from a bound itself the method hardly moves
    x = np.clip(x, bounds[0] + inside, bounds[1] - inside)
    size = readings.residual(x).size  # raises where the scene itself does not hold the data

    def residual(at: Array) -> Array:
        try:
            data = readings.residual(at)
        except (NoHoldError, ConfigurationError):  # the trust region shrinks
            data = np.full(size, np.inf)
        return np.concatenate([data / sigma, root[kept] * at[kept]])

    def jacobian(at: Array) -> Array:
        return np.vstack([readings.jacobian(at) / sigma, np.diag(root)[kept]])

    done = least_squares(residual, x, jacobian, bounds, loss=loss, xtol=TOLERANCE, ftol=TOLERANCE, gtol=TOLERANCE)
    data, J = readings.residual(done.x), readings.jacobian(done.x)
    return Fit(done.x, data, J, sigma, ROBUST[loss]((data / sigma) ** 2), prior, int(done.nfev))


def _sigma(found: Fit) -> float:
    """Standard deviation [m] of the readings, for as many parameters as the data decide about."""
    data = found.information
    decided = float(np.trace(np.linalg.pinv(data + np.diag(found.prior), hermitian=True) @ data))
    squares = float(found.weight @ found.residual**2)
    return max(float(np.sqrt(squares / max(found.residual.size - decided, 1.0))), LEAST_SIGMA)
