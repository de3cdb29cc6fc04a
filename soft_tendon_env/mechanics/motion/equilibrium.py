"""Static balance of forces, f = B u - K + F of (23) without motion.

It has derivatives in the coordinates and in the load.
"""

from typing import NamedTuple

import numpy as np

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy, copy_matrix
from soft_tendon_env.mechanics.terms.evaluate import balance_at_rest, evaluate_at_rest
from soft_tendon_env.mechanics.terms.parametrisation import (
    continue_strain,
    strain_from_rest,
    strain_is_unique,
)

ROUND_OFF = 1e-12  # relative tolerance of the strain
DIFFERENCE = 1e-7  # of a direction
ALIKE = 1e-6  # relative difference of strains that are the same


class Linearisation(NamedTuple):
    """The balance at coordinates q (n,) under a part of the load, to first order in both."""

    force: np.ndarray  # f (n,)
    G: np.ndarray  # (n, n), the drive's stiffness: the energy norm of coordinates
    rate: np.ndarray  # df/dpart = B u + F (n,)
    slopes: np.ndarray  # -df/dq times each of m directions (n, m)


@kernel(refcount=True)
def linearise_balance(arm, tension, q, part, with_rate, directions, work, out):
    """Static balance f = part (B u + F) - K at q into `out`, with its derivatives.

    They are df/dpart where asked for, and -df/dq along `directions` (m, n).

    The strain at q is found with no guess: the result depends on nothing but q. f is affine in the
    part, so a second one gives its rate; slopes are by differences, to a relative 1e-7 or so: G
    lacks the derivative of the load and, away from rest, that of the columns. Returns (-1, 1.0), or
    (block, part of q that was reached) where there is no strain.
    """
    strain = work.strain
    drive = work.forces.drive
    load = work.forces.load
    block, reached = strain_from_rest(arm, q, ROUND_OFF, strain, work.kinematics)
    if block >= 0:
        return block, reached
    xi = strain.xi.copy()
    pulls = part * tension
    # f at q, with G
    block = evaluate_at_rest(arm, pulls, q, ROUND_OFF, work)
    if block >= 0:
        return block, 1.0
    copy_matrix(work.matrices.G, out.G)
    for i in range(q.size):
        out.force[i] = drive[i] + part * load[i]
    # its rate, of the drive under another part
    if with_rate:
        other = 0.0 if part > 0.0 else 1.0
        copy(drive, out.rate)
        copy(xi, strain.xi)
        block = balance_at_rest(arm, other * tension, q, ROUND_OFF, work)
        if block >= 0:
            return block, 1.0
        for i in range(q.size):
            difference = out.rate[i] - drive[i]
            out.rate[i] = difference / (part - other) + load[i]
    # its slopes, from the strain at q
    for m in range(directions.shape[0]):
        copy(xi, strain.xi)
        moved = q + DIFFERENCE * directions[m]
        block = balance_at_rest(arm, pulls, moved, ROUND_OFF, work)
        if block >= 0:
            return block, 1.0
        for i in range(q.size):
            change = out.force[i] - drive[i] - part * load[i]
            out.slopes[i, m] = change / DIFFERENCE
    return -1, 1.0


@kernel(refcount=True)
def strain_is_continuous(arm, q_from, q, strain, kinematics):
    """Tells whether the strain from rest at q_from becomes that at q on the way between them.

    Tendons that push can part them.
    """
    if strain_is_unique(arm, q, strain):
        return True
    if strain_from_rest(arm, q_from, ROUND_OFF, strain, kinematics)[0] >= 0:
        return False
    begin = (q_from, 1.0)
    end = (q, 1.0)
    if continue_strain(arm, begin, end, ROUND_OFF, strain, kinematics)[0] >= 0:
        return False
    continued = strain.xi.copy()
    if strain_from_rest(arm, q, ROUND_OFF, strain, kinematics)[0] >= 0:
        return False
    difference = np.abs(strain.xi - continued).max()
    return difference <= ALIKE * np.abs(continued).max()
