"""Parameters that held-out recordings do not call for: overfitting, where fewer judge as well."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from soft_tendon_env.identification.fit import Fit, variances
from soft_tendon_env.identification.readings import NoHoldError, Readings, mean_of_finite
from soft_tendon_env.tools.configuration import ConfigurationError
from soft_tendon_env.tools.types import Array

# mean error of held-out recordings, in parts of the fit's, from which fewer are tried
OVERFIT = 1.25
Places = NDArray[np.signedinteger[Any]]  # of parameters
KEPT = (0.0, 0.25, 0.5, 0.75)  # shares of the parameters that are tried, the fewest first
SAME = 0.02  # part of the held-out error that counts as none


def fewer_parameters_text(estimate: Fit, fit_error: float, judge: Readings) -> str | None:
    """Finding that fewer parameters meet held-out recordings as well.

    Those with the least change beside its standard deviation are left out first, and the others
    follow by one Newton step.

    Args:
        estimate: of `fit`.
        fit_error: mean error [m] of the recordings that it was fitted to.
        judge: held-out readings.

    Returns:
        A sentence with the parameters that can be left out; None where all serve, nothing is held
        out, or held-out recordings are met as well as those of the fit.
    """
    held_out_error = mean_of_finite(judge.errors(estimate.x).values())
    if not held_out_error > OVERFIT * fit_error:
        return None
    count = estimate.x.size
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = np.sqrt(variances(estimate))
        significance = np.abs(estimate.x) / deviation
    least_first = np.argsort(significance)
    counts = {int(share * count) for share in KEPT}
    kept_counts = sorted(counts)
    as_good = (1.0 + SAME) * held_out_error
    for kept in kept_counts:
        left_out = least_first[: count - kept]
        error = _error_without(estimate, left_out, judge)
        if error <= as_good:
            parameters = judge.plants.parameters
            left_out_names = (parameters[i].name for i in sorted(left_out))
            names = ", ".join(left_out_names)
            return (
                f"{count} parameters judge no better than {kept}: held-out recordings are off by"
                f" {1e3 * held_out_error:.3g} mm, and by {1e3 * error:.3g} mm without"
                f" {names}; those of the fit by {1e3 * fit_error:.3g} mm. Leave them"
                " out, or record more."
            )
    return None


def _error_without(estimate: Fit, left_out: Places, judge: Readings) -> float:
    """Mean error [m] of held-out readings where some parameters keep the scene's numbers.

    It is infinite where that arm does not hold them.
    """
    x = _estimate_without(estimate, left_out)
    bounds_of_parameters = [parameter.bounds for parameter in judge.plants.parameters]
    bounds = np.array(bounds_of_parameters)
    low, high = bounds.T
    x_within = np.clip(x, low, high)
    try:
        errors = judge.errors(x_within)
    except (NoHoldError, ConfigurationError):
        return np.inf
    return mean_of_finite(errors.values())


def _estimate_without(estimate: Fit, left_out: Places) -> Array:
    """Coordinates (k,) of the linearised least squares where those left out are zero."""
    is_kept = np.ones(estimate.x.size, dtype=bool)
    is_kept[left_out] = False
    # the sum of squares is stationary at the estimate: (A + P) step = 0, with the step of those
    # left out given
    prior = np.diag(estimate.prior)
    normal = estimate.information + prior
    step = np.where(is_kept, 0.0, -estimate.x)
    force = normal @ step
    kept = np.flatnonzero(is_kept)
    kept_normal = normal[np.ix_(kept, kept)]
    kept_force = force[kept]
    answer, *_ = np.linalg.lstsq(kept_normal, -kept_force, rcond=None)
    step[kept] = answer
    return np.asarray(estimate.x + step)
