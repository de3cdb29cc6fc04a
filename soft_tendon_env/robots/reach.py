"""Reach of an arm: how near constant tensions bring its tip to a target."""

import numpy as np
import scipy.optimize

from soft_tendon_env.model.model import Model
from soft_tendon_env.model.statics import static_equilibrium
from soft_tendon_env.tools.types import Array

NEAR = 0.02
"""Distance from a target, as a share of the arm's length, within which it is reached."""
SEARCH = {"diff_step": 1e-3, "xtol": 1e-4, "ftol": 1e-3, "max_nfev": 20}
"""Ends of a search that is to be right to a fraction of NEAR."""


def distances(model: Model, limits: Array, positions: Array) -> Array:
    """Least distances (m,) [m] from positions (m, 3) [m] at which tensions within limits (n_a, 2) [N] hold the tip.

    By least squares from little tension, and from each tendon pulled, until one of them is NEAR: the result may be too great.
    """
    low, high = limits.T
    starts, found = [low + (high - low) * (0.05 + 0.3 * pulled) for pulled in (0.0, *np.eye(len(low)))], list[float]()
    for position in positions:
        ends = []
        for start in starts:
            end = scipy.optimize.least_squares(
                lambda tension, position=position: static_equilibrium(model, tension).tip_pose[:3, 3] - position,
                start, bounds=(low, high), x_scale=high - low, **SEARCH,
            )  # fmt: skip
            ends.append(float(np.sqrt(2.0 * end.cost)))
            if ends[-1] <= NEAR * model.length:
                break
        found.append(min(ends))
    return np.array(found)
