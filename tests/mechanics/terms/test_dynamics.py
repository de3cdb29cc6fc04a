"""The terms of the equation of motion: against reference numbers, and against energies, differences
and virtual work."""

import numpy as np
import pytest

COARSE = {"quadrature.intervals": 2}
SMALL = pytest.param("paper", {"quadrature.intervals": 1}, marks=pytest.mark.no_jit, id="small")
FEW = [
    SMALL,
    pytest.param(
        "paper_16dof", {**COARSE, "strain.passive_coordinates": "raw"}, id="paper_16dof raw"
    ),
    pytest.param("four_tendon", COARSE, id="redundant"),
    pytest.param("helical", COARSE, id="pre-curved"),
    pytest.param("paper_48dof", COARSE, id="explicit"),
]
TIGHT = {  # three times what was measured
    "mass": 8e-7,
    "bias": 4e-6,
    "damping": 5e-8,
    "actuation": 5e-8,
    "elastic_force": 1e-7,
    "external_force": 5e-7,
    "tip_jacobian": 6e-7,
    "tip_pose": 8e-7,
}


def gradient(function, q, step):
    """Central differences of a scalar or array function, last axis the coordinate."""
    return np.stack(
        [(function(q + step * e) - function(q - step * e)) / (2 * step) for e in np.eye(q.size)],
        axis=-1,
    )


def assert_close(found, expected, relative):
    """Within `relative` of the largest entry."""
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * largest)


@pytest.mark.parametrize("dof", [10, 16])
@pytest.mark.parametrize("case", range(4))
def test_terms_agree_with_an_independent_model(dof, case, build, reference, check_terms):
    """Automatic differentiation of the rod's Lagrangian, see tests/data; at 48 intervals a
    piece."""
    name = {10: "paper", 16: "paper_16dof"}[dof]
    weight = [0.0, 0.0, -9.81]
    changes = {"quadrature.intervals": 48, "effects.gravity.acceleration": weight}
    if dof == 16:
        changes["strain.passive_coordinates"] = "raw"
    expected = reference(f"terms_{dof}dof")[case]
    model = build(name, changes)
    found = model.terms(expected["q"], expected["q_dot"])
    check_terms(found, expected, TIGHT)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_kinetic_energy_is_conserved_by_the_inertial_terms(name, changes, build, random_state):
    """q_dot . bias = 1/2 q_dot^T M_dot q_dot: M_dot - 2 C is skew."""
    model = build(name, changes)
    q, q_dot = random_state(model, 3)
    size = np.abs(q).max()
    speed = np.abs(q_dot).max()
    h = 1e-4 * size / speed
    q_ahead = q + h * q_dot
    ahead = model.terms(q_ahead, q_dot).mass
    q_behind = q - h * q_dot
    behind = model.terms(q_behind, q_dot).mass
    M_dot = (ahead - behind) / (2 * h)
    power = 0.5 * q_dot @ M_dot @ q_dot
    bias = model.terms(q, q_dot).bias
    scale = np.abs(q_dot) @ np.abs(bias)
    np.testing.assert_allclose(q_dot @ bias, power, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_bias_is_lagranges(name, changes, build, random_state):
    """C q_dot = M_dot q_dot - d(1/2 q_dot^T M q_dot)/dq, every component."""
    model = build(name, changes)
    q, q_dot = random_state(model, 4)
    size = np.abs(q).max()
    M = gradient(lambda x: model.terms(x, q_dot).mass, q, 1e-4 * size)
    expected = np.einsum("ijk,j,k->i", M, q_dot, q_dot) - 0.5 * np.einsum(
        "ijk,i,j->k", M, q_dot, q_dot
    )
    assert_close(model.terms(q, q_dot).bias, expected, 3e-6)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_elastic_force_and_actuation_are_gradients(name, changes, build, random_state):
    """Of the elastic energy, and of the tendons' lengths, B = -(d length / dq)^T: a tension does
    work as its tendon shortens."""
    model = build(name, changes)
    q, q_dot = random_state(model, 8)
    terms = model.terms(q, q_dot)
    step = 1e-4 * np.abs(q).max()
    assert_close(
        terms.elastic_force, gradient(lambda x: model.energy(x, q_dot).elastic, q, step), 1e-6
    )
    slope = gradient(model.tendon_lengths, q, step)
    assert_close(terms.actuation, -slope.T, 1e-6)


@pytest.mark.parametrize(
    ("name", "changes"),
    [p for p in FEW if p.id not in ("redundant", "explicit")]
    + [pytest.param("paper moments 0-3", COARSE, id="moments")],
)
def test_the_coordinates_chase_the_tensions(name, changes, build, random_state):
    """K - B u = G (q - [u; 0]), B = G's first columns: physics of the statics-based strain with
    independent tendons."""
    model = build(name, changes)
    q, q_dot = random_state(model, 10)
    rng = np.random.default_rng(0)
    u = rng.uniform(0, 30, model.tendon_count)
    terms = model.terms(q, q_dot)
    passive = np.zeros(q.size - u.size)
    rest = np.concatenate([u, passive])
    np.testing.assert_array_equal(model.rest_coordinates(u), rest)
    columns = terms.stiffness[:, : u.size]
    assert_close(terms.actuation, columns, 1e-12)
    drive = terms.elastic_force - terms.actuation @ u
    np.testing.assert_allclose(
        drive, terms.stiffness @ (q - rest), atol=1e-12 * np.abs(terms.elastic_force).max()
    )


@pytest.mark.parametrize("name", ["paper", "four_tendon", "paper_48dof"])
def test_stiffness_is_the_jacobian_of_the_drive(name, build, random_state):
    """At rest for the statics-based strain; everywhere for an explicit basis, which needs to know
    the tension.

    Redundant tendons: at rest means at tensions that the coordinates can take, half of each
    opposite pair.
    """
    model = build(name, COARSE)
    u = (
        np.array([4.0, 3.0, 0.0, 1.0, 2.0, 0.0, 5.0, 1.0, 3.0, 0.0])
        if model.tendon_count == 10
        else np.array([2.0, 1.0, 1.0, 2.0])
    )
    if name == "paper_48dof":
        q = random_state(model, 11)[0]
    else:
        q = model.rest_coordinates(u)

    def unbalanced(x):
        terms = model.terms(x, 0 * x)
        return terms.elastic_force - terms.actuation @ u

    assert_close(
        model.terms(q, 0 * q, u).stiffness, gradient(unbalanced, q, 1e-4 * np.abs(q).max()), 1e-6
    )
