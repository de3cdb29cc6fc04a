"""Drive of an arm whose pieces are of unequal lengths, in several packs: the forces of its tensions
less those of its strain and of damping, whatever parametrises the strain."""

import numpy as np
import pytest

from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
UNEQUAL = {"tendons.0.end": 0.22, "tendons.1.start": 0.05}
GRAVITY = {"effects.gravity.acceleration": [1.0, 2.0, -9.81]}
MODES = [{"strains": STRAINS, "order": 1, "span": "rod"}]
KINDS = {
    "statics": {},
    "passive": {"strain.passive": [{"strains": STRAINS[:3], "order": 2, "span": "rod"}]},
    "loads inside": {**GRAVITY, "strain.include_loads": True},
    "explicit": {"strain": {"type": "explicit", "modes": MODES}},
}
TENSION = np.array([2.0, 0.5, 1.0])


@pytest.fixture(params=KINDS)
def moving(request, random_state):
    """A model, and coordinates and rates of it."""
    model = model_on(load_scene("three_tendon").replace({**UNEQUAL, **KINDS[request.param]}), 5)
    assert model.grid.packs == 4
    return model, *random_state(model, 3)


def test_the_drive_is_what_tensions_leave_of_strain_and_damping(moving, workspace_at):
    """B u - K - D q_dot."""
    model, q, q_dot = moving
    work = workspace_at(model, q, q_dot, TENSION)
    terms = model.terms(q, q_dot, TENSION)
    pulled = terms.actuation @ TENSION - terms.elastic_force
    expected = pulled - terms.damping @ q_dot
    size = np.abs(terms.actuation @ TENSION).max()
    np.testing.assert_allclose(work.forces.drive, expected, rtol=1e-9, atol=1e-10 * size)
    lengths = slopes(model.tendon_lengths, model, q)
    np.testing.assert_allclose(terms.actuation, -lengths.T, atol=1e-6 * np.abs(lengths).max())


def slopes(function, model, q):
    """Derivatives (.., n) by central differences, in units of the coordinates."""
    columns = []
    for i, unit in enumerate(model.coordinate_scale()):
        way = 1e-4 * unit * np.eye(q.size)[i]
        change = function(q + way) - function(q - way)
        columns.append(change / (2e-4 * unit))
    return np.stack(columns, axis=-1)


def test_strains_store_what_their_force_does(moving):
    """K is the derivative of the elastic energy, with loads inside of that of the loads too."""
    model, q, q_dot = moving
    terms = model.terms(q, q_dot)

    def stored(x):
        energy = model.energy(x, q_dot)
        return energy.elastic + energy.load

    expected = slopes(stored, model, q)
    scale = model.coordinate_scale()
    size = np.abs(expected * scale).max()
    np.testing.assert_allclose(terms.elastic_force * scale, expected * scale, atol=1e-6 * size)


def test_damping_is_what_viscosity_loses(moving):
    """q_dot D q_dot = int xi_dot Upsilon xi_dot dX, of the rates by differences of the strain."""
    model, q, q_dot = moving
    terms = model.terms(q, q_dot)
    h = 1e-5
    _, ahead = model.strain(q + h * q_dot)
    _, behind = model.strain(q - h * q_dot)
    rate = (ahead - behind) / (2.0 * h)
    grid = model.grid
    viscosity = grid.unpacked(model.arm.rod.viscosity)
    lost = (viscosity * rate**2).sum()
    assert q_dot @ terms.damping @ q_dot == pytest.approx(lost, rel=1e-5)
