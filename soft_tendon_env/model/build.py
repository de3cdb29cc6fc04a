"""Model of a scene: its quadrature is chosen, its rod and its coordinates are checked."""

import functools
import math
import warnings
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np

from soft_tendon_env.model.compilation_progress import PROGRESS
from soft_tendon_env.model.model import Model, is_singular, model_on
from soft_tendon_env.model.quadrature import QuadratureEstimate, QuadratureTest
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, breakpoints
from soft_tendon_env.scene.units import warn_of_units
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown
from soft_tendon_env.tools.messages import naming

FIRST_USE = "up to a minute on an idle core"
"""Time to the first step of an environment while all kernels are compiled: 43 s of CPU time were
measured on an AMD EPYC with busy cores, and 9 s for another kind of arm after that."""

MOST_REMEMBERED = 128
"""Scenes at most whose quadrature is remembered in a process."""


class QuadratureWarning(UserWarning):
    """The quadrature is too coarse for the scene."""


def build_model(scene: Scene) -> Model:
    """Model of a scene as it says, with a quadrature and the arrays of its kernels.

    At a fidelity: `accuracy.fidelity`. Warns if `quadrature.intervals` is too coarse
    (`QuadratureWarning`) and where numbers look as if not in SI units (`UnitsWarning`).

    Args:
        scene: see `load_scene`.

    Returns:
        The model, which never changes.

    Raises:
        TypeError: for what is no scene.
        ConfigurationError: if the scene's coordinates are not independent, or its stress-free rod
            turns too often for any quadrature.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    warn_of_units(scene)
    _check_turns(scene)
    with compiling_for(scene):
        return _checked_model(scene)


def compiling_for(scene: Scene) -> AbstractContextManager[None]:
    """Context in which the line on compilation names the scene and the time.

    Lines on the time to go name the scene behind the context too.
    """
    PROGRESS.concerns(scene)
    return naming(f"scene {scene.name!r}, {FIRST_USE}")


def _checked_model(scene: Scene) -> Model:
    """Model with a quadrature that suffices or is said to be too coarse, see `build_model`."""
    try:
        hash(scene)
    except TypeError:  # an effect of one's own may have a list among its fields
        quadrature = _quadrature.__wrapped__(scene)
    else:
        quadrature = _quadrature(scene)
    # the model is made all the same: it may do for what it is asked
    if quadrature.estimate.problem:
        warnings.warn(_too_coarse(*quadrature), QuadratureWarning, stacklevel=3)
    model = model_on(scene, quadrature.estimate.intervals)
    _check_coordinates(model)
    return model


class _Quadrature(NamedTuple):
    """Estimates of the quadrature that a scene has, and of one that suffices for it."""

    estimate: QuadratureEstimate
    sufficient: QuadratureEstimate


@functools.lru_cache(maxsize=MOST_REMEMBERED)
def _quadrature(scene: Scene) -> _Quadrature:
    """Quadrature of a scene: as it says, or the coarsest that suffices.

    It is remembered, since to choose it takes as long as all else of a model.
    """
    test = QuadratureTest(scene)
    intervals = scene.quadrature.intervals
    if intervals is None:
        estimate = test.search(scene.quadrature.least)
        return _Quadrature(estimate, sufficient=estimate)
    estimate = test.error_estimate(intervals)
    if estimate.problem:
        return _Quadrature(estimate, sufficient=test.search(intervals))
    return _Quadrature(estimate, sufficient=estimate)


def _check_turns(scene: Scene) -> None:
    """Refuses segments whose stress-free rod turns more often than any quadrature tells.

    Raises:
        ConfigurationError: names the first such segment.
    """
    pieces = breakpoints(scene).size - 1
    most = MOST_INTERVALS * pieces
    for i, segment in enumerate(scene.segments):
        rate = math.hypot(*segment.curvature)
        turned_angle = rate * segment.length
        turns = turned_angle / (2.0 * math.pi)
        if turns > most:
            text = (
                f"is {shown(segment.curvature)}: it turns the segment {turns:.3g} times, and the"
                f" finest quadrature tells {most} turns"
            )
            raise ConfigurationError([Problem(("segments", i, "curvature"), text)])


def _too_coarse(estimate: QuadratureEstimate, sufficient: QuadratureEstimate) -> str:
    """Message of a quadrature that is too coarse, with the number of intervals that would do."""
    if sufficient.problem:
        advice = f"not even {sufficient.intervals} would do"
    else:
        advice = f"{sufficient.intervals} would do, or leave quadrature.intervals out"
    return (
        f"quadrature too coarse: with {estimate.intervals} intervals per piece {estimate.problem};"
        f" {advice}"
    )


def _check_coordinates(model: Model) -> None:
    """Refuses coordinates that are none or not independent, and loads that buckle the arm at once.

    Warns of a singular mass matrix, on the caller of `build_model`.

    Raises:
        ConfigurationError: names the key of the scene's strain.
    """
    n = model.coordinate_count
    if n == 0:
        raise _strain_error("gives no coordinates: no tendon and no passive field strains the rod")
    rest = np.zeros(n)
    try:
        terms = model.terms(rest, rest)
    except StrainLimitError as error:
        # the unloaded arm has a strain
        text = (
            f"is true, but without tensions the arm does not hold the loads: {error}; leave it out,"
            " for loads that buckle the arm"
        )
        raise _strain_error(text, "include_loads") from error
    per_piece = model.grid.per_piece
    if is_singular(terms.stiffness):
        raise _strain_error(
            f"gives {n} coordinates of which some strain the rod alike at the points of"
            f" {per_piece} quadrature intervals per piece: drop a field, or leave"
            " quadrature.intervals out, if given"
        )
    if is_singular(terms.mass):
        text = (
            f"{n} coordinates are too many for {per_piece} quadrature intervals per"
            " piece: the mass matrix is singular"
        )
        warnings.warn(text, stacklevel=4)


def _strain_error(text: str, *keys: str) -> ConfigurationError:
    """Error about the scene's strain, or about a key of its table."""
    problem = Problem(("strain", *keys), text)
    return ConfigurationError([problem])
