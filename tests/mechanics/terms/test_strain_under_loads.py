"""The strain with loads inside (paper III-B): derivatives by differences, balance of the whole rod,
independent numbers, where it ends."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.evaluate import configure
from soft_tendon_env.mechanics.terms.parametrisation import strain_has_margin
from soft_tendon_env.mechanics.types import Loaded
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.model import model_on
from soft_tendon_env.scene.file import load_scene

TOLERANCE = 1e-12
MOST = {
    "mass": 1e-5,
    "bias": 1e-4,
    "damping": 1e-5,
    "actuation": 1e-5,
    "stiffness": 1e-5,
    "tip_jacobian": 1e-5,
    "tip_pose": 2e-6,
}


def on_few_intervals(name, changes):
    """The model of a scene with changes, without a look at what the quadrature makes of it."""
    scene = load_scene(name).replace(changes)
    return model_on(scene, changes["quadrature.intervals"])


INSIDE = {"quadrature.intervals": 2, "strain.include_loads": True}
GRAVITY = {"effects.gravity.acceleration": [3.0, -6.0, -5.0]}
FORCE = {"effects.tip_load.force": [0.002, 0.005, -0.01], "effects.tip_load.mass": 0.005}
MOMENT = {"effects.tip_load.moment": [0.002, 0.003, -0.005]}
RAW = {"strain.passive_coordinates": "raw"}
KIRCHHOFF = ["torsion", "bend_y", "bend_z"]
SMALL = pytest.param(
    "paper", {**INSIDE, **GRAVITY, "quadrature.intervals": 1}, marks=pytest.mark.no_jit, id="small"
)
FORCES = [
    SMALL,
    pytest.param("paper", {**INSIDE, **GRAVITY}, id="gravity"),
    pytest.param(
        "paper_16dof", {**INSIDE, **RAW, **GRAVITY, **FORCE}, id="passive, payload and force"
    ),
    pytest.param("four_tendon", {**INSIDE, **GRAVITY, **FORCE}, id="redundant"),
    pytest.param("helical", {**INSIDE, **GRAVITY, **FORCE}, id="pre-curved"),
    pytest.param(
        "catheter",
        {**INSIDE, **GRAVITY, **FORCE, "strain.strains": KIRCHHOFF},
        id="Kirchhoff",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        "three_tendon",
        {**INSIDE, **GRAVITY, **FORCE, "strain.strains": ["bend_y", "stretch", "shear_z"]},
        id="planar",
    ),
]
MOMENTS = [
    pytest.param("paper", {**INSIDE, **GRAVITY, **FORCE, **MOMENT}, id="dead moment"),
    pytest.param(
        "paper",
        {**INSIDE, **MOMENT, "quadrature.intervals": 1},
        marks=pytest.mark.no_jit,
        id="small dead moment",
    ),
]


@pytest.mark.parametrize(("name", "changes"), FORCES + MOMENTS)
def test_columns_rates_and_bias_are_the_derivatives_of_the_strain(
    name, changes, random_state, check_derivatives
):
    model = on_few_intervals(name, changes)
    assert isinstance(model.arm.strain, Loaded)
    assert not model.arm.effects.count
    check_derivatives(model, *random_state(model, 2))


def net_force(model, work, at_points):
    """K - F by its definition: work of the elastic stress less that of the loads at the nodes and
    the tip, along every column (n,)."""
    rod = model.arm.rod
    loads = model.arm.strain
    n = model.coordinate_count
    weights = np.repeat(rod.weight.reshape(-1, 1, LANES), 6, axis=1)
    weight = at_points(model, weights.ravel())[0]
    stiff = at_points(model, rod.root_stiffness)[0] ** 2
    change = work.strain.xi - rod.reference_strain
    strained = at_points(model, change)[0]
    Phi = at_points(model, work.strain.Phi)
    force = np.einsum("jmi,mi->j", Phi, weight * stiff * strained)
    last = slice(-6 * LANES + LANES - 1, None, LANES)
    J = work.kinematics.J.reshape(n, -1)
    tip = J[:, last]
    pose = work.kinematics.pose.reshape(-1, 12, LANES)
    inertia = rod.inertia.reshape(-1, 6, LANES)
    acceleration = np.array(loads.acceleration)
    dead = inertia[:, None, 3] * acceleration[:, None]
    J_nodes = work.kinematics.J.reshape(n, -1, 6, LANES)
    J_linear = J_nodes[:, :, 3:]
    R = pose[:, :9].reshape(-1, 3, 3, LANES)
    force -= np.einsum("jpal,pbal,pbl->j", J_linear, R, dead)
    rotation = pose[-1, :9, -1]
    R_tip = rotation.reshape(3, 3)
    tip_force = R_tip.T @ np.array(loads.force)
    tip_moment = R_tip.T @ np.array(loads.moment)
    return force - tip[:, 3:] @ tip_force - tip[:, :3] @ tip_moment


@pytest.mark.parametrize(("name", "changes"), FORCES + MOMENTS)
def test_elastic_force_less_that_of_the_loads_is_G_q(
    name, changes, random_state, workspace_at, at_points
):
    """To round-off, at any coordinates: so q = [u; 0] is at rest."""
    model = on_few_intervals(name, changes)
    q, _ = random_state(model, 5)
    work = workspace_at(model, q)
    expected = net_force(model, work, at_points)
    terms = model.terms(q, np.zeros_like(q))
    scale = np.abs(terms.stiffness) @ np.abs(q)
    misfit = terms.elastic_force - terms.external_force - expected
    assert (np.abs(misfit) <= 1e-12 * scale).all()
    np.testing.assert_array_equal(terms.external_force, 0.0)


@pytest.mark.parametrize(("name", "changes"), FORCES)
def test_stiffness_is_symmetric_and_B_its_part_for_dead_forces(name, changes, random_state):
    model = on_few_intervals(name, changes)
    q, q_dot = random_state(model, 6)
    terms = model.terms(q, q_dot)
    assert model.arm.strain.has_potential
    scale = np.sqrt(np.diag(terms.stiffness))
    G = terms.stiffness / np.outer(scale, scale)
    difference = G - G.T
    assert np.abs(difference).max() < 1e-12
    assert np.linalg.eigvalsh(G)[0] > 0.0
    if model.arm.strain.is_tensions:
        np.testing.assert_allclose(
            terms.actuation, terms.stiffness, atol=1e-12 * np.abs(terms.stiffness).max()
        )


@pytest.mark.parametrize("dof", [10, 16])
@pytest.mark.parametrize("case", range(3))
def test_terms_agree_with_an_independent_model(dof, case, reference, check_terms):
    """Automatic differentiation of the rod's energy, on 16 intervals a piece, see tests/data; at 32
    intervals."""
    expected = reference(f"loaded_terms_{dof}dof")[case]
    changes = {
        "quadrature.intervals": 32,
        "strain.include_loads": True,
        "effects.gravity.acceleration": expected["gravity"],
    }
    changes |= RAW if dof == 16 else {}
    assert not any(expected["tip_force"])
    found = on_few_intervals({10: "paper", 16: "paper_16dof"}[dof], changes).terms(
        expected["q"], expected["q_dot"]
    )
    check_terms(found, expected, MOST)


UPRIGHT = {**INSIDE, "strain.strains": KIRCHHOFF, "quadrature.intervals": 8}


LENGTH = 0.3  # [m]
BENDING = 5e5 * np.pi * 0.01**4 / 4  # EI [N m^2]
WEIGHT = 1070.0 * np.pi * 0.01**2  # mass per length [kg/m]
EULER = "effects.tip_load.force", np.pi**2 * BENDING / (4 * LENGTH**2)
GREENHILL = "effects.gravity.acceleration", 7.8373 * BENDING / (WEIGHT * LENGTH**3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "critical"),
    [pytest.param(*EULER, id="Euler"), pytest.param(*GREENHILL, id="own weight")],
)
def test_a_column_holds_up_to_its_critical_load(load, critical, build):
    """Of Euler, pi^2 EI / 4 L^2, and under its own weight, 7.8373 EI / L^3 (Greenhill): beyond, it
    says that the arm buckles."""
    pull = -0.999 * critical
    changes = {**UPRIGHT, load: [pull, 0.0, 0.0]}
    below = build("three_tendon", changes)
    still = np.zeros(below.coordinate_count)
    G = below.terms(still, still).stiffness
    assert np.linalg.eigvalsh(G)[0] > 0.0
    pose = below.tip_pose(still)[:3, 3]
    np.testing.assert_allclose(pose, [LENGTH, 0.0, 0.0], atol=1e-12)
    with pytest.raises(
        ValueError,
        match=(
            "include_loads is true, but without tensions the arm does not hold the loads.* the arm"
            " buckles"
        ),
    ):
        build("three_tendon", {**UPRIGHT, load: [-1.001 * critical, 0.0, 0.0]})


@pytest.mark.slow
def test_coordinates_near_buckling_have_no_margin():
    """Just below the critical load there is a strain, and too little stiffness left."""
    for part, has_margin in ((0.5, True), (0.99, False)):
        model = on_few_intervals(
            "three_tendon", {**UPRIGHT, EULER[0]: [-part * EULER[1], 0.0, 0.0]}
        )
        work = make_workspace(model.arm)
        q = np.zeros(model.coordinate_count)
        solved = configure(model.arm, q, TOLERANCE, work)
        assert solved[0] == -1
        assert (
            strain_has_margin(model.arm, q, TOLERANCE, work.strain, work.kinematics) == has_margin
        )


@pytest.mark.parametrize("load", [EULER, GREENHILL], ids=["Euler", "own weight"])
def test_a_column_of_all_strains_buckles_beyond_its_critical_load(load):
    """Shear and stretch change it little."""
    key, critical = load
    for share, is_held in ((0.98, True), (1.02, False)):
        pull = {key: [-share * critical, 0.0, 0.0]}
        model = on_few_intervals("three_tendon", {**INSIDE, **pull, "quadrature.intervals": 8})
        work = make_workspace(model.arm)
        q = np.zeros(model.coordinate_count)
        block, reached = configure(model.arm, q, TOLERANCE, work)
        assert (block == -1) == is_held
        if not is_held:
            # one past the blocks of points: the arm as a whole
            assert block == 2 * model.grid.packs
            assert 0.95 < reached < 1.0
