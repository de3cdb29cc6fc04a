"""The terms of the equation of motion: against reference numbers, and against energies, differences and virtual work."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.dynamics import RowLayout, gram, project

COARSE = {"quadrature.intervals": 2}
SMALL = pytest.param("paper", {"quadrature.intervals": 1}, marks=pytest.mark.no_jit, id="small")
FEW = [
    SMALL,
    pytest.param("paper_16dof", {**COARSE, "strain.passive_coordinates": "raw"}, id="paper_16dof raw"),
    pytest.param("four_tendon", COARSE, id="redundant"),
    pytest.param("helical", COARSE, id="pre-curved"),
    pytest.param("paper_48dof", COARSE, id="explicit"),
]


def gradient(function, q, step):
    """Central differences of a scalar or array function, last axis the coordinate."""
    return np.stack([(function(q + step * e) - function(q - step * e)) / (2 * step) for e in np.eye(q.size)], axis=-1)


def assert_close(found, expected, relative):
    """Within `relative` of the largest entry."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * np.abs(expected).max())


# reference numbers ------------------------------------------------------------------------------------------------------


TIGHT = {  # three times what was measured
    "mass": 8e-7, "bias": 4e-6, "damping": 5e-8, "actuation": 5e-8, "elastic_force": 1e-7, "external_force": 5e-7, "tip_jacobian": 6e-7,
    "tip_pose": 8e-7,
}  # fmt: skip


@pytest.mark.parametrize("dof", (10, 16))
@pytest.mark.parametrize("case", range(4))
def test_terms_agree_with_an_independent_model(dof, case, build, reference, check_terms):
    """Automatic differentiation of the rod's Lagrangian, see tests/data; at 48 intervals a piece."""
    name = {10: "paper", 16: "paper_16dof"}[dof]
    raw = {"strain.passive_coordinates": "raw"} if dof == 16 else {}
    changes = {"quadrature.intervals": 48, **raw, "effects.gravity.acceleration": [0.0, 0.0, -9.81]}
    expected = reference(f"terms_{dof}dof")[case]
    found = build(name, changes).terms(expected["q"], expected["q_dot"])
    check_terms(found, expected, TIGHT)


# structure --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ("paper", "four_tendon", "helical", "paper_48dof"))
def test_matrices_are_symmetric_and_definite(name, build, random_state):
    model = build(name)
    terms = model.terms(*random_state(model, 0))
    for value in terms:
        assert np.isfinite(value).all()
    for matrix, least in ((terms.mass, 0.0), (terms.damping, -1e-14), (terms.stiffness, -1e-14)):
        assert_close(matrix, matrix.T, 1e-15)
        scale = np.sqrt(np.diag(matrix))
        sizes = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
        assert sizes[0] > least * sizes[-1]


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_kinetic_energy_is_conserved_by_the_inertial_terms(name, changes, build, random_state):
    """q_dot . bias = 1/2 q_dot^T M_dot q_dot: M_dot - 2 C is skew."""
    model = build(name, changes)
    q, q_dot = random_state(model, 3)
    h = 1e-4 * np.abs(q).max() / np.abs(q_dot).max()
    ahead, behind = (model.terms(q + s * h * q_dot, q_dot).mass for s in (1, -1))
    power = 0.5 * q_dot @ (ahead - behind) @ q_dot / (2 * h)
    terms = model.terms(q, q_dot)
    scale = np.abs(q_dot) @ np.abs(terms.bias)
    np.testing.assert_allclose(q_dot @ terms.bias, power, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_bias_is_lagranges(name, changes, build, random_state):
    """C q_dot = M_dot q_dot - d(1/2 q_dot^T M q_dot)/dq, every component."""
    model = build(name, changes)
    q, q_dot = random_state(model, 4)
    size = np.abs(q).max()
    M = gradient(lambda x: model.terms(x, q_dot).mass, q, 1e-4 * size)
    expected = np.einsum("ijk,j,k->i", M, q_dot, q_dot) - 0.5 * np.einsum("ijk,i,j->k", M, q_dot, q_dot)
    assert_close(model.terms(q, q_dot).bias, expected, 3e-6)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_mass_is_the_sum_over_the_nodes(name, changes, build, random_state, workspace_at, at_nodes):
    """M = sum J^T M_node J, the base's share left out; no column is missing a pack."""
    model = build(name, changes)
    q, q_dot = random_state(model, 6)
    work = workspace_at(model, q, q_dot)
    J, inertia = at_nodes(model, work.J), at_nodes(model, model.arm.rod.inertia)[0]
    assert_close(work.M, np.einsum("imk,mk,jmk->ij", J, inertia, J), 1e-13)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_energies_are_those_of_the_matrices_and_of_the_strain(name, changes, build, random_state):
    model = build(name, changes)
    q, q_dot = random_state(model, 7)
    energy = model.energy(q, q_dot)
    np.testing.assert_allclose(energy.kinetic, 0.5 * q_dot @ model.terms(q, q_dot).mass @ q_dot, rtol=1e-13)
    assert energy.elastic > 0 and energy.load == 0 and energy.total == energy.kinetic + energy.elastic
    at_rest = model.energy(0 * q, 0 * q)
    assert at_rest == (0.0, 0.0, 0.0)


# forces -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_elastic_force_is_the_gradient_of_the_elastic_energy(name, changes, build, random_state):
    model = build(name, changes)
    q, q_dot = random_state(model, 8)
    expected = gradient(lambda x: model.energy(x, q_dot).elastic, q, 1e-4 * np.abs(q).max())
    assert_close(model.terms(q, q_dot).elastic_force, expected, 1e-6)


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_actuation_is_the_shortening_of_the_tendons(name, changes, build, random_state):
    """B = -(d length / dq)^T: a tension does work as its tendon shortens."""
    model = build(name, changes)
    q, q_dot = random_state(model, 9)
    expected = -gradient(model.tendon_lengths, q, 1e-4 * np.abs(q).max()).T
    assert_close(model.terms(q, q_dot).actuation, expected, 1e-6)


@pytest.mark.no_jit
def test_tendons_of_the_stress_free_arm_have_the_lengths_of_their_routing(build):
    """A helix of radius 0.02 and 4 pi 1/m over 1 m, one of 0.025 over half of it; exact for a constant slope."""
    lengths = build("paper", {"quadrature.intervals": 1}).tendon_lengths(np.zeros(10))
    helix = [np.hypot(1, 4 * np.pi * radius) for radius in (0.02, 0.025)]
    surface = np.hypot(1, 0.01)
    np.testing.assert_allclose(lengths, [surface] * 3 + helix[:1] * 2 + [surface / 2] * 3 + [helix[1] / 2] * 2, rtol=1e-14)


@pytest.mark.parametrize(
    ("name", "changes"), [p for p in FEW if p.id not in ("redundant", "explicit")] + [pytest.param("paper_22dof", COARSE, id="paper_22dof")]
)
def test_the_coordinates_chase_the_tensions(name, changes, build, random_state):
    """K - B u = G (q - [u; 0]), B = G's first columns: physics of the statics-based strain with independent tendons."""
    model = build(name, changes)
    q, q_dot = random_state(model, 10)
    u = np.random.default_rng(0).uniform(0, 30, model.tendon_count)
    terms = model.terms(q, q_dot)
    rest = np.concatenate([u, np.zeros(q.size - u.size)])
    np.testing.assert_array_equal(model.rest_coordinates(u), rest)
    assert_close(terms.actuation, terms.stiffness[:, : u.size], 1e-12)
    drive = terms.elastic_force - terms.actuation @ u
    np.testing.assert_allclose(drive, terms.stiffness @ (q - rest), atol=1e-12 * np.abs(terms.elastic_force).max())


@pytest.mark.parametrize(("name", "changes"), FEW)
def test_drive_is_the_pull_less_the_elastic_force_and_the_damping(name, changes, build, random_state, workspace_at):
    """What the time steps read is B u - K - D q_dot, with the very B, K and D of `terms`."""
    model = build(name, changes)
    q, q_dot = random_state(model, 16)
    u = np.random.default_rng(1).uniform(0, 5, model.tendon_count)
    terms = model.terms(q, q_dot)
    damped = terms.damping @ q_dot
    drive = workspace_at(model, q, q_dot, u).drive
    largest = max(np.abs(terms.elastic_force).max(), np.abs(damped).max())
    np.testing.assert_allclose(drive, terms.actuation @ u - terms.elastic_force - damped, rtol=0, atol=1e-12 * largest)
    assert np.abs(damped).max() > 1e-3 * largest
    at_rest, pulled = workspace_at(model, q, tension=u).drive, terms.actuation @ u - terms.elastic_force
    np.testing.assert_allclose(at_rest, pulled, rtol=0, atol=1e-12 * np.abs(terms.elastic_force).max())


@pytest.mark.parametrize("name", ("paper", "four_tendon", "paper_48dof"))
def test_stiffness_is_the_jacobian_of_the_drive(name, build, random_state):
    """At rest for the statics-based strain; everywhere for an explicit basis, which needs to know the tension.

    Redundant tendons: at rest means at tensions that the coordinates can take, half of each opposite pair.
    """
    model = build(name, COARSE)
    u = np.array([4.0, 3.0, 0.0, 1.0, 2.0, 0.0, 5.0, 1.0, 3.0, 0.0]) if model.tendon_count == 10 else np.array([2.0, 1.0, 1.0, 2.0])
    q = random_state(model, 11)[0] if name == "paper_48dof" else model.rest_coordinates(u)

    def unbalanced(x):
        terms = model.terms(x, 0 * x)
        return terms.elastic_force - terms.actuation @ u

    assert_close(model.terms(q, 0 * q, u).stiffness, gradient(unbalanced, q, 1e-4 * np.abs(q).max()), 1e-6)


GRAVITY = {"effects.gravity.acceleration": [1.0, -2.0, -9.81]}
FORCE = {"effects.tip_load.force": [0.3, -0.2, 0.5]}
PAYLOAD = {**GRAVITY, "effects.tip_load.mass": 0.2, "effects.tip_load.inertia": [1e-4, 2e-4, 3e-4]}


@pytest.mark.parametrize("name", ("paper", "helical"))
def test_external_force_is_minus_the_gradient_of_the_load_energy(name, build, random_state):
    model = build(name, {**COARSE, **FORCE, **PAYLOAD})
    q, q_dot = random_state(model, 12)
    expected = -gradient(lambda x: model.energy(x, q_dot).load, q, 1e-4 * np.abs(q).max())
    assert_close(model.terms(q, q_dot).external_force, expected, 1e-6)


def test_load_energy_of_the_straight_arm(build):
    """Weight of the rod at its centre of mass, of the payload at the tip, and the tip force, lifted along x and z."""
    model = build("three_tendon", {"quadrature.intervals": 4, "effects.gravity.acceleration": [-9.81, 0.0, 0.0], **FORCE,
                                   "effects.tip_load.mass": 0.2})  # fmt: skip
    length, rod = 0.3, 1070 * np.pi * 0.01**2 * 0.3
    np.testing.assert_allclose(model.arm.rod.mass, rod + 0.2 - rod * 7 / 90 / 1, rtol=1e-12)  # the base node's share is left out
    energy = model.energy(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(energy.load, 9.81 * (rod * length / 2 + 0.2 * length) - 0.3 * length, rtol=1e-12)


def test_payload_adds_its_inertia_at_the_tip(build, random_state):
    payload = {"effects.tip_load.mass": 0.2, "effects.tip_load.inertia": [1e-4, 2e-4, 3e-4]}
    light, heavy = build("paper", COARSE), build("paper", {**COARSE, **payload})
    q, q_dot = random_state(light, 13)
    before, after = light.terms(q, q_dot), heavy.terms(q, q_dot)
    J = before.tip_jacobian
    assert_close(after.mass, before.mass + J.T @ np.diag([1e-4, 2e-4, 3e-4, 0.2, 0.2, 0.2]) @ J, 1e-12)
    assert not after.external_force.any()


@pytest.mark.parametrize("frame", ("world", "tip"))
@pytest.mark.parametrize("name", ("paper", "helical"))
def test_tip_wrench_does_virtual_work(name, frame, build, random_state):
    """F_j = force . d(position)/dq_j + moment . (rotation per q_j), both in the frame of the load, by differences of the tip's pose."""
    force, moment = np.array([0.3, -0.2, 0.5]), np.array([0.02, 0.05, -0.03])
    load = {"effects.tip_load.force": force.tolist(), "effects.tip_load.moment": moment.tolist(), "effects.tip_load.frame": frame}
    model = build(name, {**COARSE, **load})
    q, q_dot = random_state(model, 14)
    R, step = model.tip_pose(q)[:3, :3], 1e-4 * np.abs(q).max()
    if frame == "tip":
        force, moment = R @ force, R @ moment
    expected = []
    for e in np.eye(q.size):
        ahead, behind = model.tip_pose(q + step * e), model.tip_pose(q - step * e)
        turned = Rotation.from_matrix(ahead[:3, :3] @ behind[:3, :3].T).as_rotvec()
        expected.append((force @ (ahead[:3, 3] - behind[:3, 3]) + moment @ turned) / (2 * step))
    assert_close(model.terms(q, q_dot).external_force, expected, 1e-6)


# sums -------------------------------------------------------------------------------------------------------------------


@pytest.mark.no_jit
@pytest.mark.parametrize("n", (1, 3, 4, 5, 9))
def test_gram_and_project_of_columns_that_live_in_parts(n):
    rng = np.random.default_rng(n)
    packs, layout = 5, RowLayout(groups=2, size=3 * LANES, used=2 * LANES)
    rows = layout.groups * layout.size
    first = rng.integers(0, packs, n)
    last = first + 1 + rng.integers(0, packs - first)
    columns, weight, field = rng.normal(size=(n, packs, rows)), rng.uniform(1, 2, packs * rows), rng.normal(size=packs * rows)
    for column, begin, end in zip(columns, first, last, strict=True):
        column[:begin], column[end:] = 0.0, 0.0
        column.reshape(packs, layout.groups, layout.size)[..., layout.used :] = 0.0
    flat, out, projected = columns.reshape(n, -1), np.full((n, n), np.nan), np.full(n, np.nan)
    gram(flat.ravel(), weight, layout, first, last, out)
    project(flat.ravel(), field, layout, first, last, projected)
    np.testing.assert_allclose(out, (flat * weight) @ flat.T, atol=1e-12)
    np.testing.assert_allclose(projected, flat @ field, atol=1e-12)
