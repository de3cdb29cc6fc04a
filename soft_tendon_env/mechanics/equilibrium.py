"""The balance of an arm at rest, B u - K + F = 0, (23) without motion, and its derivative."""

import math

import numpy as np

from soft_tendon_env.compilation import kernel
from soft_tendon_env.mechanics.step import evaluate

ROUND_OFF = 1e-12  # relative tolerance of the strain
DIFFERENCE = 1e-6  # of a coordinate, in units that store the energy of reference


@kernel
def unbalanced_force(arm, u, q, part, work, force):
    """B u - K + part F at q, from the guess in work.xi; -1, or the block at which the strain could not be found."""
    failed = evaluate(arm, u, q, np.zeros(q.size), ROUND_OFF, work)
    force[:] = work.drive + part * work.load
    return failed


@kernel
def stiffness_by_differences(arm, u, q, part, energy, work, out):
    """-d(B u - K + part F)/dq, column by column, after unbalanced_force() at the same q; as unbalanced_force().

    work.G lacks the derivative of the load and, away from rest, that of the columns; both are in here, to a relative 1e-6.
    """
    n = q.size
    force, moved_force = work.drive + part * work.load, np.zeros(n)
    xi, scale = work.xi.copy(), np.diag(work.G).copy()
    for j in range(n):
        step = DIFFERENCE * math.sqrt(energy / scale[j])
        moved = q.copy()
        moved[j] += step
        work.xi[:] = xi
        failed = unbalanced_force(arm, u, moved, part, work, moved_force)
        if failed >= 0:
            return failed
        out[:, j] = (force - moved_force) / step
    return -1
