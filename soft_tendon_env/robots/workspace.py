"""Workspace of an arm: how near constant tensions bring its tip to a target."""

import numpy as np
import scipy.optimize

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.types import Array

NEAR = 0.02
"""Distance from a target, as a share of the arm's length, within which it is reached."""


def distances(model: Model, limits: Array, positions: Array) -> Array:
    """Least distances (m,) [m] from positions (m, 3) [m] at which tensions within limits (n_a, 2) [N] hold the tip.

    By least squares from little tension, then from each tendon pulled, until the tip is NEAR; minima are local.
    """
    (low, high), near = limits.T, NEAR * model.length
    starts = low + (high - low) * (0.05 + 0.3 * np.vstack([np.zeros(len(low)), np.eye(len(low))]))

    def distance(position: Array, start: Array) -> float:
        def away(tension: Array) -> Array:
            return static_equilibrium(model, tension).tip_pose[:3, 3] - position

        options = {"x_scale": high - low, "diff_step": 1e-3, "xtol": 1e-4, "ftol": 1e-3, "max_nfev": 20}  # to a fraction of NEAR
        return float(np.linalg.norm(scipy.optimize.least_squares(away, start, bounds=(low, high), **options).fun))

    found = np.full(len(positions), np.inf)
    for i, position in enumerate(positions):
        for start in starts:
            found[i] = min(found[i], distance(position, start) if found[i] > near else np.inf)
    return found
