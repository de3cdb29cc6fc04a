"""Scenes with a learned strain under dead loads: rest, motion, energy, rows, what is told outside of what was learned."""

import warnings

import numpy as np
import pytest

import soft_tendon_env as ste
from soft_tendon_env.envs.arms import Arms, Material
from soft_tendon_env.mechanics.types import Learned
from soft_tendon_env.model.statics import static_equilibrium, static_stiffness
from soft_tendon_env.scene.artifacts.learned_strain import LearnedStrainWarning

GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
PULL = np.array([1.0, 0.5, 2.0])


@pytest.fixture
def arm(untrained, build):
    """arm(changes): the three-tendon arm under gravity with a learned strain of random weights: sound, and far from accurate."""
    return lambda changes=None, name="three_tendon": build(name, {**untrained(name, GRAVITY)[1], **(changes or {})})


def test_it_rests_where_its_forces_balance(arm):
    """As any model does, found from the unloaded arm and from a guess alike; how far that is from the exact strain is told."""
    model = arm()
    assert isinstance(model.arm.strain, Learned) and not model.arm.effects
    found = static_equilibrium(model, PULL)
    assert found.converged and found.stable and found.residual < 1e-9
    terms = model.terms(found.q, np.zeros(3))
    assert np.abs(terms.actuation @ PULL - terms.elastic_force).max() < 1e-9 * np.abs(terms.elastic_force).max()
    beside = static_equilibrium(model, PULL, model.rest_coordinates(PULL))
    np.testing.assert_allclose(beside.q, found.q, atol=1e-7 * np.abs(found.q).max())
    exact = ste.build_model(model.scene.replace({"strain.include_loads": True, "quadrature.intervals": model.grid.per_piece}))
    apart = np.linalg.norm(exact.tip_pose(PULL)[:3, 3] - found.tip_pose[:3, 3])
    assert found.tip_error == pytest.approx(apart, rel=1e-9) and apart > 1e-3


def test_equilibrium_stiffness_is_symmetric(arm):
    """The second derivative of an energy."""
    model = arm()
    found = static_equilibrium(model, PULL)
    S = static_stiffness(model, found.q, PULL)
    np.testing.assert_allclose(S, S.T, atol=1e-5 * np.abs(S).max())
    assert np.linalg.eigvalsh(0.5 * (S + S.T))[0] > 0.0


def test_an_arm_at_rest_stays_there(arm):
    model = arm()
    rest = static_equilibrium(model, PULL)
    simulation = ste.Simulation(model)
    simulation.reset(rest.q)
    simulation.step(PULL, 0.5)
    np.testing.assert_allclose(simulation.tip_pose, rest.tip_pose, atol=1e-9)


def test_a_released_arm_loses_energy_and_comes_to_rest(arm):
    model = arm({"integrator.step": 0.005})
    simulation = ste.Simulation(model)
    simulation.reset(static_equilibrium(model, PULL).q)
    trajectory = ste.simulate(model, np.zeros(3), 3.0, 0.02, initial=simulation.state)
    energy = [model.energy(q, q_dot).total for q, q_dot in zip(trajectory.q, trajectory.q_dot, strict=True)]
    assert (np.diff(energy) < 1e-6 * np.ptp(energy)).all()
    rest = static_equilibrium(model, np.zeros(3))
    assert energy[-1] == pytest.approx(model.energy(rest.q, np.zeros(3)).total, abs=0.02 * np.ptp(energy))


def test_shorter_steps_converge(arm):
    """By more than the first order; G is without the stiffness of the loads, as where they are outside of the strain."""
    tips = []
    for step in (0.01, 0.005, 0.0025, 0.000625):
        model = arm({"integrator.step": step, "integrator.columns": 2})
        tips.append(ste.simulate(model, PULL, 0.2, 0.2).tip_pose[-1, :3, 3])
    errors = np.linalg.norm(np.array(tips[:-1]) - tips[-1], axis=1)
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0] > 1.5


def test_a_saved_state_goes_on_bit_for_bit(arm):
    model = arm()
    whole = ste.simulate(model, PULL, 0.4, 0.02)
    half = ste.simulate(model, PULL, 0.2, 0.02)
    np.testing.assert_array_equal(ste.simulate(model, PULL, 0.2, 0.02, half.final).q[-1], whole.q[-1])


def test_rows_move_as_one_arm_does(arm):
    model = arm()
    arms = Arms(model, 2, 0.02, np.zeros(0), np.zeros(0))
    members, tension = np.arange(2), np.stack([PULL, 0.3 * PULL])
    for _ in range(10):
        arms.step(np.repeat(tension[:, None], arms.substeps, axis=1), members)
    for row in members:
        simulation = ste.Simulation(model)
        for _ in range(10):
            simulation.step(tension[row], 0.02)
        np.testing.assert_array_equal(arms.rows.q[row], simulation.state.q)


@pytest.mark.parametrize(("changes", "material"), [
    ({"segments.0.density": 2140.0}, {"density": 2.0}),
    ({"effects.tip_load.mass": 0.02}, {"payload": 0.02}),
    ({"segments.0.young_modulus": 6e5, "segments.0.damping": 8e3}, {"stiffness": 1.2}),
])  # fmt: skip
def test_a_row_of_another_material_has_its_own_forces_and_is_warned_of(changes, material, arm):
    intervals = {"quadrature.intervals": 8}
    arms = Arms(arm(intervals), 2, 0.02, np.zeros(0), np.zeros(0))
    with pytest.warns(LearnedStrainWarning, match="another material or payload"):
        arms.set_material(1, Material(**material))
    with pytest.warns(LearnedStrainWarning, match="was made for"):
        own = arm({**intervals, **changes})
    found = static_equilibrium(own, PULL, settle=True)
    assert found.converged
    np.testing.assert_allclose(static_equilibrium(arms.model_of(1), PULL, settle=True).q, found.q, atol=1e-8)


def test_motions_out_of_range_are_warned_of(arm):
    simulation = ste.Simulation(arm())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation.step(PULL, 0.2)
    with pytest.warns(LearnedStrainWarning, match="coordinate 0 at .* N, outside of -4 to 6 N"):
        simulation.step([12.0, 0.0, 0.0], 0.5)
    arms = Arms(arm(), 2, 0.02, np.zeros(0), np.zeros(0))
    with pytest.warns(LearnedStrainWarning, match="outside of"):
        for _ in range(20):
            arms.step(np.full((2, arms.substeps, 3), 12.0), np.arange(2))
