"""Stiffening and remembering materials, against the laws themselves."""

import numpy as np
import pytest
from scipy.integrate import quad

from soft_tendon_env.effects.material import lag_weights
from soft_tendon_env.mechanics.terms.external_forces import add_implicit, external_force, remember
from soft_tendon_env.model.statics import static_equilibrium

RADIUS = 0.01  # [m]
YOUNG = 5e5  # [Pa]
SHEAR = 5e5 / 3  # shear modulus [Pa]
AREA = np.pi * RADIUS**2  # [m^2]
INERTIA = np.pi * RADIUS**4 / 4  # second moment of area [m^4]
ALL = ("torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z")
LAW = {
    "effects.nonlinear_elasticity": {"torsion": 6.0, "bending": 4.0, "stretch": 0.1, "shear": 0.2}
}
ONE = {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}]}
TWO = {
    "effects.viscoelastic_memory.branches": [
        {"modulus": 0.5, "relaxation_time": 0.1},
        {"modulus": 2.0, "relaxation_time": 0.01},
    ]
}


@pytest.mark.no_jit
@pytest.mark.parametrize("curvature", [0.5, 4.0, 12.0])
def test_uniform_bending(uniform, curvature):
    """M = E I k (1 + (k / k0)^2), under a moment that follows the tip."""
    moment = (
        YOUNG * INERTIA * curvature * (1.0 + (curvature / 4.0) ** 2)
    )  # of the law at this strain
    load = {
        "effects.tip_load": {"moment": [0.0, 0.0, moment], "frame": "tip"},
        "quadrature.intervals": 4,
    }
    found = static_equilibrium(
        uniform(("bend_z", "stretch", "shear_y"), 0, {**LAW, **load}), np.zeros(3)
    )
    assert found.converged
    np.testing.assert_allclose(found.q, [curvature, 0.0, 0.0], rtol=1e-9, atol=1e-9)


@pytest.mark.no_jit
def test_force_is_the_gradient_of_the_energy_and_stiffness_its_derivative(
    uniform, workspace_at, slope
):
    model = uniform(ALL, 1, {**LAW, "quadrature.intervals": 4})
    q = 0.3 * np.array([5, 3, 4, -2, 3, 1, 0.1, 0.05, -0.1, 0.1, 0.1, 0.05])
    force = model.terms(q, 0 * q).external_force
    gradient = slope(lambda at: model.energy(at, 0 * at).load, q, 1e-5)
    largest_force = np.abs(force).max()
    np.testing.assert_allclose(force, -gradient, rtol=1e-6, atol=1e-8 * largest_force)
    work = workspace_at(model, q)
    G = work.matrices.G.copy()
    add_implicit(model.arm, work)
    expected = -slope(lambda at: model.terms(at, 0 * at).external_force, q, 1e-5)
    np.testing.assert_allclose(
        work.matrices.G - G, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max()
    )


@pytest.mark.no_jit
@pytest.mark.parametrize("step", [0.001, 0.02, 0.5])
def test_stress_relaxes_under_a_strain_that_is_held(uniform, workspace_at, step):
    """sum_k m_k exp(-t / tau_k) of the elastic force at once, whatever the steps."""
    model = uniform(changes={**TWO, "quadrature.intervals": 4})
    q = np.array([3.0, -1.0])
    work = workspace_at(model, q)
    elastic = model.terms(q, 0 * q).elastic_force
    work.inputs.before[:] = work.strain.xi
    work.inputs.since[0] = step
    for i in range(1, 4):
        external_force(model.arm, work)
        time = i * step
        left = 0.5 * np.exp(-time / 0.1) + 2.0 * np.exp(-time / 0.01)
        expected_load = -left * elastic
        np.testing.assert_allclose(work.forces.load, expected_load, rtol=1e-9, atol=1e-14)


@pytest.mark.no_jit
def test_state_follows_a_strain_that_is_a_quadratic_of_time_exactly(uniform, workspace_at):
    """s = a (t - tau (1 - exp(-t / tau))) + b (t^2 - 2 tau t + 2 tau^2 (1 - exp(-t / tau))) for e =
    a t + b t^2, in one step or in many."""
    model = uniform(changes={**ONE, "quadrature.intervals": 4})
    unit = np.array([2.0, 0.0])
    a = 1.0
    b = 3.0
    tau = 0.1
    end = 0.3
    for steps in (1, 7):
        before = workspace_at(model, 0.0 * unit).strain.xi
        state = np.zeros(model.arm.effects.state.size)
        for i in range(steps):
            time = end * (i + 1) / steps
            work = workspace_at(model, (a * time + b * time**2) * unit, (a + 2.0 * b * time) * unit)
            inputs = work.inputs
            inputs.state[:] = state
            inputs.before[:] = before
            inputs.since[0] = end / steps
            remember(model.arm, inputs, work.strain, work.loads)
            before = work.strain.xi
            state = inputs.state.copy()
        settled = 1.0 - np.exp(-end / tau)
        expected = a * (end - tau * settled) + b * (
            end**2 - 2.0 * tau * end + 2.0 * tau**2 * settled
        )
        np.testing.assert_allclose(state.max(), 2.0 * expected, rtol=1e-11)


@pytest.mark.no_jit
@pytest.mark.parametrize("x", [0.0, 1e-5, 0.999e-3, 1.001e-3, 0.3, 5.0, 50.0])
def test_lags_after_a_time_are_integrals(x):
    """Of s_dot = (e - s) / tau, for a strain that changes by a + b t in x relaxation times: with e
    = a t + b t^2 / 2 the lag is what exponentials leave of each rate."""
    kept, changed, rated = lag_weights(x)
    expected_kept = np.exp(-x)
    assert kept == pytest.approx(expected_kept)
    a = 1.3
    b = -0.7
    left, _ = quad(lambda t: (a + b * t) * np.exp(t - x), 0.0, x, epsabs=1e-14)
    change = a * x + 0.5 * b * x**2
    rate = a + b * x
    assert changed * change + rated * x * rate == pytest.approx(left, rel=1e-6, abs=1e-12)
    assert lag_weights(np.inf) == (0.0, 0.0, 0.0)


@pytest.mark.no_jit
def test_springs_of_the_branches_store_their_share_of_the_elastic_energy(uniform):
    """m_k of it where all dampers stand still, less where they have followed."""
    model = uniform(changes={**TWO, "quadrature.intervals": 4})
    q = np.array([3.0, -1.0])
    states = np.zeros(model.arm.effects.state.size)
    energy = model.energy(q, 0 * q, states)
    assert energy.load == pytest.approx(2.5 * energy.elastic)
    first, second = np.split(states, 2)
    strain = model.packed_strain(q) - model.arm.rod.reference_strain
    first[:] = 0.5 * strain
    second[:] = strain
    followed = model.energy(q, 0 * q, states)
    expected_load = 0.5 * 0.25 * energy.elastic
    assert followed.load == pytest.approx(expected_load)
    at_rest = model.energy(q, 0 * q)
    assert at_rest.load == pytest.approx(0.0, abs=1e-15)
