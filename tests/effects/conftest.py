"""What the tests of effects share: a uniform arm with few strains, and an evaluation with all that it leaves."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.terms.evaluate import configure, evaluate
from soft_tendon_env.mechanics.workspace import make_workspace

TOLERANCE = 1e-12


@pytest.fixture(scope="session")
def uniform(build):
    """uniform(("bend_y",), 2, {...}): the arm with three straight tendons and Legendre strains up to an order, with changes.

    0.3 m long, radius 10 mm, Young's modulus 5e5 Pa, 1070 kg/m^3.
    """

    def make(strains=("bend_y", "bend_z"), order=0, changes=None):
        strain = {"type": "explicit", "modes": [{"strains": list(strains), "order": order, "span": "rod"}]}
        return build("three_tendon", {"strain": strain, **(changes or {})})

    return make


@pytest.fixture(scope="session")
def evaluated():
    """evaluated(model, q, q_dot=0): the workspace after an evaluation without tensions."""

    def at(model, q, q_dot=None):
        work = make_workspace(model.arm)
        q = np.array(q, dtype=float)
        assert configure(model.arm, q, TOLERANCE, work) == (-1, 1.0)
        rates = np.zeros(q.size) if q_dot is None else np.array(q_dot, dtype=float)
        assert evaluate(model.arm, np.zeros(model.tendon_count), q, rates, TOLERANCE, work) == -1
        return work

    return at


@pytest.fixture(scope="session")
def slope():
    """slope(function, q, step): its derivative (.., n) by central differences."""

    def derivative(function, q, step):
        moves = step * np.eye(q.size)
        return np.stack([(np.asarray(function(q + move)) - np.asarray(function(q - move))) / (2 * step) for move in moves], axis=-1)

    return derivative
