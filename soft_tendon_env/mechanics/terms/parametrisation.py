"""Strain parametrisations: registry of their compiled functions, and continuation.

The continuation finds a strain without a guess.

A parametrisation is a struct of arrays (types.py), the arm's `strain`, and five compiled functions.
Its class is part of the compiled type, so it selects their code.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.statics_newton import (
    ANY,
    CONTRACTION,
    Search,
    all_pull,
    chords_stay,
)

SMALLEST_PART = 1e-5  # of what was reached, in a continuation
LEAST_PART = 1e-9  # of the way
MARGIN_PARTS = 16


class Parametrisation(NamedTuple):
    """The functions of one parametrisation.

    Each takes the arm and its strain law first, and reads and writes the strain fields of a
    workspace.

    solve(arm, law, q, search, strain, kinematics) finds the strain at q, see Search, into
    strain.xi, from the guess there; -1, or the block at which it could not be found. Loads inside
    the strain move the poses for that. Where it has just left the strain, columns(arm, law,
    tension, q, q_dot, strain, kinematics) makes xi_dot, xi_bias, the columns Phi and, under
    tensions (n_a,), the mismatch, of which B u - K is made; matrices(arm, law, strain, ones,
    matrices) D and G of these, where ones (points x 6) are a weight; rate(arm, law, q_dot, strain)
    xi_dot alone. is_unique(arm, law, q, strain): whether at most one strain belongs to q.
    """

    solve: Callable[..., Any]
    columns: Callable[..., Any]
    matrices: Callable[..., Any]
    is_unique: Callable[..., Any]
    rate: Callable[..., Any]


PARAMETRISATIONS: dict[type, Parametrisation] = {}
"""The functions of every parametrisation, by the class of its arrays."""


def _of_the_arm(name):
    """Function of this name of an arm's parametrisation.

    It is to be called with the arm and all arguments after the law.
    """

    def call(arm, *arguments):
        function = getattr(PARAMETRISATIONS[type(arm.strain)], name)
        return function(arm, arm.strain, *arguments)

    @overload(call)
    def _compiled(arm, *arguments):
        law = arm.fields["strain"].instance_class
        function = getattr(PARAMETRISATIONS[law], name)
        return lambda arm, *arguments: function(arm, arm.strain, *arguments)

    return call


solve_strain_at = _of_the_arm("solve")
strain_is_unique = _of_the_arm("is_unique")
strain_columns = _of_the_arm("columns")
strain_matrices = _of_the_arm("matrices")
strain_rate = _of_the_arm("rate")


@kernel(inline=True)
def strain_from_guess(arm, q, tolerance, strain, kinematics):
    """Strain at q into strain.xi, from the guess there.

    Returns -1, or the block at which it could not be found.
    """
    return solve_strain_at(arm, q, Search(1.0, tolerance, ANY), strain, kinematics)


@kernel(refcount=True)
def continue_strain(arm, begin, end, tolerance, strain, kinematics):
    """Strain at the end of a way on the branch of that at its beginning.

    That is in strain.xi; it goes in growing or halved parts of the way.

    begin, end: coordinates (n,) and the part of the loads inside. Where the strain need not be the
    only one, parts are so small that Newton contracts at once and, with tendons that push, no chord
    moves far. Returns (-1, 1.0), or (the block that stopped it, the part of the way that was
    reached, whose strain is left in strain.xi).
    """
    q_begin, part_begin = begin
    q_end, part_end = end
    reached = 0.0
    step = 1.0
    last_good = strain.xi.copy()
    while reached < 1.0:
        ahead = reached + step if step < 1.0 - reached else 1.0
        q_ahead = q_begin + ahead * (q_end - q_begin)
        part = part_begin + ahead * (part_end - part_begin)
        unique = strain_is_unique(arm, q_ahead, strain)
        contraction = ANY if unique else CONTRACTION
        copy(last_good, strain.xi)
        search = Search(part, tolerance, contraction)
        failed = solve_strain_at(arm, q_ahead, search, strain, kinematics)
        is_good = failed < 0
        if is_good and not unique and not all_pull(strain.tau):
            # of several strains it should be the one near the last
            is_good = chords_stay(arm.rod, arm.tendons, last_good, strain.xi)
        if is_good:
            step = 2.0 * (ahead - reached)
            reached = ahead
            copy(strain.xi, last_good)
        else:
            step = 0.5 * (ahead - reached)
            if step < max(SMALLEST_PART * reached, LEAST_PART):
                copy(last_good, strain.xi)
                return max(failed, 0), reached
    return -1, 1.0


@kernel(refcount=True)
def strain_from_rest(arm, q, tolerance, strain, kinematics):
    """Strain at q on the branch from the stress-free rod, as continue_strain().

    On it coordinates and loads inside grow together.
    """
    copy(arm.rod.reference_strain, strain.xi)
    if strain_is_unique(arm, q, strain):
        if strain_from_guess(arm, q, tolerance, strain, kinematics) < 0:
            return -1, 1.0
        copy(arm.rod.reference_strain, strain.xi)
    rest = (np.zeros(q.size), 0.0)
    return continue_strain(arm, rest, (q, 1.0), tolerance, strain, kinematics)


@kernel(refcount=True)
def strain_has_margin(arm, q, tolerance, strain, kinematics):
    """Tells whether there is a strain at q, with a margin where it need not be the only one.

    There is then one a MARGIN_PARTS-th beyond too, with Newton contracting at once in each of these
    even parts of the way from rest.
    """
    if strain_is_unique(arm, q, strain):
        return strain_from_rest(arm, q, tolerance, strain, kinematics)[0] < 0
    copy(arm.rod.reference_strain, strain.xi)
    for k in range(MARGIN_PARTS + 1):
        part = (k + 1.0) / MARGIN_PARTS
        search = Search(part, tolerance, CONTRACTION)
        if solve_strain_at(arm, part * q, search, strain, kinematics) >= 0:
            return False
    return True
