"""The seam of the strain parametrisations: from the coordinates to strains, columns, bias and stiffness at every point.

A parametrisation is a NamedTuple class of arrays (types.py), the arm's `strain`, and three compiled functions. Its class is part of
the compiled type, so it selects their code.

    stage(arm, u, q, q_dot, tolerance, work)   leaves xi, xi_dot, xi_bias and the columns Phi at the points, and D, G and the
                                               drive B u - K; -1, or the block at which the strain could not be found
    from_guess(arm, q, tolerance, work)        the strain at q into work.xi, from the guess there; likewise
    from_rest(arm, q, tolerance, work)         the same with no guess: (-1, 1.0), or (block, part of q that was reached)
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from numba.extending import overload


class Parametrisation(NamedTuple):
    """The functions of one parametrisation."""

    stage: Callable[..., Any]
    from_guess: Callable[..., Any]
    from_rest: Callable[..., Any]


_PARAMETRISATIONS: dict[type, Parametrisation] = {}


def parametrises(arrays: type, stage: Callable[..., Any], from_guess: Callable[..., Any], from_rest: Callable[..., Any]) -> None:
    """Register the functions of the parametrisation with these arrays."""
    _PARAMETRISATIONS[arrays] = Parametrisation(stage, from_guess, from_rest)


def strain_stage(arm, u, q, q_dot, tolerance, work):
    """The stage of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].stage(arm, u, q, q_dot, tolerance, work)


@overload(strain_stage)
def _strain_stage_overload(arm, u, q, q_dot, tolerance, work):
    stage = _of(arm).stage
    return lambda arm, u, q, q_dot, tolerance, work: stage(arm, u, q, q_dot, tolerance, work)


def strain_from_guess(arm, q, tolerance, work):
    """from_guess of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].from_guess(arm, q, tolerance, work)


@overload(strain_from_guess)
def _strain_from_guess_overload(arm, q, tolerance, work):
    from_guess = _of(arm).from_guess
    return lambda arm, q, tolerance, work: from_guess(arm, q, tolerance, work)


def strain_from_rest(arm, q, tolerance, work):
    """from_rest of the arm's parametrisation."""
    return _PARAMETRISATIONS[type(arm.strain)].from_rest(arm, q, tolerance, work)


@overload(strain_from_rest)
def _strain_from_rest_overload(arm, q, tolerance, work):
    from_rest = _of(arm).from_rest
    return lambda arm, q, tolerance, work: from_rest(arm, q, tolerance, work)


def _of(arm_type):
    """The parametrisation of a compiled type of Arm."""
    return _PARAMETRISATIONS[arm_type[arm_type.fields.index("strain")].instance_class]
