"""Learned strain under dead loads: its derivatives are exact, its forces are those of its energy, whatever the network says."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.terms.parametrisation import strain_along, strain_from_guess, strain_from_rest, strain_is_firm
from soft_tendon_env.mechanics.types import Learned, StaticsBased
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import Model, model_on

TOLERANCE = 1e-12
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
LOADS = {**GRAVITY, "effects.tip_load": {"force": [0.1, 0.2, -0.1], "mass": 0.02}}
KIRCHHOFF = {"strain.strains": ["torsion", "bend_y", "bend_z"]}
ARMS = [
    pytest.param("three_tendon", GRAVITY, marks=pytest.mark.no_jit, id="three tendons"),
    pytest.param("paper", LOADS, id="tendons that end half way"),
    pytest.param("paper_16dof", GRAVITY, id="passive coordinates"),
    pytest.param("four_tendon", GRAVITY, id="redundant tendons"),
    pytest.param("three_tendon", {**GRAVITY, **KIRCHHOFF}, id="Kirchhoff"),
]


@pytest.fixture
def learned_arm(untrained):
    """learned_arm(name, changes): a model on few intervals with a learned strain of random weights."""

    def model(name, changes):
        from soft_tendon_env.scene.file import load_scene

        return model_on(load_scene(name).replace(untrained(name, changes)[1]), 2)

    return model


def straightened(model):
    """The same arm whose amplitudes are passive coordinates that follow nothing."""
    whole = model.arm.strain.whole
    return Model(model.scene, model.grid, model.arm.replaced(strain=whole))


def amplitudes(learned, q):
    """c(q) by its definition."""
    weights = learned.weights

    def s(a):
        return a / np.sqrt(1.0 + a**2)

    hidden = s(s(q @ weights["first"] + weights["first_bias"]) @ weights["second"] + weights["second_bias"])
    return hidden @ weights["third"] + weights["third_bias"]


@pytest.mark.parametrize(("name", "changes"), ARMS)
def test_the_strain_answers_to_the_amplitudes_as_to_passive_coordinates(name, changes, learned_arm, untrained, random_state):
    model, (learned, _) = learned_arm(name, changes), untrained(name, changes)
    assert isinstance(model.arm.strain, Learned) and isinstance(model.arm.strain.whole, StaticsBased)
    q, _ = random_state(model, 1)
    c = amplitudes(learned, q[: model.arm.strain.active])
    expected = straightened(model).strain(np.concatenate([q, c]))[1]
    np.testing.assert_allclose(model.strain(q)[1], expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())
    without = straightened(model).strain(np.concatenate([q, 0.0 * c]))[1]
    assert np.abs(without - expected).max() > 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(("name", "changes"), ARMS)
def test_columns_rates_and_bias_are_the_derivatives_of_the_strain(name, changes, learned_arm, random_state, check_derivatives):
    model = learned_arm(name, changes)
    check_derivatives(model, *random_state(model, 2))


@pytest.mark.parametrize(("name", "changes"), ARMS)
def test_forces_are_the_gradients_of_energy_and_lengths(name, changes, learned_arm, random_state):
    """K - F of elastic and load energy, B of the tendons' lengths: so motion keeps its energy, whatever was learned."""
    model = learned_arm(name, changes)
    (q, _), n = random_state(model, 3), model.coordinate_count
    terms, unit = model.terms(q, np.zeros(n)), model.coordinate_scale()
    still = np.zeros(n)
    for j in range(n):
        step = 1e-4 * unit[j] * np.eye(n)[j]
        ahead, behind = (model.energy(q + s * step, still) for s in (1, -1))
        gain = (ahead.elastic + ahead.load - behind.elastic - behind.load) / (2e-4 * unit[j])
        assert terms.elastic_force[j] - terms.external_force[j] == pytest.approx(gain, abs=1e-6 * np.abs(terms.elastic_force).max())
        shorter = (model.tendon_lengths(q + step) - model.tendon_lengths(q - step)) / (2e-4 * unit[j])
        np.testing.assert_allclose(terms.actuation[j], -shorter, atol=1e-6 * np.abs(terms.actuation).max())
    np.testing.assert_array_equal(terms.external_force, 0.0)  # the loads are inside
    scale = np.sqrt(np.diag(terms.stiffness))
    G = terms.stiffness / np.outer(scale, scale)
    assert np.abs(G - G.T).max() < 1e-12 and np.linalg.eigvalsh(G)[0] > 0.0


def test_the_drive_is_that_of_the_terms(learned_arm, random_state, workspace_at):
    model = learned_arm("paper", LOADS)
    q, _ = random_state(model, 5)
    u = np.linspace(1.0, 5.0, 10)
    terms = model.terms(q, np.zeros(10))
    expected = terms.actuation @ u - terms.elastic_force
    np.testing.assert_allclose(workspace_at(model, q, tension=u).drive, expected, atol=1e-11 * np.abs(expected).max())


def test_a_strain_is_found_from_rest_and_along_as_from_a_guess(learned_arm, random_state):
    model = learned_arm("paper", LOADS)
    arm, (q, _), work = model.arm, random_state(model, 6), make_workspace(model.arm)
    q[2] = -3.0  # which pushes, so that the branch is followed
    work.xi[:] = arm.rod.reference_strain
    assert strain_from_guess(arm, q, TOLERANCE, work) == -1
    found = work.xi.copy()
    assert strain_from_rest(arm, q, TOLERANCE, work) == (-1, 1.0)
    np.testing.assert_allclose(work.xi, found, atol=1e-10 * np.abs(found).max())
    assert strain_from_rest(arm, 0.5 * q, TOLERANCE, work) == (-1, 1.0)
    assert strain_along(arm, 0.5 * q, q, TOLERANCE, work) == (-1, 1.0)
    np.testing.assert_allclose(work.xi, found, atol=1e-10 * np.abs(found).max())
    assert strain_is_firm(arm, q, TOLERANCE, work)
    assert not strain_is_firm(arm, np.full(10, -400.0), TOLERANCE, work)
