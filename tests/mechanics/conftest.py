"""One evaluation of the equations of motion with everything it leaves in its workspace."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.evaluate import configure, evaluate
from soft_tendon_env.mechanics.workspace import make_workspace

TOLERANCE = 1e-12


@pytest.fixture(scope="session")
def workspace_at():
    """workspace_at(model, q, q_dot, tension): the workspace after `evaluate`."""

    def at(model, q, q_dot=None, tension=None):
        work = make_workspace(model.arm)
        q = np.array(q, dtype=float)
        q_dot = np.zeros_like(q) if q_dot is None else np.array(q_dot, dtype=float)
        tension = np.zeros(model.tendon_count) if tension is None else np.array(tension, dtype=float)
        assert configure(model.arm, q, TOLERANCE, work) == (-1, 1.0)
        assert evaluate(model.arm, tension, q, q_dot, TOLERANCE, work) == -1
        return work

    return at


@pytest.fixture(scope="session")
def at_points():
    """at_points(model, field, components): a field over points as (..., points, components), padding left out."""

    def unpacked(model, field, components=6):
        packed = field.reshape(-1, model.arm.rod.packs, 2, components, LANES)
        values = np.moveaxis(packed, -1, 2).reshape(len(packed), -1, 2, components)[:, model.grid.real]
        return values.reshape(len(packed), -1, components)

    return unpacked


@pytest.fixture(scope="session")
def at_nodes():
    """at_nodes(model, field, components): a field over nodes as (..., nodes, components), padding left out."""

    def unpacked(model, field, components=6):
        packed = field.reshape(-1, model.arm.rod.packs, components, LANES)
        return packed.swapaxes(-1, -2).reshape(len(packed), -1, components)[:, model.grid.real]

    return unpacked
