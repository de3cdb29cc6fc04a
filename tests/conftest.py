"""What many tests need: models (built once each), states to try them at, the reference numbers."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from soft_tendon_env.mechanics.types import StaticsBased
from soft_tendon_env.model import Model, build_model
from soft_tendon_env.scene_file import load_scene

DATA = Path(__file__).parent / "data"


@functools.cache
def _build(name, changes):
    return build_model(load_scene(name).replace(json.loads(changes)))


@pytest.fixture(scope="session")
def build():
    """build("paper", {"quadrature.intervals": 2}): the model of a shipped scene with dotted changes."""
    return lambda name, changes=None: _build(name, json.dumps(changes or {}))


@pytest.fixture(scope="session")
def reference():
    """reference("statics"): what is in tests/data/statics.json."""
    return lambda name: json.loads((DATA / f"{name}.json").read_text())


@pytest.fixture(scope="session")
def random_state():
    """random_state(model, seed): coordinates and rates of a lively motion, whatever the coordinates mean.

    Tensions are random within a fifth of their limits; the coordinates follow as at rest, and passive ones get about a tenth of the
    energy of the tensions'. Rates: as if every coordinate changed by its own size some ten times a second.
    """

    def state(model: Model, seed: int):
        rng = np.random.default_rng(seed)
        least, greatest = np.array([tendon.tension_limits for tendon in model.scene.tendons]).T
        u = least + 0.2 * rng.random(model.tendon_count) * (greatest - least)
        rest = model.terms(np.zeros(model.coordinate_count), np.zeros(model.coordinate_count))
        stiffness, strain = rest.stiffness, model.arm.strain
        size = np.sqrt(0.1 * _energy(rest, u) / np.diag(stiffness))
        if isinstance(strain, StaticsBased):
            q = model.rest_coordinates(u)
            q[strain.active :] += (size * rng.normal(size=size.size))[strain.active :]
        else:
            q = np.linalg.solve(strain.stiffness, rest.actuation @ u)
        return q, 10.0 * size * rng.normal(size=size.size)

    return state


def _energy(rest, u):
    """Elastic energy of the linear answer to the tensions u."""
    load = rest.actuation @ u
    return 0.5 * load @ np.linalg.lstsq(rest.stiffness, load)[0]
