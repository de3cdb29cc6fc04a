"""Building a model: its quadrature is chosen, and its coordinates are checked to be independent."""

import warnings

import numpy as np

from soft_tendon_env.model.model import SINGULAR, Model, least_eigenvalue
from soft_tendon_env.model.quadrature import model_on_needed
from soft_tendon_env.model.strain_limits import StrainLimitError
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.units import warn_of_units
from soft_tendon_env.tools.checks import checked_type
from soft_tendon_env.tools.configuration import ConfigurationError, Problem


def build_model(scene: Scene) -> Model:
    """Model of a scene as it says: chooses its quadrature and prepares the arrays of its kernels. At a fidelity: accuracy.fidelity.

    Raises TypeError if it is not a Scene, ConfigurationError if its coordinates are not independent. Warns (`QuadratureWarning`) if
    `quadrature.intervals` is too coarse, and (`UnitsWarning`) of numbers that look as if they were in other units than SI's.
    """
    checked_type("scene", scene, Scene, "see load_scene")
    warn_of_units(scene)
    model = model_on_needed(scene)
    n = model.coordinate_count
    if n == 0:
        raise ConfigurationError([Problem(("strain",), "gives no coordinates: no tendon and no passive field strains the rod")])
    try:
        terms = model.terms(np.zeros(n), np.zeros(n))
    except StrainLimitError as error:  # the unloaded arm has a strain
        text = f"is true, but without tensions the arm does not hold the loads: {error}; leave it out, for loads that buckle the arm"
        raise ConfigurationError([Problem(("strain", "include_loads"), text)]) from error
    if not least_eigenvalue(terms.stiffness) > SINGULAR:
        text = f"gives {n} coordinates of which some strain the rod alike at the points of {model.grid.per_piece} quadrature intervals"
        raise ConfigurationError([Problem(("strain",), f"{text} per piece: drop a field, or leave quadrature.intervals out, if given")])
    if not least_eigenvalue(terms.mass) > SINGULAR:
        text = f"{n} coordinates are too many for {model.grid.per_piece} quadrature intervals per piece: the mass matrix is singular"
        warnings.warn(text, stacklevel=2)
    return model
