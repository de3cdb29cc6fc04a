"""Static balance of forces, f = B u - K + F of (23) without motion, with its derivatives in the
coordinates and in the load."""

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
    """f = part (B u + F) - K at q into `out`, where asked for df/dpart too, and -df/dq along
    `directions` (m, n).

    The strain at q is found with no guess: the result depends on nothing but q. f is affine in the
    part, so a second one gives its rate; slopes are by differences, to a relative 1e-7 or so: G
    lacks the derivative of the load and, away from rest, that of the columns. Returns (-1, 1.0), or
    (block, part of q that was reached) where there is no strain.
    """
    block, reached = strain_from_rest(arm, q, ROUND_OFF, work)
    if block >= 0:
        return block, reached
    other, xi = 0.0 if part > 0.0 else 1.0, work.xi.copy()
    for m in range(-2, directions.shape[0]):
        if m == -1 and not with_rate:
            continue
        copy(xi, work.xi)
        moved = q + DIFFERENCE * directions[m] if m >= 0 else q
        pulls = (other if m == -1 else part) * tension
        block = (
            evaluate_at_rest(arm, pulls, q, ROUND_OFF, work)
            if m == -2
            else balance_at_rest(arm, pulls, moved, ROUND_OFF, work)
        )
        if block >= 0:
            return block, 1.0
        if m == -2:
            for i in range(q.size):
                out.force[i] = work.drive[i] + part * work.load[i]
            copy(work.drive, out.rate)
            copy_matrix(work.G, out.G)
        elif m == -1:
            for i in range(q.size):
                out.rate[i] = (out.rate[i] - work.drive[i]) / (part - other) + work.load[i]
        else:
            for i in range(q.size):
                out.slopes[i, m] = (out.force[i] - work.drive[i] - part * work.load[i]) / DIFFERENCE
    return -1, 1.0


@kernel(refcount=True)
def strain_is_continuous(arm, q_from, q, work):
    """Whether the strain from rest at q_from becomes that at q on the way between them; tendons
    that push can part them."""
    if strain_is_unique(arm, q, work):
        return True
    begins = strain_from_rest(arm, q_from, ROUND_OFF, work)[0] < 0
    if not begins or continue_strain(arm, (q_from, 1.0), (q, 1.0), ROUND_OFF, work)[0] >= 0:
        return False
    continued = work.xi.copy()
    if strain_from_rest(arm, q, ROUND_OFF, work)[0] >= 0:
        return False
    return np.abs(work.xi - continued).max() <= ALIKE * np.abs(continued).max()
