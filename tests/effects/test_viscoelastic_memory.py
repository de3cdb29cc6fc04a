"""Viscoelastic memory: relaxation, creep and oscillation of the standard linear solid, its energy, and its state."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from soft_tendon_env.mechanics.terms.external_forces import external_force, remember
from soft_tendon_env.model.simulation import Simulation, simulate

ONE = {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}]}
TWO = {"effects.viscoelastic_memory.branches": [{"modulus": 0.5, "relaxation_time": 0.1}, {"modulus": 2.0, "relaxation_time": 0.01}]}


@pytest.mark.no_jit
@pytest.mark.parametrize("step", [0.001, 0.02, 0.5])
def test_stress_relaxes_under_a_strain_that_is_held(uniform, workspace_at, step):
    """sum_k m_k exp(-t / tau_k) of the elastic force at once, whatever the steps."""
    model, q = uniform(changes={**TWO, "quadrature.intervals": 4}), np.array([3.0, -1.0])
    work = workspace_at(model, q)
    elastic = model.terms(q, 0 * q).elastic_force
    work.before[:], work.since[0] = work.xi, step
    for i in range(1, 4):
        external_force(model.arm, work)
        left = 0.5 * np.exp(-i * step / 0.1) + 2.0 * np.exp(-i * step / 0.01)
        np.testing.assert_allclose(work.load, -left * elastic, rtol=1e-9, atol=1e-14)


@pytest.mark.no_jit
def test_state_follows_a_strain_that_is_a_quadratic_of_time_exactly(uniform, workspace_at):
    """s = a (t - tau (1 - exp(-t / tau))) + b (t^2 - 2 tau t + 2 tau^2 (1 - exp(-t / tau))) for e = a t + b t^2, in one step or in many."""
    model, unit = uniform(changes={**ONE, "quadrature.intervals": 4}), np.array([2.0, 0.0])
    a, b, tau, end = 1.0, 3.0, 0.1, 0.3
    for steps in (1, 7):
        before, state = workspace_at(model, 0.0 * unit).xi, np.zeros(model.arm.effects.state.size)
        for i in range(steps):
            time = end * (i + 1) / steps
            work = workspace_at(model, (a * time + b * time**2) * unit, (a + 2.0 * b * time) * unit)
            work.state[:], work.before[:], work.since[0] = state, before, end / steps
            remember(model.arm, work)
            before, state = work.xi, work.state.copy()
        settled = 1.0 - np.exp(-end / tau)
        expected = a * (end - tau * settled) + b * (end**2 - 2.0 * tau * end + 2.0 * tau**2 * settled)
        np.testing.assert_allclose(state.max(), 2.0 * expected, rtol=1e-11)


@pytest.mark.parametrize("branches", [ONE, TWO])
def test_motion_is_that_of_the_differential_equations(uniform, branches):
    """One coordinate with s_k_dot = (q - s_k) / tau_k, solved by an independent method."""
    model, plain = (uniform(("bend_z",), 0, {**more, "integrator.step": 1e-3, "integrator.columns": 4}) for more in (branches, {}))
    own = branches["effects.viscoelastic_memory.branches"]
    modulus, time = np.array([[branch["modulus"], branch["relaxation_time"]] for branch in own]).T

    def rate(_, y):
        terms = plain.terms(y[:1], y[1:2])
        K = terms.elastic_force / y[0] if y[0] else terms.stiffness[0]
        force = -terms.bias - terms.damping @ y[1:2] - terms.elastic_force - modulus @ (y[0] - y[2:]) * K
        return np.concatenate([y[1:2], np.linalg.solve(terms.mass, force), (y[0] - y[2:]) / time])

    motion = simulate(model, np.zeros(3), 0.5, 0.05, initial=Simulation(model).reset([4.0], [20.0]))
    exact = solve_ivp(rate, (0.0, 0.5), [4.0, 20.0, *[4.0] * modulus.size], t_eval=motion.time, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(motion.q[:, 0], exact.y[0], atol=1e-6 * 4.0)
    np.testing.assert_allclose(motion.final.effects.reshape(modulus.size, -1).max(axis=1), np.maximum(exact.y[2:, -1], 0.0), atol=1e-5)


@pytest.mark.parametrize("time", [1e-3, 1e-4, 1e-6])
def test_a_branch_far_faster_than_the_step_is_a_damper(uniform, time):
    """Of viscosity m tau Sigma: here that of the segment, 3 eta I against m tau E I; also in steps of 20 ms."""
    eta, slow = 8e3, {"segments.0.damping": 0.0, "integrator.columns": 3}
    fast = {"effects.viscoelastic_memory.branches": [{"modulus": 3 * eta / 5e5 / time, "relaxation_time": time}]}
    models = [uniform(("bend_z",), 0, changes) for changes in ({**slow, **fast}, {"segments.0.damping": eta})]
    branch, damper = (simulate(own, np.zeros(3), 1.0, 0.02, initial=Simulation(own).reset([4.0])).q for own in models)
    np.testing.assert_allclose(branch, damper, atol=(1e-3 + 5.0 * time) * 4.0)


def test_a_state_of_another_size_is_refused(uniform):
    model = uniform(changes=ONE)
    with pytest.raises(ValueError, match=r"effects should have shape"):
        model.energy([0.0, 0.0], [0.0, 0.0], np.zeros(3))
