"""Fluid: drag, added mass and buoyancy against closed forms, and the powers that they take and give."""

import numpy as np
import pytest

from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.external_forces import add_implicit
from soft_tendon_env.model.grid import discretisation
from soft_tendon_env.model.simulation import Simulation, simulate
from soft_tendon_env.model.statics import static_equilibrium

LENGTH, RADIUS, YOUNG, DENSITY = 0.3, 0.01, 5e5, 1070.0
AREA, INERTIA = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
WATER = {"effects.fluid": {"density": 1000.0}}
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
NO_DRAG = {"effects.fluid.normal_drag": 0.0, "effects.fluid.tangential_drag": 0.0}


@pytest.mark.no_jit
def test_deflection_in_a_cross_stream(uniform):
    """A uniform load w = 1/2 rho C_n 2 r U^2 bends a cantilever by w L^4 / (8 E I) at the tip."""
    speed = 0.01
    model = uniform(("bend_y", "bend_z"), 2, {"effects.fluid": {"density": 1000.0, "current": [0.0, 0.0, speed], "normal_drag": 1.2}})
    tip = static_equilibrium(model, np.zeros(3)).tip_pose[:3, 3]
    load = 0.5 * 1000.0 * 1.2 * 2 * RADIUS * speed**2
    np.testing.assert_allclose(tip[2], load * LENGTH**4 / (8 * YOUNG * INERTIA), rtol=2e-3)
    assert abs(tip[1]) < 1e-12


def test_stretch_in_a_stream_along_the_rod(uniform):
    """A uniform load t = 1/2 rho C_t 2 pi r U^2 stretches it by t L^2 / (2 E A)."""
    changes = {"effects.fluid": {"density": 1000.0, "current": [2.0, 0.0, 0.0], "tangential_drag": 0.02}}
    tip = static_equilibrium(uniform(("stretch",), 1, changes), np.zeros(3)).tip_pose[:3, 3]
    load = 0.5 * 1000.0 * 0.02 * 2 * np.pi * RADIUS * 2.0**2
    np.testing.assert_allclose(tip[0] - LENGTH, load * LENGTH**2 / (2 * YOUNG * AREA), rtol=1e-3)


def test_terminal_velocity(uniform):
    """An arm with next to no stiffness, curled by a moment at its tip, comes to the speed at which drag balances it.

    One coordinate, a curvature k: v = k_dot x^2 / 2 for small k. The moment's work per k is M L, the drag's
    1/2 rho C_n 2 r int (k_dot x^2 / 2)^2 (x^2 / 2) dx = 1/2 rho C_n 2 r k_dot^2 L^7 / 56.
    """
    moment, drag = 1e-4, 1000.0
    changes = {
        "segments.0.young_modulus": 1e-3,
        "segments.0.damping": 0.0,
        "integrator.columns": 3,
        "effects.fluid": {"density": 1000.0, "normal_drag": drag, "tangential_drag": 0.0},
        "effects.tip_load": {"moment": [0.0, moment, 0.0], "frame": "tip"},
    }
    model = uniform(("bend_y",), 0, changes)
    simulation = Simulation(model)
    simulation.step(np.zeros(3), 4.0)
    per_speed = 0.5 * 1000.0 * drag * 2 * RADIUS
    assert abs(simulation.state.q[0] * LENGTH) < 0.1, "or v is not k_dot x^2 / 2"
    np.testing.assert_allclose(simulation.state.q_dot[0], np.sqrt(moment * LENGTH / (per_speed * LENGTH**7 / 56)), rtol=5e-3)


def test_a_neutrally_buoyant_arm_stays_straight(build):
    passive = [{"strains": ["bend_y", "bend_z"], "order": 2, "span": "rod"}]
    changes = {**GRAVITY, "effects.fluid.density": DENSITY, "strain.passive": passive}
    tip = static_equilibrium(build("three_tendon", changes), np.zeros(3)).tip_pose
    np.testing.assert_allclose(tip[:3, 3], [LENGTH, 0.0, 0.0], atol=1e-12)
    sunk = static_equilibrium(build("three_tendon", {**changes, "effects.fluid.density": 1000.0}), np.zeros(3)).tip_pose
    assert sunk[2, 3] < -1e-3, "or nothing was to be balanced"


@pytest.mark.parametrize("density", [500.0, 1070.0, 3000.0])
def test_buoyancy_is_weight_of_the_displaced_fluid(build, density):
    """Of a tapered arm as well: as gravity times 1 - rho_fluid / rho, to round-off."""
    q = np.linspace(0.0, 4.0, 10)
    wet = build("paper", {**GRAVITY, "effects.fluid.density": density}).terms(q, 0 * q).external_force
    lighter = {"effects.gravity.acceleration": [0.0, 0.0, -9.81 * (1.0 - density / 100.0)]}
    expected = build("paper", lighter).terms(q, 0 * q).external_force
    np.testing.assert_allclose(wet, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    assert not build("paper", {"effects.fluid.density": density}).terms(q, 0 * q).external_force.any(), "no gravity, no buoyancy"


@pytest.mark.parametrize("coefficient", [0.0, 1.0, 0.6])
def test_frequency_of_a_cantilever(uniform, coefficient):
    """omega = 1.8751^2 sqrt(E I / ((rho + C_a rho_fluid) A L^4)), of a slender rod."""
    thin = {"segments.0.radius": 0.002, **{f"tendons.{i}.routing.offset": [1e-3 * i, 0.0] for i in range(3)}}
    model = uniform(("bend_z",), 4, {**thin, "effects.fluid": {"density": 1000.0, "added_mass": coefficient}})
    n = model.coordinate_count
    terms = model.terms(np.zeros(n), np.zeros(n))
    lowest = np.sqrt(np.linalg.eigvals(np.linalg.solve(terms.mass, terms.stiffness)).real.min())
    area, inertia = np.pi * 0.002**2, np.pi * 0.002**4 / 4
    expected = 1.8751040687**2 * np.sqrt(YOUNG * inertia / ((DENSITY + coefficient * 1000.0) * area * LENGTH**4))
    np.testing.assert_allclose(lowest, expected, rtol=5e-4)


def test_energy_falls_by_what_drag_and_damping_take(uniform):
    """An arm that is let go under water, under gravity: -dE/dt = q_dot D q_dot - q_dot F_drag, and E never grows."""
    model = uniform(("bend_y", "bend_z"), 1, {**GRAVITY, **WATER, "segments.0.damping": 100.0, "integrator.step": 1e-3})
    dry = uniform(("bend_y", "bend_z"), 1, {**GRAVITY, "segments.0.damping": 100.0})
    weight = 1.0 - 1000.0 / DENSITY
    start = Simulation(model).reset([4.0, 0.0, -3.0, 1.0])
    motion = simulate(model, np.zeros(3), 1.0, 2e-3, initial=start)
    energy = np.array([model.energy(q, v).total for q, v in zip(motion.q, motion.q_dot, strict=True)])
    power = []
    for q, v in zip(motion.q, motion.q_dot, strict=True):
        terms = model.terms(q, v)
        drag = terms.external_force - weight * dry.terms(q, v).external_force
        power.append(v @ drag - v @ terms.damping @ v)
    taken = np.concatenate([[0.0], np.cumsum(0.5 * (np.array(power)[1:] + power[:-1]) * 2e-3)])
    np.testing.assert_allclose(energy - energy[0], taken, atol=2e-3 * np.ptp(energy))
    assert np.diff(energy).max() < 1e-9 * np.ptp(energy)


def test_energy_never_grows_in_still_fluid_at_long_steps(build):
    model = build("three_tendon", {**GRAVITY, **WATER})
    start = Simulation(model).reset([4.0, 0.0, 1.0])
    motion = simulate(model, np.zeros(3), 3.0, 0.02, initial=start)
    energy = np.array([model.energy(q, v).total for q, v in zip(motion.q, motion.q_dot, strict=True)])
    assert np.diff(energy).max() < 1e-6 * np.ptp(energy)


@pytest.mark.no_jit
def test_added_mass_in_a_current_follows_from_the_energy_of_the_relative_motion(uniform, workspace_at, slope):
    """Lagrange's equations of 1/2 s A s - 1/2 v A v = -v A U + 1/2 U A U, with U the current in the frame of the slice, by differences."""
    current = np.array([0.3, -0.2, 0.5])
    fluid = {"effects.fluid": {"density": 1000.0, "current": current.tolist()}, **NO_DRAG, "quadrature.intervals": 4}
    model = uniform(("torsion", "bend_y", "bend_z", "stretch"), 0, fluid)
    n, added = 4, model.scene.effects.fluid
    q, v = np.array([1.0, 2.0, -3.0, 0.05]), np.array([2.0, 5.0, 3.0, 0.4])
    mass = added.displaced_mass(discretisation(model.scene, model.grid))[:, 0]

    def parts(q):
        work = workspace_at(model, q)
        pose = np.moveaxis(work.pose.reshape(-1, 12, LANES), 1, 2).reshape(-1, 12)
        J = np.moveaxis(work.J.reshape(n, -1, 6, LANES), 2, 3).reshape(n, -1, 6)[..., 3:]
        U = np.einsum("iab,a->ib", pose[:, :9].reshape(-1, 3, 3), current) * [0.0, 1.0, 1.0]
        return np.append(-np.einsum("i,nia,ia->n", mass, J, U), 0.5 * np.einsum("i,ia,ia->", mass, U, U))

    gradient = slope(parts, q, 1e-5)
    momentum, potential = gradient[:n], gradient[n]
    expected = -(momentum @ v - v @ momentum - potential)
    found = model.terms(q, v).external_force
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_an_arm_in_a_current_is_at_rest_where_drag_and_stiffness_balance(build):
    """A stream from the side bends the arm downstream, at rest, and it stays there."""
    model = build("three_tendon", {**WATER, "effects.fluid.current": [0.0, 0.1, 0.0]})
    rest = static_equilibrium(model, np.zeros(3))
    assert rest.converged and rest.tip_pose[1, 3] > 1e-3
    motion = simulate(model, np.zeros(3), 10.0, 0.02)
    np.testing.assert_allclose(motion.tip_pose[-1], rest.tip_pose, atol=1e-6)


@pytest.mark.no_jit
def test_damping_is_the_derivative_of_the_drag(uniform, workspace_at, slope):
    """-dF/dq_dot = J^T (node damping) J, symmetric and not negative; without the added mass, whose share is no damping."""
    changes = {"effects.fluid": {"density": 1000.0, "current": [0.2, -0.1, 0.3], "added_mass": 0.0}, "quadrature.intervals": 4}
    model = uniform(("torsion", "bend_y", "bend_z", "stretch"), 0, changes)
    q, v = np.array([1.0, 2.0, -3.0, 0.05]), np.array([2.0, 5.0, 3.0, 0.4])
    work = workspace_at(model, q, v)
    D = work.D.copy()
    add_implicit(model.arm, work)
    found = work.D - D
    expected = -slope(lambda rates: model.terms(q, rates).external_force, v, 1e-5)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8 * np.abs(expected).max())
    assert np.linalg.eigvalsh(found).min() > -1e-12 * np.abs(found).max()


def test_potential_energy(build, slope):
    """Its gradient is the force on the arm at rest."""
    model, q = build("paper", {**GRAVITY, "effects.fluid.density": 300.0}), np.linspace(0.0, 4.0, 10)
    gradient = slope(lambda at: model.energy(at, 0 * at).load, q, 1e-4)
    np.testing.assert_allclose(-gradient, model.terms(q, 0 * q).external_force, rtol=1e-6, atol=1e-9)
