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
    changes = {**UNEQUAL, **KINDS[request.param]}
    scene = load_scene("three_tendon").replace(changes)
    model = model_on(scene, 5)
    assert model.grid.packs == 4
    return model, *random_state(model, 3)


def test_the_drive_is_what_tensions_leave_of_strain_and_damping(moving, workspace_at):
    """B u - K - D q_dot."""
    model, q, q_dot = moving
    work = workspace_at(model, q, q_dot, TENSION)
    terms = model.terms(q, q_dot, TENSION)
    pulled = terms.actuation @ TENSION
    damped = terms.damping @ q_dot
    expected = pulled - terms.elastic_force - damped
    drive = work.forces.drive
    atol = 1e-10 * np.abs(pulled).max()
    np.testing.assert_allclose(drive, expected, rtol=1e-9, atol=atol)
    lengthening = slopes(model.tendon_lengths, model, q)
    atol = 1e-6 * np.abs(lengthening).max()
    np.testing.assert_allclose(terms.actuation, -lengthening.T, atol=atol)


def slopes(function, model, q):
    """Derivatives (.., n) by central differences, in units of the coordinates."""
    scale = model.coordinate_scale()
    columns = []
    for way in np.diag(1e-4 * scale):
        ahead = function(q + way)
        behind = function(q - way)
        columns.append(ahead - behind)
    changes = np.stack(columns, axis=-1)
    return changes / (2e-4 * scale)


def test_strains_store_what_their_force_does(moving):
    """K is the derivative of the elastic energy, with loads inside of that of the loads too."""
    model, q, q_dot = moving
    terms = model.terms(q, q_dot)

    def stored(x):
        energy = model.energy(x, q_dot)
        return energy.elastic + energy.load

    expected = slopes(stored, model, q)
    scale = model.coordinate_scale()
    work = terms.elastic_force * scale
    expected_work = expected * scale
    atol = 1e-6 * np.abs(expected_work).max()
    np.testing.assert_allclose(work, expected_work, atol=atol)


def test_damping_is_what_viscosity_loses(moving):
    """q_dot D q_dot = int xi_dot Upsilon xi_dot dX, of the rates by differences of the strain."""
    model, q, q_dot = moving
    terms = model.terms(q, q_dot)
    h = 1e-5
    way = h * q_dot
    _, ahead = model.strain(q + way)
    _, behind = model.strain(q - way)
    change = ahead - behind
    rate = change / (2.0 * h)
    viscosity = model.grid.unpacked(model.arm.rod.viscosity)
    lost = np.sum(viscosity * rate**2)
    power = q_dot @ terms.damping @ q_dot
    assert power == pytest.approx(lost, rel=1e-5)
