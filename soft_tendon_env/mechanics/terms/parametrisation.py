"""Strain parametrisations: registry of the compiled functions from coordinates to strains, columns, bias and stiffness.

A parametrisation is a struct of arrays (types.py), the arm's `strain`, and eight compiled functions. Its class is part of
the compiled type, so it selects their code. Each takes the arm and its strain first, and the workspace last:

    from_guess(arm, strain, q, tolerance, work)     the strain at q into work.xi, from the guess there; -1, or the block at which it
                                                    could not be found
    columns(arm, strain, u, q, q_dot, work)         under tensions u, where from_guess has just left the strain: xi_dot, xi_bias, the
                                                    columns Phi and the mismatch, of which B u - K is made
    matrices(arm, strain, work)                     D and G, of what columns has left
    from_rest(arm, strain, q, tolerance, work)      the strain at q on the branch of the stress-free rod, with no guess: as along
    along(arm, strain, q_from, q, tolerance, work)  the same, continued from the strain at q_from there: (-1, 1.0), or (block, part reached)
    is_unique(arm, strain, q, work)                 whether at most one strain belongs to q
    is_firm(arm, strain, q, tolerance, work)        whether q has a strain, and the way there from rest keeps clear of where others begin
    rate(arm, strain, q_dot, work)                  xi_dot alone, where from_guess has just left the strain
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from numba.extending import overload


class Parametrisation(NamedTuple):
    """The functions of one parametrisation."""

    from_guess: Callable[..., Any]
    columns: Callable[..., Any]
    matrices: Callable[..., Any]
    from_rest: Callable[..., Any]
    along: Callable[..., Any]
    is_unique: Callable[..., Any]
    is_firm: Callable[..., Any]
    rate: Callable[..., Any]


_PARAMETRISATIONS: dict[type, Parametrisation] = {}


def parametrises(arrays: type, functions: Parametrisation) -> None:
    """Register the functions of the parametrisation with these arrays."""
    _PARAMETRISATIONS[arrays] = functions


def _of_the_arm(name):
    """Function of this name of an arm's parametrisation, to be called with the arm and all arguments after the strain."""

    def call(arm, *arguments):
        return getattr(_PARAMETRISATIONS[type(arm.strain)], name)(arm, arm.strain, *arguments)

    @overload(call)
    def _compiled(arm, *arguments):
        function = getattr(_PARAMETRISATIONS[arm.fields["strain"].kind], name)
        return lambda arm, *arguments: function(arm, arm.strain, *arguments)

    return call


strain_from_guess, strain_columns, strain_matrices = _of_the_arm("from_guess"), _of_the_arm("columns"), _of_the_arm("matrices")
strain_from_rest, strain_along, strain_rate = _of_the_arm("from_rest"), _of_the_arm("along"), _of_the_arm("rate")
strain_is_unique, strain_is_firm = _of_the_arm("is_unique"), _of_the_arm("is_firm")
