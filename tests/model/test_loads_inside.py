"""Scenes whose loads are inside of the strain (paper III-B): statics, rest, motion, energy, rows,
control laws; what stays outside."""

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env import StrainLimitError, static_equilibrium

INSIDE = {"strain.include_loads": True}
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
MOMENT = {"effects.tip_load.moment": [0.0, 0.02, 0.01]}
PULL = np.linspace(0.0, 9.0, 10)
HELD_STRAIGHT = {"effects.tip_load.force": [0.5, 0.0, 0.0]}
BENT = np.array([10.0, 0.0, 0.0])
"""[N] that turn the tip against the force that holds the arm straight, until the arm snaps out of
its plane."""


@pytest.mark.parametrize(
    "loaded",
    [slice(0, 3), pytest.param(slice(3, None), marks=pytest.mark.slow)],
    ids=["some", "others"],
)
def test_equilibria_under_loads_agree_with_shooting(loaded, build, reference):
    """With no coordinate beside the tensions, which are the coordinates at rest; at 48 intervals a
    piece."""
    cases = [
        case
        for case in reference("statics")
        if any(case["gravity"]) or any(case["tip_wrench_world"])
    ]
    assert len(cases) == 5
    assert any(any(case["tip_wrench_world"][:3]) for case in cases)
    for case in cases[loaded]:
        changes = {**INSIDE, "quadrature.intervals": 48}
        if any(case["gravity"]):
            changes["effects.gravity.acceleration"] = case["gravity"]
        tip_wrench = np.array(case["tip_wrench_world"])
        moment, force = np.split(tip_wrench, 2)
        if any(case["tip_wrench_world"]):
            changes |= {
                "effects.tip_load.moment": moment.tolist(),
                "effects.tip_load.force": force.tolist(),
            }
        model = build("paper", changes)
        found = static_equilibrium(model, case["tension"])
        assert found.converged
        assert found.stable
        assert found.residual < 1e-14
        np.testing.assert_array_equal(found.q, case["tension"])
        np.testing.assert_allclose(found.tip_pose[:3, 3], case["tip_position"], atol=1e-6)
        np.testing.assert_allclose(found.tip_pose[:3, :3], case["tip_rotation"], atol=2e-6)


@pytest.mark.parametrize("changes", [GRAVITY, MOMENT], ids=["gravity", "moment"])
def test_an_arm_at_rest_stays_there(changes, build):
    model = build("paper_16dof", {**INSIDE, **changes})
    simulation = ste.Simulation(model)
    simulation.reset(model.rest_coordinates(PULL))
    tip = simulation.tip_pose
    simulation.step(PULL, 0.5)
    expected = model.rest_coordinates(PULL)
    np.testing.assert_allclose(simulation.state.q, expected, atol=1e-9)
    np.testing.assert_allclose(simulation.tip_pose, tip, atol=1e-12)


def test_tensions_that_buckle_a_loaded_arm_are_told(build):
    """Where the branch of its strain ends, as far as the equilibria of an arm with the load outside
    and many coordinates go."""
    model = build("three_tendon", {**INSIDE, **HELD_STRAIGHT})
    found = static_equilibrium(model, BENT)
    assert not found.converged
    assert "buckles" in found.reason
    assert found.stable
    # what is not balanced is that of the full load: B u - K = G (u - q)
    lacking = BENT - found.q
    G = model.terms(found.q, np.zeros(3)).stiffness
    energy = model.bending_energy + found.q @ G @ found.q
    missed = lacking @ G @ lacking
    expected = np.sqrt(missed / energy)
    assert found.residual == pytest.approx(expected, rel=1e-6)
    expected_q = found.load * BENT
    np.testing.assert_allclose(found.q, expected_q, atol=1e-6)
    passive = [{"strains": ["torsion", "bend_y", "bend_z"], "order": 5, "span": "rod"}]
    outside = static_equilibrium(
        build("three_tendon", {**HELD_STRAIGHT, "strain.passive": passive}), BENT
    )
    full = static_equilibrium(model, 0.99 * found.load * BENT)
    assert full.converged
    assert full.stable
    assert not outside.converged
    with pytest.raises(
        StrainLimitError,
        match="no strain balances these coordinates and loads beyond .* the arm buckles",
    ):
        model.tip_pose(BENT)


def test_a_motion_into_buckling_ends_with_its_cause(build):
    model = build("three_tendon", {**INSIDE, **HELD_STRAIGHT})
    simulation = ste.Simulation(model)
    with pytest.raises(ste.SimulationDiverged, match="buckles under the loads inside"):
        simulation.step(2.0 * BENT, 20.0)
    assert np.isfinite(simulation.state.q).all()
