"""Least squares with priors: the parameters at which simulated and measured marker positions agree best.

Minimises sum rho((r / sigma)^2) + sum (x / prior)^2 within bounds (trust-region reflective, scipy.optimize.least_squares). Where sigma is
not given it is estimated with the parameters: root mean square, or for a robust loss the median of |r|, which outliers do not move and
whose fixed point is not 0 (R. A. Maronna, R. D. Martin and V. J. Yohai, Robust Statistics, 2006, sections 2.2 to 2.6, 4.4).
"""

from typing import Literal, NamedTuple

import numpy as np

from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.identification.simulated import NoHoldError
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

Loss = Literal["linear", "soft_l1", "cauchy"]
FIRST_SIGMA = 0.02
"""Standard deviation of readings that an unknown one is at first, as a share of the rod's length."""
SAME_SIGMA, MOST_ROUNDS = 0.02, 10
LEAST_SIGMA = 1e-8
"""Standard deviation that one is at least, as a share of the rod's length: data without noise are met to the solver's tolerance."""
TOLERANCE, ROOM = 1e-8, 0.02
"""Tolerances of the method, and the distance from bounds, of that of both, at which it begins."""
ROBUST = {"linear": (0.0, 1.0), "soft_l1": (0.5, 1.287), "cauchy": (1.0, 2.385)}
"""Powers by which weights fall, and the residuals in sigma where they begin to: with normal noise 95 % as efficient as least squares."""
LEAST_SLOPE = 0.1
"""Slope that one is at least: where a noise is given that is far too small, every residual is an outlier and none remains."""
NORMAL_MEDIAN = 0.6745
"""Median of |r| / sigma of normal noise."""


class Fit(NamedTuple):
    """Estimate, and the linearised readings there."""

    x: Array  # (k,) dimensionless coordinates
    residual: Array  # (N,) [m]
    jacobian: Array  # (N, k) [m]
    sigma: float  # [m], standard deviation of a reading that is no outlier
    weight: Array  # (N,) of readings, 1 but for a robust loss
    slope: float  # by how much the weighted residuals follow the parameters, in parts of least squares
    excess: float  # variance of the estimate, in parts of that of least squares with sigma and these weights
    prior: Array  # (k,) inverse variances of the coordinates, 0 without a prior
    evaluations: int

    @property
    def curvature(self) -> Array:
        """Part (k, k) of the data in the second derivatives of half the cost."""
        return np.asarray((self.jacobian.T * self.weight) @ self.jacobian) * (self.slope / self.sigma**2)

    @property
    def score(self) -> Array:
        """Share (N, k) of each reading in the first derivatives of half the cost."""
        return np.asarray(self.jacobian.T * (self.weight * self.residual)).T / self.sigma**2

    @property
    def information(self) -> Array:
        """Information of the data about the coordinates (k, k), J^T J / sigma^2 of least squares, without the priors."""
        return self.curvature / (self.slope * self.excess)


def fit(readings: Readings, sigma: float | None = None, loss: Loss = "linear", start: Array | None = None) -> Fit:
    """Estimate of the parameters. `sigma` [m]: standard deviation of the readings, None: unknown.

    Raises ValueError for fewer readings than parameters without priors, NoHoldError where the scene itself does not hold the data.
    """
    parameters = readings.plants.parameters
    prior = np.array([0.0 if own.prior is None else (own.scale / own.prior) ** 2 for own in parameters])
    free, count = int((prior == 0.0).sum()), readings.cluster.size
    if count <= free:
        raise ValueError(f"there are {count} readings for {free} parameters without priors: record more holds, or estimate fewer")
    x = np.zeros(len(parameters)) if start is None else start
    length, evaluations = readings.plants.length, 0
    here = FIRST_SIGMA * length if sigma is None else sigma
    rounds = MOST_ROUNDS if sigma is None and (prior.any() or loss != "linear") else 1  # where sigma changes the estimate
    for _ in range(rounds):
        found = _solved(readings, x, here, prior, loss)
        x, evaluations = found.x, evaluations + found.evaluations
        before, here = here, max(_sigma(found, loss), LEAST_SIGMA * length) if sigma is None else sigma
        if abs(here - before) <= SAME_SIGMA * before:
            break
    found = found._replace(sigma=here, evaluations=evaluations)
    return found if loss == "linear" else _spread(found, loss)


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

    def rho(z: Array) -> Array:
        return np.hstack([_rho(z[:size], loss), _rho(z[size:], "linear")])

    done = least_squares(residual, x, jacobian, bounds, loss=rho, xtol=TOLERANCE, ftol=TOLERANCE, gtol=TOLERANCE)
    data, J = readings.residual(done.x), readings.jacobian(done.x)
    return Fit(done.x, data, J, sigma, _rho((data / sigma) ** 2, loss)[1], 1.0, 1.0, prior, int(done.nfev))


def _rho(z: Array, loss: Loss) -> Array:
    """A loss and its first and second derivatives (3, N) at squared readings z = (r / sigma)^2."""
    from scipy.special import boxcox

    power, tuning = ROBUST[loss]
    t, square = 1.0 + z / tuning**2, tuning**2
    return np.array([square * boxcox(t, 1.0 - power), t**-power, -power / square * t ** (-power - 1.0)])


def _sigma(found: Fit, loss: Loss) -> float:
    """Standard deviation [m] of the readings, for as many parameters as the data decide about."""
    count, decided = found.residual.size, _decided(found)
    if loss == "linear":
        return float(np.sqrt(found.residual @ found.residual / max(count - decided, 1.0)))
    size = np.sort(np.abs(found.residual))
    return float(np.median(size[min(round(decided), count - 1) :])) / NORMAL_MEDIAN


def _decided(found: Fit) -> float:
    """Number of parameters that the data decide about, not the priors."""
    data = found.curvature
    return float(np.trace(np.linalg.pinv(data + np.diag(found.prior), hermitian=True) @ data))


def _spread(found: Fit, loss: Loss) -> Fit:
    """A robust fit with the weights, slope and excess at its sigma."""
    z = (found.residual / found.sigma) ** 2
    _, weight, bend = _rho(z, loss)
    slope = max(float((weight + 2.0 * z * bend).sum() / weight.sum()), LEAST_SLOPE)
    found = found._replace(weight=weight, slope=slope)
    return found._replace(excess=float(z @ weight**2) / max(float(weight.sum()) - _decided(found), 1.0) / slope**2)
