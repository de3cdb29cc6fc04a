"""Strain parametrisations: registry of their compiled functions, and the continuation that finds a
strain without a guess.

A parametrisation is a struct of arrays (types.py), the arm's `strain`, and five compiled functions.
Its class is part of the compiled type, so it selects their code.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.linear import copy
from soft_tendon_env.mechanics.terms.statics_newton import ANY, CONTRACTION, all_pull, chords_stay

SMALLEST_PART = 1e-5  # of what was reached, in a continuation
LEAST_PART = 1e-9  # of the way
MARGIN_PARTS = 16


class Parametrisation(NamedTuple):
    """The functions of one parametrisation. Each takes the arm and its strain first, and the
    workspace last.

    solve(arm, strain, q, part, tolerance, contraction, work) finds the strain at q under `part` of
    the loads inside it, into work.xi, from the guess there; -1, or the block at which it could not
    be found; contraction: see CONTRACTION. Where it has just left the strain, columns(arm, strain,
    u, q, q_dot, work) makes xi_dot, xi_bias, the columns Phi and, under tensions u, the mismatch,
    of which B u - K is made; matrices(arm, strain, work) D and G of these; rate(arm, strain, q_dot,
    work) xi_dot alone. is_unique(arm, strain, q, work): whether at most one strain belongs to q.
    """

    solve: Callable[..., Any]
    columns: Callable[..., Any]
    matrices: Callable[..., Any]
    is_unique: Callable[..., Any]
    rate: Callable[..., Any]


PARAMETRISATIONS: dict[type, Parametrisation] = {}
"""The functions of every parametrisation, by the class of its arrays."""


def _of_the_arm(name):
    """Function of this name of an arm's parametrisation, to be called with the arm and all
    arguments after the strain."""

    def call(arm, *arguments):
        return getattr(PARAMETRISATIONS[type(arm.strain)], name)(arm, arm.strain, *arguments)

    @overload(call)
    def _compiled(arm, *arguments):
        function = getattr(PARAMETRISATIONS[arm.fields["strain"].instance_class], name)
        return lambda arm, *arguments: function(arm, arm.strain, *arguments)

    return call


solve_strain_at, strain_is_unique = _of_the_arm("solve"), _of_the_arm("is_unique")
strain_columns, strain_matrices, strain_rate = (
    _of_the_arm("columns"),
    _of_the_arm("matrices"),
    _of_the_arm("rate"),
)


@kernel(inline=True)
def strain_from_guess(arm, q, tolerance, work):
    """The strain at q into work.xi, from the guess there; -1, or the block at which it could not be
    found."""
    return solve_strain_at(arm, q, 1.0, tolerance, ANY, work)


@kernel(refcount=True)
def continue_strain(arm, begin, end, tolerance, work):
    """The strain at the end of a way on the branch of that at its beginning, which is in work.xi:
    in growing or halved parts of the way.

    begin, end: coordinates (n,) and the part of the loads inside. Where the strain need not be the
    only one, parts are so small that Newton contracts at once and, with tendons that push, no chord
    moves far. Returns (-1, 1.0), or (the block that stopped it, the part of the way that was
    reached, whose strain is left in work.xi).
    """
    (q_from, part_from), (q, part) = begin, end
    reached, step, last_good = 0.0, 1.0, work.xi.copy()
    while reached < 1.0:
        ahead = reached + step if step < 1.0 - reached else 1.0
        q_ahead = q_from + ahead * (q - q_from)
        unique = strain_is_unique(arm, q_ahead, work)
        copy(last_good, work.xi)
        failed = solve_strain_at(
            arm,
            q_ahead,
            part_from + ahead * (part - part_from),
            tolerance,
            ANY if unique else CONTRACTION,
            work,
        )
        if failed < 0 and (
            unique or all_pull(work.tau) or chords_stay(arm.rod, arm.tendons, last_good, work.xi)
        ):
            reached, step = ahead, 2.0 * (ahead - reached)
            copy(work.xi, last_good)
        else:
            step = 0.5 * (ahead - reached)
            if step < max(SMALLEST_PART * reached, LEAST_PART):
                copy(last_good, work.xi)
                return max(failed, 0), reached
    return -1, 1.0


@kernel(refcount=True)
def strain_from_rest(arm, q, tolerance, work):
    """The strain at q on the branch on which coordinates and loads inside grow together from the
    stress-free rod; as continue_strain()."""
    copy(arm.rod.reference_strain, work.xi)
    if strain_is_unique(arm, q, work) and strain_from_guess(arm, q, tolerance, work) < 0:
        return -1, 1.0
    copy(arm.rod.reference_strain, work.xi)
    return continue_strain(arm, (np.zeros(q.size), 0.0), (q, 1.0), tolerance, work)


@kernel(refcount=True)
def strain_has_margin(arm, q, tolerance, work):
    """Whether there is a strain at q and, where it need not be the only one, one a MARGIN_PARTS-th
    beyond too, with Newton contracting at once in each of these even parts of the way from rest."""
    if strain_is_unique(arm, q, work):
        return strain_from_rest(arm, q, tolerance, work)[0] < 0
    copy(arm.rod.reference_strain, work.xi)
    for k in range(MARGIN_PARTS + 1):
        part = (k + 1.0) / MARGIN_PARTS
        if solve_strain_at(arm, part * q, part, tolerance, CONTRACTION, work) >= 0:
            return False
    return True
