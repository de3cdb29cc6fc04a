"""Error estimate of one integrator step, as displacement of the rod."""

import math

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.motion.status import NOT_FINITE, OK


@kernel
def rms_displacement(mass_matrix, change, mass):
    """Root mean square displacement of the rod [m] that a change of coordinates makes, sqrt(change^T M change / mass)."""
    total = 0.0
    for i in range(change.size):
        momentum = 0.0
        for j in range(change.size):
            momentum += mass_matrix[i, j] * change[j]
        total += change[i] * momentum
    return math.sqrt(max(total, 0.0) / mass) if total == total else math.nan


@kernel
def error_estimate(rod, horizon, scratch):
    """Status and error estimate [m] of the step to scratch.q, scratch.v: the root mean square displacement of the rod that the errors
    error_q make at once or error_v within a horizon [s], that of a step as a rule, whichever is more."""
    for i in range(scratch.q.size):
        if not (math.isfinite(scratch.q[i]) and math.isfinite(scratch.v[i])):
            return NOT_FINITE, math.inf
    displacement = rms_displacement(scratch.work.M, scratch.error_q, rod.mass[0])
    velocity = rms_displacement(scratch.work.M, scratch.error_v, rod.mass[0])
    return OK, max(displacement, horizon * velocity)
