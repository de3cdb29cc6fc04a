"""Intervals of estimates: linear and bootstrap ones, correlations, and directions in which the data say nothing.

Linear: Student's t times the standard deviations of (J^T J / sigma^2 + P)^-1, as if readings were independent; of a robust loss those of
its M-estimator (P. J. Huber, Robust Statistics, 1981, section 7.6). Bootstrap: clusters of recordings with the same commands are drawn
again as a whole, since errors within one are common, each time with one Newton step from the estimate and with priors drawn around theirs
(A. C. Davison and D. V. Hinkley, Bootstrap Methods and their Application, 1997, sections 3.8 and 7.6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.evaluation.summaries import CONFIDENCE
from soft_tendon_env.identification.fit import Fit
from soft_tendon_env.identification.parameters import Parameter
from soft_tendon_env.identification.readings import Readings
from soft_tendon_env.tools.types import Array

RESAMPLES = 2000
SINGULAR = 1e-9
"""Information along a direction, in parts of the largest, below which there is none: derivatives by differences are not better."""
NOT_SEEN = 1.0
"""Standard deviation of a direction, by the data alone, from which they do not contain it: by a factor of e, or more than the prior's."""
SHARE = 0.3
"""Entry of a unit direction from which a parameter belongs to it."""


class Direction(NamedTuple):
    """Direction of the parameters that the data do not contain. coordinates (k,): a unit vector; deviation: along it, infinite for none."""

    coordinates: Array
    deviation: float


class Intervals(NamedTuple):
    """Intervals at 95 % of k parameters, in their own units.

    low, high: the wider of both, and of what a finer model would change; correlation (k, k) of the linear ones; identified (k,): whether
    the data contain the parameter.
    """

    low: Array
    high: Array
    linear: Array  # (k, 2)
    bootstrap: Array  # (k, 2)
    correlation: Array
    identified: Array
    unseen: list[Direction]


def shift(found: Fit, finer: Readings) -> Array:
    """Change (k,) of the estimate with a finer model of the same data, by one Gauss-Newton step."""
    step = found.slope * found.jacobian.T @ (found.weight * (finer.residual(found.x) - found.residual)) / found.sigma**2
    return -np.asarray(np.linalg.pinv(found.curvature + np.diag(found.prior), hermitian=True) @ step)


def intervals(found: Fit, cluster: Array, parameters: Sequence[Parameter], moved: Array | None = None) -> Intervals:
    """Intervals of an estimate. cluster (N,): index of each reading's recordings, see Readings.cluster; moved (k,): `shift` by a finer
    model, by which low and high are wider."""
    from scipy.special import stdtrit  # here: it takes longer to import than all else that most scenes need

    clusters, count = int(cluster.max()) + 1, found.x.size
    covariance = _inverse(found.information + np.diag(found.prior))
    tail = 0.5 * (1.0 + CONFIDENCE)
    dof = max(found.residual.size - count, 1)
    reach = stdtrit(dof, tail) * np.sqrt(np.diag(covariance))
    spread = stdtrit(max(clusters - 1, 1), tail) * _bootstrap(found, cluster).std(axis=0)
    unseen = _unseen(found)
    identified = np.array([not any(abs(own.coordinates[i]) >= SHARE for own in unseen) for i in range(count)])
    bounds = np.array([own.bounds for own in parameters])
    unlimited = ~np.isfinite(reach)
    reach[unlimited], spread[unlimited] = np.ptp(bounds, axis=1)[unlimited], 0.0
    linear, resampled = (_values(parameters, found.x, own, bounds) for own in (reach, spread))
    widest = _values(parameters, found.x, np.maximum(reach, spread) + (0.0 if moved is None else np.abs(moved)), bounds)
    deviation = np.sqrt(np.where(np.isfinite(np.diag(covariance)), np.diag(covariance), 1.0))
    correlation = np.where(np.isfinite(covariance), covariance, 0.0) / np.outer(deviation, deviation)
    return Intervals(widest[:, 0], widest[:, 1], linear, resampled, correlation, identified, unseen)


def _values(parameters: Sequence[Parameter], x: Array, reach: Array, bounds: Array) -> Array:
    """Values (k, 2) at x -+ reach, within the bounds."""
    ends = np.clip([x - reach, x + reach], *bounds.T)
    return np.array([sorted((own.at(low), own.at(high))) for own, low, high in zip(parameters, *ends, strict=True)])


def _inverse(information: Array) -> Array:
    """Covariance (k, k); infinite variances along directions without information."""
    values, vectors = np.linalg.eigh(information)
    none = values <= SINGULAR * max(values[-1], np.finfo(float).tiny)
    covariance = (vectors[:, ~none] / values[~none]) @ vectors[:, ~none].T
    free = (np.abs(vectors[:, none]) > np.sqrt(SINGULAR)).any(axis=1)
    covariance[free, free] = np.inf
    return np.asarray(covariance)


def _bootstrap(found: Fit, cluster: Array) -> Array:
    """Coordinates (draws, k) of resampled estimates."""
    random, clusters = np.random.default_rng(0), int(cluster.max()) + 1
    J, weight, score = found.jacobian, found.slope / found.sigma**2 * found.weight, found.score
    of = [cluster == i for i in range(clusters)]
    curvature = np.array([(J[own].T * weight[own]) @ J[own] for own in of])
    gradient = np.array([score[own].sum(axis=0) for own in of])
    drawn = random.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=RESAMPLES).astype(float)
    centre = random.normal(size=(RESAMPLES, found.x.size)) * np.sqrt(found.prior)
    A = np.einsum("dr,rij->dij", drawn, curvature) + np.diag(found.prior)
    b = drawn @ gradient + found.prior * found.x - centre
    ridge = SINGULAR * np.trace(A, axis1=1, axis2=2)[:, None, None] * np.eye(found.x.size)
    return found.x - np.linalg.solve(A + ridge, b[..., None])[..., 0]


def _unseen(found: Fit) -> list[Direction]:
    """Directions in which the data alone leave a deviation of NOT_SEEN or more, the least known first."""
    values, vectors = np.linalg.eigh(found.information)
    deviation = np.full(values.size, np.inf)
    some = values > SINGULAR * max(values[-1], np.finfo(float).tiny)
    deviation[some] = values[some] ** -0.5
    return [Direction(vectors[:, i], float(deviation[i])) for i in np.argsort(-deviation) if deviation[i] >= NOT_SEEN]
