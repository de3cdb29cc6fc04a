"""Poses, Jacobian and bias against exponentials and differences, and the fourth order of the Magnus
steps as slopes."""

import numpy as np
import pytest
from scipy.linalg import expm

from soft_tendon_env.mechanics.algebra.lanes import LANES

COARSE = {"quadrature.intervals": 2}
SMALL = pytest.param("paper", {"quadrature.intervals": 1}, marks=pytest.mark.no_jit, id="small")
MODELS = [
    SMALL,
    pytest.param("paper", {"quadrature.intervals": 3}, id="paper"),
    pytest.param("helical", COARSE, id="pre-curved"),
    pytest.param("paper_48dof", COARSE, id="explicit"),
]
COUNTS = (2, 4, 8, 16)


def hat(xi):
    """The 4x4 matrix of a twist (k, p)."""
    k_x, k_y, k_z, p_x, p_y, p_z = xi
    return np.array(
        [
            [0, -k_z, k_y, p_x],
            [k_z, 0, -k_x, p_y],
            [-k_y, k_x, 0, p_z],
            [0, 0, 0, 0],
        ]
    )


def vee(matrices):
    """Twists (.., 6) of 4x4 matrices."""
    m = np.asarray(matrices)
    return np.stack(
        [m[..., 2, 1], m[..., 0, 2], m[..., 1, 0], m[..., 0, 3], m[..., 1, 3], m[..., 2, 3]],
        axis=-1,
    )


def at_nodes(model, field):
    """A field over nodes as (..., nodes, 6), padding left out."""
    packed = field.reshape(-1, model.arm.rod.packs, 6, LANES)
    by_node = packed.swapaxes(-1, -2).reshape(len(packed), -1, 6)
    return by_node[:, model.grid.real]


@pytest.fixture
def constant_strain(build):
    """An arm whose six coordinates are the six strains, the same everywhere, less the reference."""
    modes = [
        {
            "strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"],
            "order": 0,
            "span": "rod",
        }
    ]
    return build(
        "three_tendon", {"strain": {"type": "explicit", "modes": modes}, "quadrature.intervals": 3}
    )


@pytest.mark.parametrize("seed", range(3))
def test_constant_strain_gives_the_exponential_everywhere(seed, constant_strain):
    X = np.array([0.0, 1e-9, 0.05, 0.1, 0.2999, 0.3])
    scale = np.array([8, 8, 8, 0.3, 0.3, 0.3])
    straight = np.array([0, 0, 0, 1, 0, 0])
    rng = np.random.default_rng(seed)
    q = scale * rng.normal(size=6)
    twist = hat(q + straight)
    poses = [expm(x * twist) for x in X]
    expected = np.array(poses)
    tip = constant_strain.tip_pose(q)
    backbone = constant_strain.backbone_at(q, X)
    np.testing.assert_allclose(tip, expected[-1], atol=1e-14)
    np.testing.assert_allclose(backbone, expected, atol=1e-14)


@pytest.mark.parametrize(("name", "changes"), MODELS)
def test_body_jacobian_at_all_nodes_against_differences(
    name, changes, build, random_state, workspace_at
):
    """g^-1 dg/dq_j = J_j^ at every node; the tip's is what `terms` gives."""
    model = build(name, changes)
    q, q_dot = random_state(model, 1)
    ends = model.grid.start + model.grid.length
    nodes = ends[model.grid.real]
    work = workspace_at(model, q, q_dot)
    J = at_nodes(model, work.kinematics.J)
    pose = model.backbone_at(q, nodes)
    step = 1e-4 * np.abs(q).max()
    for j in range(0, q.size, 1 if q.size < 25 else 7):
        change = step * np.eye(q.size)[j]
        ahead = model.backbone_at(q + change, nodes)
        behind = model.backbone_at(q - change, nodes)
        rate = (ahead - behind) / (2 * step)
        twist = vee(np.linalg.solve(pose, rate))
        largest = np.abs(J[j]).max()
        np.testing.assert_allclose(J[j], twist, atol=2e-6 * largest)
    terms = model.terms(q, q_dot)
    np.testing.assert_array_equal(terms.tip_jacobian, J[:, -1].T)
    eta = at_nodes(model, work.kinematics.eta)[0]
    largest = np.abs(eta).max()
    expected = np.einsum("j,jmi->mi", q_dot, J)
    np.testing.assert_allclose(eta, expected, atol=1e-12 * largest)


@pytest.mark.parametrize(("name", "changes"), MODELS)
def test_bias_at_all_nodes_against_differences(name, changes, build, random_state, workspace_at):
    """J_dot q_dot by differences of J along the motion."""
    model = build(name, changes)
    q, q_dot = random_state(model, 2)
    size = np.abs(q).max()
    speed = np.abs(q_dot).max()
    h = 1e-4 * size / speed
    q_ahead = q + h * q_dot
    ahead = at_nodes(model, workspace_at(model, q_ahead).kinematics.J)
    q_behind = q - h * q_dot
    behind = at_nodes(model, workspace_at(model, q_behind).kinematics.J)
    change = np.einsum("j,jmi->mi", q_dot, ahead - behind)
    expected = change / (2 * h)
    work = workspace_at(model, q, q_dot)
    bias = at_nodes(model, work.kinematics.eta_bias)[0]
    largest = np.abs(expected).max()
    np.testing.assert_allclose(bias, expected, atol=2e-6 * largest)
    terms = model.terms(q, q_dot)
    np.testing.assert_array_equal(terms.tip_bias, bias[-1])


def slope(errors):
    """Order of convergence, fitted over COUNTS."""
    counts = np.log(COUNTS)
    sizes = np.log(errors)
    return -np.polyfit(counts, sizes, 1)[0]


@pytest.mark.parametrize("name", ["paper", "paper_48dof"])
def test_terms_converge_with_fourth_order(name, build, random_state):
    """Against 64 intervals a piece."""
    q, q_dot = random_state(build(name, {"quadrature.intervals": 8}), 5)
    found = []
    for count in (64, *COUNTS):
        model = build(name, {"quadrature.intervals": count})
        terms = model.terms(q, q_dot)
        found.append(terms._asdict())
    fine, *coarse = found
    for key in (
        "tip_pose",
        "tip_jacobian",
        "tip_bias",
        "mass",
        "bias",
        "damping",
        "stiffness",
        "actuation",
        "elastic_force",
    ):
        size = np.abs(fine[key]).max()
        errors = []
        for terms in coarse:
            off = np.abs(terms[key] - fine[key])
            errors.append(off.max() / size)
        order = slope(errors)
        assert order > 3.7, f"{key}: {errors}, order {order:.2f}"
        assert errors[-1] < 1e-4, f"{key}: {errors}, order {order:.2f}"
