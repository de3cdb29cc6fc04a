"""Building a model: its quadrature is chosen, and its coordinates are checked to be independent."""

import math
import warnings

import numpy as np

from soft_tendon_env.model.model import Model, is_singular
from soft_tendon_env.model.quadrature import choose_quadrature
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, breakpoints
from soft_tendon_env.scene.units import warn_of_units
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem, shown


def build_model(scene: Scene) -> Model:
    """Model of a scene as it says: chooses its quadrature and prepares the arrays of its kernels. At a fidelity: accuracy.fidelity.

    Raises TypeError if it is not a Scene, ConfigurationError if its coordinates are not independent or its stress-free rod turns more often
    than the finest quadrature tells. Warns (`QuadratureWarning`) if `quadrature.intervals` is too coarse, and (`UnitsWarning`) of numbers
    that look as if they were in other units than SI's.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    warn_of_units(scene)
    most = MOST_INTERVALS * (breakpoints(scene).size - 1)
    for i, segment in enumerate(scene.segments):
        if (turns := math.hypot(*segment.curvature) * segment.length / (2.0 * math.pi)) > most:
            text = f"is {shown(segment.curvature)}: it turns the segment {turns:.3g} times, and the finest quadrature tells {most} turns"
            raise ConfigurationError([Problem(("segments", i, "curvature"), text)])
    model = choose_quadrature(scene)
    n = model.coordinate_count
    if n == 0:
        raise ConfigurationError([Problem(("strain",), "gives no coordinates: no tendon and no passive field strains the rod")])
    try:
        terms = model.terms(np.zeros(n), np.zeros(n))
    except StrainLimitError as error:  # the unloaded arm has a strain
        text = f"is true, but without tensions the arm does not hold the loads: {error}; leave it out, for loads that buckle the arm"
        raise ConfigurationError([Problem(("strain", "include_loads"), text)]) from error
    if is_singular(terms.stiffness):
        text = f"gives {n} coordinates of which some strain the rod alike at the points of {model.grid.per_piece} quadrature intervals"
        raise ConfigurationError([Problem(("strain",), f"{text} per piece: drop a field, or leave quadrature.intervals out, if given")])
    if is_singular(terms.mass):
        text = f"{n} coordinates are too many for {model.grid.per_piece} quadrature intervals per piece: the mass matrix is singular"
        warnings.warn(text, stacklevel=2)
    return model
