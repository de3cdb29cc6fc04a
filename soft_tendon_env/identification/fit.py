"""Least squares with priors: the parameters at which simulated and measured marker positions agree
best, and their intervals.

Minimises sum (r / sigma)^2 + sum (x / prior)^2 within bounds (scipy.optimize.least_squares); a
sigma that is not given is the root mean square of the residuals. Intervals are the wider of two.
Linear: Student's t times the standard deviations of (J^T J / sigma^2 + P)^-1, as if readings were
independent. Bootstrap: clusters of recordings (of a group, or with the same commands) are drawn
again as a whole, since errors within one are common, each time with one Newton step from the
estimate and priors drawn around theirs (Davison and Hinkley 1997, 3.8 and 7.6).
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.evaluation.summaries import CONFIDENCE
from soft_tendon_env.identification.readings import NoHoldError, Readings
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

FIRST_SIGMA, LEAST_SIGMA = (
    0.02,
    1e-8,
)  # standard deviations of readings at first, and at least, as shares of the rod's length
SAME_SIGMA, MOST_ROUNDS, RESAMPLES = 0.02, 10, 2000
TOLERANCE, ROOM = (
    1e-8,
    0.02,
)  # of the method, and the distance from bounds, of that of both, at which it begins
# fall of the sum of squares, in mean squares of a reading, that says nothing: a parameter moves by
# 3 % of its deviation
PROGRESS = 1e-3
# of parameters, up to which the method goes on: where tendons go slack, readings have kinks along
# which it creeps
MOST_TRIALS = 100
# information along a direction, in parts of the largest, below which there is none, as of errors of
# differences
SINGULAR = 1e-9
# information along a direction up to which the data do not contain it: no better than a factor of
# e, or the prior
SEEN = 1.0
UNSEEN = 0.3  # entry of a unit direction from which a parameter belongs to it


class Fit(NamedTuple):
    """Estimate, and the linearised readings there."""

    x: Array  # (k,) dimensionless coordinates
    residual: Array  # (N,) [m]
    jacobian: Array  # (N, k) [m]
    sigma: float  # [m], standard deviation of a reading
    prior: Array  # (k,) inverse variances of the coordinates, 0 without a prior
    converged: bool

    @property
    def information(self) -> Array:
        """Information of the data about the coordinates (k, k), J^T J / sigma^2, without the
        priors."""
        return np.asarray(self.jacobian.T @ self.jacobian) / self.sigma**2


class Intervals(NamedTuple):
    """Intervals at 95 % of k parameters, in their own units: low and high; identified (k,): whether
    the data contain the parameter; unseen: directions (k,) of the coordinates that they do not
    contain, the least known first."""

    low: Array
    high: Array
    identified: Array
    unseen: list[Array]


def fit(readings: Readings, sigma: float | None = None) -> Fit:
    """Estimate of the parameters. sigma: standard deviation [m] of the readings, None: unknown.
    Raises ValueError for fewer readings than parameters without priors, NoHoldError where the scene
    itself does not hold the data."""
    parameters, length = readings.plants.parameters, readings.plants.model.length
    prior = np.array(
        [0.0 if one.prior is None else (one.scale / one.prior) ** 2 for one in parameters]
    )
    free, count = int((prior == 0.0).sum()), readings.cluster.size
    if count <= free:
        raise ValueError(
            f"there are {count} readings for {free} parameters without priors: record more holds,"
            " or estimate fewer"
        )
    x, here = np.zeros(len(parameters)), FIRST_SIGMA * length if sigma is None else sigma
    for _ in range(
        MOST_ROUNDS if sigma is None and prior.any() else 1
    ):  # where sigma changes the estimate
        found = _solve(readings, x, here, prior)
        x, before, data = found.x, here, found.information
        if sigma is None:
            decided = float(
                np.trace(np.linalg.pinv(data + np.diag(prior), hermitian=True) @ data)
            )  # parameters: the priors decide others
            here = max(
                float(np.sqrt(found.residual @ found.residual / max(count - decided, 1.0))),
                LEAST_SIGMA * length,
            )
        if not found.converged or abs(here - before) <= SAME_SIGMA * before:
            break
    return found._replace(sigma=here)


def _solve(readings: Readings, x: Array, sigma: float, prior: Array) -> Fit:
    """Estimate at a given standard deviation, from coordinates x (k,) on."""
    from scipy.optimize import (
        least_squares,
    )  # here: it takes longer to import than all else that most scenes need

    root = np.diag(np.sqrt(prior))[prior > 0.0]
    bounds = np.array([one.bounds for one in readings.plants.parameters]).T
    inside = ROOM * np.ptp(bounds, axis=0)  # from a bound itself the method hardly moves
    x = np.clip(x, bounds[0] + inside, bounds[1] - inside)
    size = readings.residual(x).size  # raises where the scene itself does not hold the data

    def residual(at: Array) -> Array:
        try:
            data = readings.residual(at)
        except (NoHoldError, ConfigurationError):  # the trust region shrinks
            data = np.full(size, np.inf)
        return np.concatenate([data / sigma, root @ at])

    def jacobian(at: Array) -> Array:
        return np.vstack([readings.jacobian(at) / sigma, root])

    ftol = max(PROGRESS / size, TOLERANCE)
    done = least_squares(
        residual,
        x,
        jacobian,
        bounds,
        xtol=TOLERANCE,
        ftol=ftol,
        gtol=TOLERANCE,
        max_nfev=MOST_TRIALS,
    )
    return Fit(done.x, sigma * done.fun[:size], sigma * done.jac[:size], sigma, prior, done.success)


def intervals(found: Fit, readings: Readings) -> Intervals:
    """Intervals of an estimate from readings."""
    from scipy.special import (
        stdtrit,
    )  # here: it takes longer to import than all else that most scenes need

    parameters, cluster, tail = (
        readings.plants.parameters,
        readings.cluster,
        0.5 * (1.0 + CONFIDENCE),
    )
    bounds = np.array([one.bounds for one in parameters])
    values, vectors = np.linalg.eigh(found.information + np.diag(found.prior))
    none = values <= SINGULAR * max(
        values[-1], np.finfo(float).tiny
    )  # directions without information
    free = (np.abs(vectors[:, none]) > np.sqrt(SINGULAR)).any(axis=1)
    variances = np.where(free, np.inf, (vectors[:, ~none] ** 2 / values[~none]).sum(axis=1))
    linear = stdtrit(max(found.residual.size - found.x.size, 1), tail) * np.sqrt(variances)
    bootstrap = stdtrit(max(int(cluster.max()), 1), tail) * _bootstrap(found, cluster).std(axis=0)
    reach = np.where(np.isfinite(linear), np.maximum(linear, bootstrap), np.ptp(bounds, axis=1))
    ends = np.clip([found.x - reach, found.x + reach], *bounds.T)
    low, high = np.array(
        [
            sorted((one.at(low), one.at(high)))
            for one, low, high in zip(parameters, *ends, strict=True)
        ]
    ).T
    information, vectors = np.linalg.eigh(found.information)
    seen = information > max(SEEN, SINGULAR * information[-1])
    identified = (np.abs(vectors[:, ~seen]) < UNSEEN).all(axis=1)
    return Intervals(low, high, identified, [*vectors[:, ~seen].T])


def _bootstrap(found: Fit, cluster: Array) -> Array:
    """Coordinates (draws, k) of resampled estimates."""
    random, clusters, weight = np.random.default_rng(0), int(cluster.max()) + 1, found.sigma**-2
    parts = [(found.jacobian[cluster == i], found.residual[cluster == i]) for i in range(clusters)]
    curvature = np.array([weight * J.T @ J for J, _ in parts])
    gradient = np.array([weight * J.T @ r for J, r in parts])
    drawn = random.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=RESAMPLES).astype(
        float
    )
    centre = random.normal(size=(RESAMPLES, found.x.size)) * np.sqrt(found.prior)
    A = np.einsum("dr,rij->dij", drawn, curvature) + np.diag(found.prior)
    b = drawn @ gradient + found.prior * found.x - centre
    ridge = SINGULAR * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(found.x.size)
    return found.x - np.linalg.solve(A + ridge, b[..., None])[..., 0]
