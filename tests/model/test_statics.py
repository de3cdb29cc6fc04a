"""Equilibria: balance, reference numbers of a shooting solver, every shipped scene, the limits of
the strain, honest failure."""

import re

import numpy as np
import pytest

from soft_tendon_env.model.build import build_model
from soft_tendon_env.model.equilibrium_residual import Balance
from soft_tendon_env.model.load_continuation import RESIDUAL
from soft_tendon_env.model.model import model_on
from soft_tendon_env.model.statics import (
    ChordSolver,
    RedundancyWarning,
    commanded_equilibrium,
    static_equilibrium,
)
from soft_tendon_env.scene.file import load_scene, scene_names


def model_of(name, **changes):
    return build_model(
        load_scene(name).replace({key.replace("__", "."): value for key, value in changes.items()})
    )


@pytest.mark.parametrize(
    "name", sorted({*scene_names()} - {"paper_among_obstacles"})
)  # where friction holds, many states are at rest
def test_every_scene_balances_the_forces(name):
    model = model_of(name)
    greatest = np.array([tendon.tension_limits[1] for tendon in model.scene.tendons])
    rng = np.random.default_rng(0)
    tensions = rng.uniform(0.0, 0.5 * greatest, (3, greatest.size))
    for u in tensions:
        found = static_equilibrium(model, u)
        terms = model.terms(found.q, np.zeros_like(found.q), u)
        assert found.converged
        assert found.residual <= RESIDUAL
        assert found.reason == ""
        force = terms.actuation @ u - terms.elastic_force + terms.external_force
        largest = np.abs(terms.elastic_force).max()
        assert np.abs(force).max() < 1e-8 * largest
        expected_tip_pose = model.tip_pose(found.q)
        np.testing.assert_array_equal(found.tip_pose, expected_tip_pose)


def test_pushes_past_the_stiffness_of_an_explicit_strain_end_the_path():
    """Torsion gives way where the pushes' moment arms outweigh its stiffness, G J = P sum y^2 +
    z^2."""
    model = model_of(
        "three_tendon",
        strain={"type": "explicit", "modes": [{"strains": ["torsion"], "order": 0, "span": "rod"}]},
    )
    torsion = 5e5 / 3 * np.pi * 0.01**4 / 2
    squares = 3 * 0.008**2
    limit = torsion / squares
    assert static_equilibrium(model, np.full(3, -0.99 * limit)).converged
    found = static_equilibrium(model, np.full(3, -1.01 * limit))
    assert not found.converged
    assert "no longer stable (bifurcation" in found.reason
    assert found.load * 1.01 == pytest.approx(1.0, abs=2e-3)


def test_the_paper_arm_agrees_with_shooting(reference):
    model = model_of("paper", quadrature__intervals=48)
    cases = [
        case
        for case in reference("statics")
        if not any(case["gravity"]) and not any(case["tip_wrench_world"])
    ]
    assert len(cases) >= 10
    for case in cases:
        tip = static_equilibrium(model, case["tension"]).tip_pose
        np.testing.assert_allclose(tip[:3, 3], case["tip_position"], atol=1e-6)


HELICES = [
    {
        "routing": {"type": "helix", "radius": 0.008, "angular_rate": 12.0, "phase": phase},
        "tension_limits": [0.0, 30.0],
    }
    for phase in (0.0, 90.0, 180.0, 270.0)
]


@pytest.mark.filterwarnings("ignore::soft_tendon_env.model.statics.RedundancyWarning")
def test_what_redundant_tendons_leave_out_is_told():
    """Four helices: one of four combinations of tensions strains the bent arm alone. With all of
    them the rod rests as full physics."""
    changes = {"tendons": HELICES, "quadrature.intervals": 32}
    helices = load_scene("four_tendon").replace(changes)
    modes = [
        {
            "strains": ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"],
            "order": 8,
            "span": "rod",
        }
    ]
    model = build_model(helices)
    explicit = build_model(helices.replace({"strain": {"type": "explicit", "modes": modes}}))
    assert model.coordinate_count == 3
    for u in ([30.0, 0.0, 0.0, 0.0], [20.0, 0.0, 5.0, 0.0]):
        found = static_equilibrium(model, u)
        exact = static_equilibrium(explicit, u)
        assert found.converged
        assert exact.converged
        assert exact.tip_error < 0.02 * found.tip_error
        way = found.tip_pose - exact.tip_pose
        off = np.linalg.norm(way[:3, 3])
        assert found.tip_error > 1e-4
        assert found.tip_error == pytest.approx(off, rel=0.02)


STRAIGHT = {
    "routing": {"type": "straight", "offset": [0.0, 0.006]},
    "tension_limits": [0.0, 30.0],
}


@pytest.mark.parametrize(
    ("tension", "is_far"), [(7.0, False), (10.0, True)], ids=["hardly", "clearly"]
)
def test_redundant_tendons_are_warned_of_where_the_tip_is_off(recwarn, tension, is_far):
    """By 1e-4 of the length, against the rod with a coordinate for every strain; a fifth tendon is
    none of them."""
    strains = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
    modes = [{"strains": strains, "order": 8, "span": "rod"}]
    changes = {"tendons": [*HELICES, STRAIGHT]}
    helices = load_scene("four_tendon").replace(changes)
    model = model_on(helices, 32)
    explicit = helices.replace({"strain": {"type": "explicit", "modes": modes}})
    u = [tension, 0.0, 0.0, 0.0, 1.0]
    exact = static_equilibrium(model_on(explicit, 32), u)
    assert not recwarn
    found = static_equilibrium(model, u)
    way = found.tip_pose - exact.tip_pose
    off = np.linalg.norm(way[:3, 3])
    assert (off > 1e-4 * model.length) == is_far
    told = [warning for warning in recwarn if warning.category is RedundancyWarning]
    assert len(told) == is_far
    if told:
        named = re.search(r"its tip is off by ([\d.]+) mm", str(told[0].message))
        assert float(named[1]) == pytest.approx(1e3 * off, rel=0.1)
    # a tension of each alike strains nothing that has no coordinate
    static_equilibrium(model, [30.0, 30.0, 30.0, 30.0, 1.0])
    assert len(recwarn) == is_far


@pytest.mark.parametrize("changes", [{}, {"effects__gravity__acceleration": [0.0, 0.0, -9.81]}])
@pytest.mark.parametrize("name", ["paper", "paper_16dof"])
@pytest.mark.parametrize("step", [0.01, 0.5])
def test_neighbours_of_an_equilibrium_are_those_that_a_search_finds(name, changes, step):
    """Whether tensions are coordinates, or Newton's method with the old stiffness does, or has to
    be given up."""
    model = model_of(name, **changes)
    rng = np.random.default_rng(0)
    u = rng.uniform(0.0, 10.0, model.tendon_count)
    near = ChordSolver(model, static_equilibrium(model, u).q, u)
    neighbour = (1.0 + step) * u
    q, tip = near.at(neighbour)
    searched = static_equilibrium(model, neighbour)
    np.testing.assert_allclose(tip, searched.tip_pose, atol=1e-8)
    tip_pose = model.tip_pose(q)
    np.testing.assert_allclose(tip_pose, tip, atol=1e-12)
    small = 1e-4
    beside = static_equilibrium(model, (1.0 + small) * u, near.q)
    moved = beside.q - near.q
    predicted = small * near.answer @ u
    off = np.linalg.norm(predicted - moved)
    assert off < 1e-2 * np.linalg.norm(moved)


@pytest.mark.parametrize("weight", [0.0, -9.81])
def test_elastic_tendons_pull_by_their_stretch_within_what_drives_hold(weight):
    """T = k (delta - (L_0 - L)), none of a slack tendon, and all of the strength of the third."""
    elasticity = {"stiffness": 800.0, "displacement_limits": [-0.02, 0.05], "strength": 4.0}
    gravity = {"effects__gravity__acceleration": [0.0, 0.0, weight]}
    model = model_of("three_tendon", effects__tendon_elasticity=elasticity, **gravity)
    command = np.array([0.006, -0.012, 0.05])
    found, tension = commanded_equilibrium(model, command)
    assert found.converged
    assert found.reason == ""
    straight = model.tendon_lengths(np.zeros(model.coordinate_count))
    shortening = straight - model.tendon_lengths(found.q)
    pull = 800.0 * (command - shortening)
    assert pull[1] < 0.0
    assert 0.0 < pull[0] < 4.0 < pull[2]
    expected_tension = np.clip(pull, 0.0, 4.0)
    np.testing.assert_allclose(tension, expected_tension, rtol=1e-7)
    assert static_equilibrium(model, tension, found.q).residual <= RESIDUAL
    # Newton's method needs a few tensions, each with a few linearisations of the balance
    assert found.iterations < 30


def test_stability_is_the_part_of_the_stiffness_that_a_push_leaves():
    """1 - P / P_cr of Euler's column, P_cr = pi^2 EI / 4 L^2; the softest mode bends it by an angle
    of 1."""
    modes = [{"strains": ["bend_y", "bend_z"], "order": 4, "span": "rod"}]
    strain = {"type": "explicit", "modes": modes}
    length = 0.3
    bending = 5e5 * np.pi * 0.01**4 / 4
    critical = np.pi**2 * bending / (4.0 * length**2)
    for part in (-0.5, 0.5, 0.95, 1.05):
        push = [-part * critical, 0.0, 0.0]
        model = model_on(
            load_scene("three_tendon").replace({"strain": strain, "effects.tip_load.force": push}),
            6,
        )
        with model.workspace() as work:
            balance = Balance(model, np.zeros(3), work)
            straight = balance.linearise(np.zeros(model.coordinate_count), 1.0)
            stability = straight.stability
            softest = stability.modes[:, 0]
            angle = balance.angle(softest)
        assert stability.has_potential
        assert not stability.flutters
        assert stability.stable == (part < 1.0)
        if part > 0.0:
            assert stability.least == pytest.approx(1.0 - part, abs=2e-3)
        else:
            assert stability.least > 1.0
        assert angle == pytest.approx(1.0, rel=1e-6)
        energy = softest @ model.metric @ softest
        assert bending / length * angle**2 == pytest.approx(energy)
