"""The strain parametrisations against their definitions: the balance (30), derivatives by
differences, rigid strains, limits."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.motion.equilibrium import strain_is_continuous
from soft_tendon_env.mechanics.terms.evaluate import configure
from soft_tendon_env.mechanics.terms.parametrisation import strain_from_rest, strain_has_margin
from soft_tendon_env.mechanics.terms.statics_newton import (
    ANY,
    Search,
    solve_statics,
    strain_tension,
)
from soft_tendon_env.mechanics.workspace import make_workspace
from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.grid import screw_matrices
from soft_tendon_env.scene.file import load_scene
from soft_tendon_env.scene.scene import segment_index, tendon_ends, tendon_offset
from soft_tendon_env.scene.strain import STRAINS

TOLERANCE = 1e-12
COARSE = {"quadrature.intervals": 2}
SMALL = pytest.param("paper", {"quadrature.intervals": 1}, marks=pytest.mark.no_jit, id="small")
RAW = {**COARSE, "strain.passive_coordinates": "raw"}
STATICS_BASED = [
    SMALL,
    pytest.param("paper", COARSE, id="paper"),
    pytest.param("paper_16dof", RAW, id="paper_16dof raw"),
    pytest.param("paper moments 0-2", COARSE, id="paper moments 0-2"),
    pytest.param("four_tendon", COARSE, id="redundant"),
    pytest.param("two_segment_six", COARSE, id="two segments"),
    pytest.param("helical", COARSE, id="pre-curved"),
    pytest.param(
        "catheter", {**COARSE, "strain.strains": ["torsion", "bend_y", "bend_z"]}, id="Kirchhoff"
    ),
]
EXPLICIT = [pytest.param("paper_48dof", COARSE, id="explicit")]


def reference_strain(scene, X):
    reference = np.zeros((X.size, 6))
    reference[:, :3] = np.array([segment.curvature for segment in scene.segments])[
        segment_index(scene, X)
    ]
    reference[:, 3] = 1.0
    return reference


def tendon_wrenches(scene, X, xi):
    """Phi_a(xi) = -[d x t; t] of every tendon from the scene's own geometry, zero past its ends:
    (n_a, points, 6)."""
    columns = []
    for tendon in scene.tendons:
        start, end = tendon_ends(scene, tendon)
        places = np.clip(X, start, end)
        offset, slope = tendon_offset(scene, tendon, places)
        d = np.insert(offset, 0, 0.0, axis=1)
        d_prime = np.insert(slope, 0, 0.0, axis=1)
        turned = np.cross(xi[:, :3], d)
        stretch = xi[:, 3:]
        t = turned + stretch + d_prime
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        moment = np.cross(d, t)
        wrench = -np.hstack([moment, t])
        is_there = (start < X) & (end > X)
        column = wrench * is_there[:, None]
        columns.append(column)
    return np.array(columns)


@pytest.mark.parametrize(("name", "changes"), STATICS_BASED)
def test_implicit_strain_balances_tensions_and_passive_fields(
    name, changes, build, random_state, at_points
):
    """(30): Sigma (xi - xi*) = Phi_a(xi) tau + Phi_p q_p to round-off, in the strains that
    exist."""
    model = build(name, changes)
    strain = model.arm.strain
    q, _ = random_state(model, 1)
    X, xi = model.strain(q)
    tau = np.zeros(model.tendon_count)
    strain_tension(strain, q, tau)
    wrenches = tendon_wrenches(model.scene, X, xi)
    wrench = np.einsum("i,imj->mj", tau, wrenches)
    if strain.size > strain.active:
        fields = at_points(model, strain.passive)
        wrench += np.einsum("i,imj->mj", q[strain.active :], fields)
    exists = np.isin(STRAINS, model.scene.strain.strains)
    elasticity = screw_matrices(model.scene, X)[0]
    expected = exists * wrench / elasticity
    assert np.abs(expected).max() > 1e-3  # the state is worth testing
    np.testing.assert_allclose(
        xi - reference_strain(model.scene, X),
        expected,
        atol=3e-15 * max(1.0, np.abs(expected).max()),
    )


@pytest.mark.parametrize(("name", "changes"), STATICS_BASED + EXPLICIT)
def test_columns_rates_and_bias_are_the_derivatives_of_the_strain(
    name, changes, build, random_state, check_derivatives
):
    model = build(name, changes)
    check_derivatives(model, *random_state(model, 2), rounding=1e-12)


@pytest.mark.parametrize(
    "strains",
    [
        ("torsion", "bend_y", "bend_z"),
        ("torsion", "bend_y", "bend_z", "shear_y", "shear_z"),
        ("bend_y",),
    ],
    ids=["Kirchhoff", "inextensible", "bend_y"],
)
def test_rigid_strains_stay_exactly_zero(strains, build, random_state, workspace_at, at_points):
    changes = {**COARSE, "strain.strains": list(strains)}
    model = build("helical", changes)
    q, q_dot = random_state(model, 3)
    rigid = ~np.isin(STRAINS, strains)
    X, xi = model.strain(q)
    reference = reference_strain(model.scene, X)
    np.testing.assert_array_equal(xi[:, rigid], reference[:, rigid])
    work = workspace_at(model, q, q_dot)
    arrays = (work.strain.xi_dot, work.strain.xi_bias, work.strain.Phi)
    for field in arrays:
        values = at_points(model, field)
        assert not values[..., rigid].any()
        assert values[..., ~rigid].any()


def solve_from_guess(model, q, guess):
    """solve_statics from a guess: what it returns, and the strain."""
    work = make_workspace(model.arm)
    work.strain.xi[:] = guess
    search = Search(1.0, TOLERANCE, ANY)
    law = model.arm.strain
    failed = solve_statics(model.arm, law, q, search, work.strain, work.kinematics)
    return failed, work.strain.xi


@pytest.mark.no_jit
@pytest.mark.parametrize(("tension", "reaches"), [(150.0, True), (-300.0, True), (-1500.0, False)])
def test_strong_pulls_and_pushes(tension, reaches, build):
    """Pulling has a solution at any size that the section bears; pushing past the section's shear
    stiffness has none, and says where."""
    model = build("paper", COARSE)
    q = np.zeros(10)
    work = make_workspace(model.arm)
    q[0] = tension
    block, reached = configure(model.arm, q, TOLERANCE, work)
    assert (
        (block == -1 and reached == 1.0)
        if reaches
        else (0 <= block < 2 * model.arm.rod.packs and 0 < reached < 1)
    )
    if not reaches:  # what is left in strain.xi is the strain at the part that was reached
        solved = solve_from_guess(model, reached * q, work.strain.xi)
        np.testing.assert_array_equal(solved[0], -1)


def has_margin(model, tension):
    work = make_workspace(model.arm)
    q = model.rest_coordinates(tension)
    return bool(strain_has_margin(model.arm, q, 1e-6, work.strain, work.kinematics))


def test_strains_near_the_limit_of_a_push_have_no_margin(build):
    """A single straight tendon pushes its section over at 320 N; pulls have a margin as far as they
    have a strain."""
    model = build("paper", COARSE)
    one = np.eye(10)[0]
    assert [has_margin(model, push * one) for push in (-100.0, -280.0, -315.0, -330.0, -1e4)] == [
        True,
        True,
        False,
        False,
        False,
    ]
    work = make_workspace(model.arm)
    pushed = -315.0 * one
    solved = strain_from_rest(model.arm, pushed, TOLERANCE, work.strain, work.kinematics)
    assert solved[0] == -1
    assert [has_margin(model, pull * one) for pull in (0.0, 100.0, 250.0, 300.0, 1e4)] == [
        True,
        True,
        True,
        False,
        False,
    ]


@pytest.mark.parametrize(
    ("start", "end", "continuous"),
    [(0.0, 60.0, True), (-100.0, -280.0, True), (-280.0, -330.0, False)],
    ids=("a pull has one strain", "a push on its branch", "a push past the end of its branch"),
)
def test_a_strain_is_continuous_up_to_the_end_of_its_branch(start, end, continuous):
    scene = load_scene("paper")
    arm = build_model(scene).arm
    first = np.eye(10)[0]
    work = make_workspace(arm)
    way = (start * first, end * first)
    assert strain_is_continuous(arm, *way, work.strain, work.kinematics) is continuous
