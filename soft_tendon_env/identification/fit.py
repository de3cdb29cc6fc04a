"""Least squares with priors: the parameters at which markers agree best, with intervals.

Simulated and measured marker positions agree.

Minimises sum (r / sigma)^2 + sum (x / prior)^2 within bounds (scipy.optimize.least_squares); a
sigma that is not given is the root mean square of the residuals. Intervals are the wider of two.
Linear: Student's t times the standard deviations of (J^T J / sigma^2 + P)^-1, as if readings were
independent. Bootstrap: clusters of recordings (of a group, or with the same commands) are drawn
again as a whole, since errors within one are common, each time with one Newton step from the
estimate and priors drawn around theirs (Davison and Hinkley 1997, 3.8 and 7.6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from soft_tendon_env.evaluation.summaries import CONFIDENCE
from soft_tendon_env.identification.parameters import Parameter
from soft_tendon_env.identification.readings import NoHoldError, Readings
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

FIRST_SIGMA = 0.02  # standard deviation of readings at first, as a share of the rod's length
LEAST_SIGMA = 1e-8  # at least, as a share of the rod's length
SAME_SIGMA = 0.02  # relative change of it below which another round would change nothing
MOST_ROUNDS = 10  # in which it and the estimate are sought in turn
RESAMPLES = 2000  # of the bootstrap: its standard deviations are good to 2 %
TOLERANCE = 1e-8  # of the method, on coordinates, sum of squares and gradient
ROOM = 0.02  # distance from bounds, of that of both, at which the method begins
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
        """Information of the data about the coordinates (k, k), J^T J / sigma^2.

        It is without the priors.
        """
        product = self.jacobian.T @ self.jacobian
        variance = self.sigma**2
        return np.asarray(product) / variance


class Intervals(NamedTuple):
    """Intervals at 95 % of k parameters, in their own units.

    They are low and high; identified (k,): whether the data contain the parameter; unseen:
    directions (k,) of the coordinates that they do not contain, the least known first.
    """

    low: Array
    high: Array
    identified: Array
    unseen: list[Array]


def fit(readings: Readings, sigma: float | None = None) -> Fit:
    """Estimates parameters by least squares with priors, from readings of recordings.

    Args:
        readings: of the recordings to fit to.
        sigma: standard deviation [m] of the readings, None: unknown.

    Returns:
        The estimate, with the linearised readings there.

    Raises:
        ValueError: for fewer readings than parameters without priors.
        NoHoldError: where the scene itself does not hold the data.
    """
    length = readings.plants.model.length
    prior = _prior_information(readings.plants.parameters)
    count = readings.cluster.size
    free = int((prior == 0.0).sum())
    if count <= free:
        raise ValueError(
            f"there are {count} readings for {free} parameters without priors: record more holds,"
            " or estimate fewer"
        )
    x = np.zeros(prior.size)
    if sigma is None:
        deviation = FIRST_SIGMA * length
    else:
        deviation = sigma
    # without priors a deviation scales all squares alike, and the estimate stays
    if sigma is None and prior.any():
        rounds = MOST_ROUNDS
    else:
        rounds = 1
    for _ in range(rounds):
        estimate = _solve(readings, x, deviation, prior)
        x = estimate.x
        before = deviation
        if sigma is None:
            deviation = max(_root_mean_square(estimate), LEAST_SIGMA * length)
        change = abs(deviation - before)
        if not estimate.converged or change <= SAME_SIGMA * before:
            break
    return estimate._replace(sigma=deviation)


def _prior_information(parameters: Sequence[Parameter]) -> Array:
    """Inverse variances (k,) of the priors of coordinates, 0 without a prior."""
    information = np.zeros(len(parameters))
    for i, parameter in enumerate(parameters):
        if parameter.prior is not None:
            precision = parameter.scale / parameter.prior
            information[i] = precision**2
    return information


def _root_mean_square(estimate: Fit) -> float:
    """Standard deviation [m] of readings from their residuals.

    The degrees of freedom that the data decided are left out.
    """
    data = estimate.information
    prior = np.diag(estimate.prior)
    posterior = np.linalg.pinv(data + prior, hermitian=True)
    share_of_data = posterior @ data
    decided = float(np.trace(share_of_data))  # parameters: the priors decide the others
    residual = estimate.residual
    freedom = max(residual.size - decided, 1.0)
    variance = residual @ residual / freedom
    return float(np.sqrt(variance))


def _solve(readings: Readings, x: Array, sigma: float, prior: Array) -> Fit:
    """Estimate at a given standard deviation, from coordinates x (k,) on."""
    # here: it takes longer to import than all else that most scenes need
    from scipy.optimize import least_squares

    # rows of the priors stand beneath those of the readings
    roots = np.diag(np.sqrt(prior))
    root = roots[prior > 0.0]
    bounds_of_parameters = [parameter.bounds for parameter in readings.plants.parameters]
    bounds = np.array(bounds_of_parameters).T
    low, high = bounds
    inside = ROOM * np.ptp(bounds, axis=0)  # from a bound itself the method hardly moves
    start = np.clip(x, low + inside, high - inside)
    size = readings.residual(start).size  # raises where the scene itself does not hold the data

    def residual(x: Array) -> Array:
        try:
            data = readings.residual(x)
        except (NoHoldError, ConfigurationError):  # the trust region shrinks
            data = np.full(size, np.inf)
        both = [data / sigma, root @ x]
        return np.concatenate(both)

    def jacobian(x: Array) -> Array:
        scaled = readings.jacobian(x) / sigma
        return np.vstack([scaled, root])

    result = least_squares(
        residual,
        start,
        jacobian,
        bounds,
        xtol=TOLERANCE,
        ftol=max(PROGRESS / size, TOLERANCE),
        gtol=TOLERANCE,
        max_nfev=MOST_TRIALS,
    )
    return Fit(
        x=result.x,
        residual=sigma * result.fun[:size],
        jacobian=sigma * result.jac[:size],
        sigma=sigma,
        prior=prior,
        converged=result.success,
    )


def intervals(estimate: Fit, readings: Readings) -> Intervals:
    """Intervals of an estimate at 95 %, the wider of linear and bootstrap ones.

    Args:
        estimate: of `fit`.
        readings: those that it is of.

    Returns:
        Intervals in the parameters' own units, and what the data do not contain.
    """
    # here: it takes longer to import than all else that most scenes need
    from scipy.special import stdtrit

    parameters = readings.plants.parameters
    every_bound = [parameter.bounds for parameter in parameters]
    bounds = np.array(every_bound)
    tail = 0.5 * (1.0 + CONFIDENCE)
    # Student's t of an error that is estimated from the same readings
    freedom = estimate.residual.size - estimate.x.size
    reading_freedom = max(freedom, 1)
    deviation = np.sqrt(variances(estimate))
    linear = stdtrit(reading_freedom, tail) * deviation
    # errors within a cluster are common: there are as many independent ones as clusters
    clusters = int(readings.cluster.max())
    cluster_freedom = max(clusters, 1)
    draws = _bootstrap(estimate, readings.cluster)
    drawn_deviation = draws.std(axis=0)
    bootstrap = stdtrit(cluster_freedom, tail) * drawn_deviation
    wider = np.maximum(linear, bootstrap)
    between_bounds = np.ptp(bounds, axis=1)  # where the data say nothing
    is_known = np.isfinite(linear)
    reach = np.where(is_known, wider, between_bounds)
    least, greatest = bounds.T
    lower = np.maximum(estimate.x - reach, least)
    upper = np.minimum(estimate.x + reach, greatest)
    values = []
    for parameter, x_low, x_high in zip(parameters, lower, upper, strict=True):
        # the value of a factor of a negative number falls with its coordinate
        at_low = parameter.at(x_low)
        at_high = parameter.at(x_high)
        unordered = (at_low, at_high)
        ends = sorted(unordered)
        values.append(ends)
    low, high = np.array(values).T
    identified, unseen = _identified(estimate)
    return Intervals(
        low=low,
        high=high,
        identified=identified,
        unseen=unseen,
    )


def variances(estimate: Fit) -> Array:
    """Variances of the coordinates, of data and priors.

    Args:
        estimate: of `fit`.

    Returns:
        Variances (k,), infinite without information.
    """
    prior = np.diag(estimate.prior)
    total = estimate.information + prior
    information, directions = np.linalg.eigh(total)
    tiny = np.finfo(float).tiny
    largest = max(information[-1], tiny)
    is_known = information > SINGULAR * largest
    empty = directions[:, ~is_known]
    known = directions[:, is_known]
    # parameters with a part of an empty direction
    size = np.abs(empty)
    least_size = np.sqrt(SINGULAR)
    is_part = size > least_size
    is_free = is_part.any(axis=1)
    parts = known**2 / information[is_known]
    variances = parts.sum(axis=1)
    return np.where(is_free, np.inf, variances)


def _identified(estimate: Fit) -> tuple[Array, list[Array]]:
    """Whether the data contain each parameter (k,), and directions (k,) that they do not.

    The least known direction comes first.
    """
    information, directions = np.linalg.eigh(estimate.information)
    largest = information[-1]
    least = max(SEEN, SINGULAR * largest)
    is_seen = information > least
    unseen = directions[:, ~is_seen]
    # a parameter is identified that no such direction has a part of
    is_without = np.abs(unseen) < UNSEEN
    identified = is_without.all(axis=1)
    return identified, [*unseen.T]


def _bootstrap(estimate: Fit, cluster: Array) -> Array:
    """Coordinates (draws, k) of resampled estimates, by one Newton step each.

    cluster: index of each reading (N,).
    """
    random = np.random.default_rng(0)
    clusters = int(cluster.max()) + 1
    weight = estimate.sigma**-2
    # curvature J^T J and gradient J^T r of the sum of squares, cluster by cluster
    curvature = list[Array]()
    gradient = list[Array]()
    for i in range(clusters):
        is_drawn = cluster == i
        J = estimate.jacobian[is_drawn]
        r = estimate.residual[is_drawn]
        weighted = weight * J.T
        curvature.append(weighted @ J)
        gradient.append(weighted @ r)
    # how often each cluster is drawn, with as many draws as there are clusters
    shares = np.full(clusters, 1.0 / clusters)
    draws = random.multinomial(clusters, shares, size=RESAMPLES)
    times = draws.astype(float)
    # b, of the priors' centres that are drawn too
    k = estimate.x.size
    normal = random.normal(size=(RESAMPLES, k))
    prior_root = np.sqrt(estimate.prior)
    prior_draw = normal * prior_root
    # one Newton step of each draw: (J^T J + P) step = J^T r + P x - b
    P = estimate.prior
    curvatures = np.array(curvature)
    data_part = np.einsum("dr,rij->dij", times, curvatures)
    A = data_part + np.diag(P)
    gradient_part = times @ np.array(gradient)
    pull = P * estimate.x
    right = gradient_part + pull - prior_draw
    # keeps A invertible where a draw leaves out all that says something about a parameter
    traces = np.trace(A, axis1=1, axis2=2)
    ridge = SINGULAR * traces
    factors = ridge[:, None, None]
    A += factors * np.eye(k)
    columns = right[..., None]
    step = np.linalg.solve(A, columns)
    return estimate.x - step[..., 0]
