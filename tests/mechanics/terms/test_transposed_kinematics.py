"""Stresses that do the work of wrenches, forces at stations, tendons and sensors: virtual work
against Jacobians and differences."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.tendons import tendon_forces, tendon_lengths
from soft_tendon_env.mechanics.terms.transposed_kinematics import (
    add_station_forces,
    add_strain_stress,
    add_tendon_stress,
    add_wrench_stress,
    stress_force,
)
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

pytestmark = pytest.mark.no_jit

STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
ALL_STRAINS = {
    "strain": {
        "type": "explicit",
        "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}],
    }
}
PLACES = np.array([0.0, 0.013, 0.06, 0.15, 0.24, 0.2999, 0.3])
"""In the first interval, at borders between intervals and packs, inside of them, at the tip."""


@pytest.fixture(scope="module")
def bent(workspace_at):
    """An arm of five intervals, in two packs, with all strains: its model, coordinates, rates and
    evaluation."""
    scene = load_scene("three_tendon").replace(ALL_STRAINS)
    model = model_on(scene, 5)
    rng = np.random.default_rng(0)
    unit = np.repeat([4.0, 4.0, 4.0, 0.1, 0.1, 0.1], 2)
    q, q_dot = unit * rng.normal(size=(2, 12))
    return model, q, q_dot, workspace_at(model, q, q_dot)


def force_of(model, work, stress):
    """Generalised force (n,) of a stress field."""
    out = np.empty(model.coordinate_count)
    stress_force(model.arm.rod, model.arm.strain, work.strain.Phi, stress, out)
    return out


def test_the_stress_of_wrenches_has_their_virtual_work(bent):
    """Phi^T stress = J^T f, of a wrench at every node."""
    model, _, _, work = bent
    random = np.random.default_rng(1)
    wrench = random.normal(size=work.kinematics.eta.size)
    stress = np.zeros_like(work.strain.xi)
    add_wrench_stress(model.arm.rod, wrench, work.strain.xi, work.kinematics, stress)
    J = work.kinematics.J.reshape(model.coordinate_count, -1)
    expected = J @ wrench
    np.testing.assert_allclose(
        force_of(model, work, stress), expected, atol=1e-12 * np.abs(expected).max()
    )


def test_the_work_of_a_tip_wrench_is_that_of_its_jacobian(bent):
    model, q, q_dot, work = bent
    wrench = np.zeros_like(work.kinematics.eta)
    rng = np.random.default_rng(2)
    of_tip = rng.normal(size=6)
    wrench.reshape(-1, 6, LANES)[-1, :, -1] = of_tip
    stress = np.zeros_like(work.strain.xi)
    add_wrench_stress(model.arm.rod, wrench, work.strain.xi, work.kinematics, stress)
    expected = model.terms(q, q_dot).tip_jacobian.T @ of_tip
    np.testing.assert_allclose(
        force_of(model, work, stress), expected, atol=1e-12 * np.abs(expected).max()
    )


def test_stresses_of_tendons_and_rates_of_tendons_are_transposes(bent):
    """The work of forces on the lengths is -B f, and B^T q_dot how fast they shorten."""
    model, q, q_dot, work = bent
    B = model.terms(q, q_dot).actuation
    force = np.array([1.0, -2.0, 0.5])
    stress = np.zeros_like(work.strain.xi)
    tangent = work.strain.tangent
    add_tendon_stress(model.arm.rod, model.arm.tendons, force, tangent, stress)
    generalised_force = force_of(model, work, stress)
    expected_generalised_force = -B @ force
    np.testing.assert_allclose(generalised_force, expected_generalised_force, atol=1e-14)
    size = 3 * work.strain.xi.size
    share = np.ones(size // 6)
    rates = np.empty(3)
    tendon_forces(model.arm.rod, model.arm.tendons, share, tangent, work.strain.xi_dot, rates)
    expected_rates = B.T @ q_dot
    np.testing.assert_allclose(rates, expected_rates, atol=1e-13)
    h = 1e-6
    ahead = model.tendon_lengths(q + h * q_dot)
    behind = model.tendon_lengths(q - h * q_dot)
    expected = (behind - ahead) / (2 * h)
    np.testing.assert_allclose(rates, expected, rtol=1e-6, atol=1e-9)


def test_tendons_are_as_long_as_their_curves(bent):
    """Against chords between many points of the tendon's path in space."""
    model, q, _, work = bent
    lengths = np.empty(3)
    tendon_lengths(model.arm.rod, model.arm.tendons, work.strain.xi, lengths)
    places = np.linspace(0.0, model.length, 1001)
    poses = model.backbone_at(q, places)
    for tendon, length in zip(model.scene.tendons, lengths, strict=True):
        offset = np.array([0.0, *tendon.routing.offset])
        rotation = poses[:, :3, :3]
        path = poses[:, :3, 3] + rotation @ offset
        steps = np.diff(path, axis=0)
        along = np.linalg.norm(steps, axis=1).sum()
        assert length == pytest.approx(along, rel=1e-4)


def test_stresses_of_sensors_have_the_work_on_the_strains_there(bent):
    model, q, _, work = bent
    interval, distance = model.grid.locate(PLACES)
    random = np.random.default_rng(3)
    force = random.normal(size=(PLACES.size, 6))
    stress = np.zeros_like(work.strain.xi)
    add_strain_stress(model.grid.length, interval, distance, force, stress)
    _, Phi = model.strain_at(q, PLACES)
    expected = np.einsum("mi,min->n", force, Phi)
    np.testing.assert_allclose(force_of(model, work, stress), expected, atol=1e-12)


@pytest.mark.parametrize("place", PLACES)
def test_forces_at_stations_have_the_work_on_the_backbone(bent, place):
    model, q, _, work = bent
    places = np.array([place, 0.1])
    rows = [[0.3, -0.7, 0.2], [0.0, 0.0, 0.0]]
    force = np.array(rows)
    stress = np.zeros_like(work.strain.xi)
    wrench = np.zeros_like(work.kinematics.eta)
    stations = model.grid.locate(places)
    add_station_forces(
        model.arm.rod, stations, force, work.strain.xi, work.kinematics, wrench, stress
    )
    add_wrench_stress(model.arm.rod, wrench, work.strain.xi, work.kinematics, stress)
    found = force_of(model, work, stress)
    for j, h in enumerate(1e-5 * model.coordinate_scale()):
        change = h * np.eye(q.size)[j]
        ahead = model.backbone_at(q + change, places)
        behind = model.backbone_at(q - change, places)
        rate = (ahead - behind)[:, :3, 3] / (2 * h)
        power = (force * rate).sum()
        assert found[j] == pytest.approx(power, rel=1e-6, abs=1e-10)


def test_poses_inside_of_intervals_follow_from_the_strains_there(bent):
    """g^-1 g' = xi^ at any arc length, to the error of the Magnus steps."""
    model, q, _, _ = bent
    places = np.array([0.02, 0.05, 0.13, 0.22, 0.28])
    h = 1e-5
    behind = model.backbone_at(q, places - h)
    here = model.backbone_at(q, places)
    ahead = model.backbone_at(q, places + h)
    change = (ahead - behind) / (2 * h)
    slope = np.linalg.solve(here, change)
    # angular and linear strains, from the matrix of the twist
    about_x = slope[:, 2, 1]
    about_y = slope[:, 0, 2]
    about_z = slope[:, 1, 0]
    angular = np.stack([about_x, about_y, about_z], axis=1)
    linear = slope[:, :3, 3]
    strain, _ = model.strain_at(q, places)
    largest = np.abs(strain[:, :3]).max()
    np.testing.assert_allclose(angular, strain[:, :3], atol=2e-3 * largest)
    np.testing.assert_allclose(linear, strain[:, 3:], atol=2e-3)
