"""Strain parametrisations: registry of the compiled functions from coordinates to strains, columns, bias and stiffness.

A parametrisation is a struct of arrays (types.py), the arm's `strain`, and eight compiled functions, or nine. Its class is part of
the compiled type, so it selects their code.

    stage(arm, u, q, q_dot, tolerance, work)   leaves xi, xi_dot, xi_bias, the columns Phi and the mismatch, of which B u - K
                                               is made; -1, or the block at which the strain could not be found
    matrices(arm, work)                        leaves D and G, of what stage has left
    from_guess(arm, q, tolerance, work)        the strain at q into work.xi, from the guess there; likewise
    from_rest(arm, q, tolerance, work)         the strain at q on the branch of the stress-free rod, with no guess: as along
    along(arm, q_from, q, tolerance, work)     the same, continued from the strain at q_from there: (-1, 1.0), or (block, part reached)
    is_unique(arm, q, work)                    whether at most one strain belongs to q
    is_firm(arm, q, tolerance, work)           whether q has a strain, and the way there from rest keeps clear of where others begin
    rate(arm, q_dot, work)                     xi_dot alone, where from_guess has just left the strain
    loads(arm, work)                           adds to the drive the force of loads inside that stage left out, for which it takes poses and
                                               Jacobians; None where there are no such loads
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from numba.extending import overload


class Parametrisation(NamedTuple):
    """The functions of one parametrisation."""

    stage: Callable[..., Any]
    matrices: Callable[..., Any]
    from_guess: Callable[..., Any]
    from_rest: Callable[..., Any]
    along: Callable[..., Any]
    is_unique: Callable[..., Any]
    is_firm: Callable[..., Any]
    rate: Callable[..., Any]
    loads: Callable[..., Any] | None = None


_PARAMETRISATIONS: dict[type, Parametrisation] = {}


def parametrises(arrays: type, functions: Parametrisation) -> None:
    """Register the functions of the parametrisation with these arrays."""
    _PARAMETRISATIONS[arrays] = functions


def strain_stage(arm, u, q, q_dot, tolerance, work):
    """The stage of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].stage(arm, u, q, q_dot, tolerance, work)


@overload(strain_stage)
def _strain_stage_overload(arm, u, q, q_dot, tolerance, work):
    stage = _of(arm).stage
    return lambda arm, u, q, q_dot, tolerance, work: stage(arm, u, q, q_dot, tolerance, work)


def strain_matrices(arm, work):
    """matrices of the arm's parametrisation."""
    _PARAMETRISATIONS[type(arm.strain)].matrices(arm, work)


@overload(strain_matrices)
def _strain_matrices_overload(arm, work):
    matrices = _of(arm).matrices
    return lambda arm, work: matrices(arm, work)


def strain_from_guess(arm, q, tolerance, work):
    """from_guess of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].from_guess(arm, q, tolerance, work)


@overload(strain_from_guess)
def _strain_from_guess_overload(arm, q, tolerance, work):
    from_guess = _of(arm).from_guess
    return lambda arm, q, tolerance, work: from_guess(arm, q, tolerance, work)


def strain_along(arm, q_from, q, tolerance, work):
    """along of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].along(arm, q_from, q, tolerance, work)


@overload(strain_along)
def _strain_along_overload(arm, q_from, q, tolerance, work):
    along = _of(arm).along
    return lambda arm, q_from, q, tolerance, work: along(arm, q_from, q, tolerance, work)


def strain_is_unique(arm, q, work):
    """is_unique of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].is_unique(arm, q, work)


@overload(strain_is_unique)
def _strain_is_unique_overload(arm, q, work):
    is_unique = _of(arm).is_unique
    return lambda arm, q, work: is_unique(arm, q, work)


def strain_from_rest(arm, q, tolerance, work):
    """from_rest of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].from_rest(arm, q, tolerance, work)


@overload(strain_from_rest)
def _strain_from_rest_overload(arm, q, tolerance, work):
    from_rest = _of(arm).from_rest
    return lambda arm, q, tolerance, work: from_rest(arm, q, tolerance, work)


def strain_is_firm(arm, q, tolerance, work):
    """is_firm of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].is_firm(arm, q, tolerance, work)


@overload(strain_is_firm)
def _strain_is_firm_overload(arm, q, tolerance, work):
    is_firm = _of(arm).is_firm
    return lambda arm, q, tolerance, work: is_firm(arm, q, tolerance, work)


def strain_rate(arm, q_dot, work):
    """rate of the arm's parametrisation."""
    _PARAMETRISATIONS[type(arm.strain)].rate(arm, q_dot, work)


@overload(strain_rate)
def _strain_rate_overload(arm, q_dot, work):
    rate = _of(arm).rate
    return lambda arm, q_dot, work: rate(arm, q_dot, work)


def strain_loads(arm, work):
    """loads of the arm's parametrisation."""
    loads = _PARAMETRISATIONS[type(arm.strain)].loads
    if loads is not None:
        loads(arm, work)


@overload(strain_loads)
def _strain_loads_overload(arm, work):
    loads = _of(arm).loads
    if loads is None:
        return lambda arm, work: None
    return lambda arm, work: loads(arm, work)


def _of(arm_type):
    """The parametrisation of a compiled type of Arm."""
    return _PARAMETRISATIONS[arm_type.fields["strain"].kind]
