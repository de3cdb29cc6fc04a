"""What the tests of effects share: a uniform arm with few strains, and derivatives."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def uniform(build):
    """uniform(("bend_y",), 2, {...}): the arm with three straight tendons and Legendre strains up
    to an order, with changes.

    0.3 m long, radius 10 mm, Young's modulus 5e5 Pa, 1070 kg/m^3.
    """

    def make(strains=("bend_y", "bend_z"), order=0, changes=None):
        strain = {
            "type": "explicit",
            "modes": [{"strains": list(strains), "order": order, "span": "rod"}],
        }
        return build("three_tendon", {"strain": strain, **(changes or {})})

    return make


@pytest.fixture(scope="session")
def slope():
    """slope(function, q, step): its derivative (.., n) by central differences."""

    def derivative(function, q, step):
        moves = step * np.eye(q.size)
        return np.stack(
            [
                (np.asarray(function(q + move)) - np.asarray(function(q - move))) / (2 * step)
                for move in moves
            ],
            axis=-1,
        )

    return derivative
