"""Targets between instants, the implicit step against its formula and the simulation's, gains by the poles that were asked for."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import soft_tendon_env as ste
from soft_tendon_env.control.dynamics import DECADES, discrete_gains, implicit_inertia, implicit_step
from soft_tendon_env.control.rigid_motions import moved_pose, pose_at, pose_error, value_at

AHEAD = np.array([0.0, 0.02, 0.1])
STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
EXPLICIT = {"strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}]}}
ARMS = {
    "paper": ("paper", {}),
    "passive": ("paper_16dof", GRAVITY),
    "loads inside": ("paper_16dof", {**GRAVITY, "strain.include_loads": True}),
    "explicit": ("three_tendon", {**EXPLICIT, **GRAVITY}),
}
SETTLING_TIMES = [0.05, 0.2, 0.396, 1.0, 5.0]
DAMPINGS = [0.2, 0.7, 1.0, 1.5, 5.0]  # under-, critically and overdamped
PERIODS = [1e-4, 1e-3, 0.02, 0.2]
INTEGRAL_TIMES = [None, 0.1, 0.5, 3.0]


@pytest.fixture(scope="module")
def poses():
    """Three random ones (3, 4, 4), less than a half-turn apart."""
    rng, out = np.random.default_rng(0), np.tile(np.eye(4), (3, 1, 1))
    out[0, :3, :3], out[0, :3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    for i in (1, 2):
        out[i] = moved_pose(out[i - 1], rng.uniform(-1.0, 1.0, 6))
    return out


def test_poses_are_exact_at_their_instants_and_the_last_is_held(poses):
    for time, pose in zip(AHEAD, poses, strict=True):
        for near in (time, time + 1e-12, time - 1e-12):
            np.testing.assert_array_equal(pose_at(AHEAD, poses, near), pose)
    for time in (0.11, 1e3):
        np.testing.assert_array_equal(pose_at(AHEAD, poses, time), poses[-1])
        np.testing.assert_array_equal(pose_at(np.zeros(1), poses[:1], time), poses[0])


@pytest.mark.parametrize("first", [0, 1])
def test_poses_move_along_the_screw_between_instants(poses, first):
    """Evenly: the error from the first grows in proportion to time."""
    start, end = poses[first : first + 2]
    for share in (1e-3, 0.25, 0.5, 0.999):
        found = pose_at(AHEAD, poses, AHEAD[first] + share * (AHEAD[first + 1] - AHEAD[first]))
        np.testing.assert_allclose(pose_error(start, found), share * pose_error(start, end), atol=1e-12)


def test_values_are_linear_between_instants_and_held_beyond():
    values = np.array([[0.0, 5.0], [1.0, 3.0], [-3.0, 3.0]])
    for time, value in zip(AHEAD, values, strict=True):
        np.testing.assert_array_equal(value_at(AHEAD, values, time), value)
    np.testing.assert_allclose(value_at(AHEAD, values, 0.015), 0.25 * values[0] + 0.75 * values[1], atol=1e-15)
    np.testing.assert_allclose(value_at(AHEAD, values, 0.04), 0.75 * values[1] + 0.25 * values[2], atol=1e-15)
    np.testing.assert_array_equal(value_at(AHEAD, values, 7.0), values[-1])
    np.testing.assert_array_equal(value_at(np.zeros(1), values[:1], 0.3), values[0])


@pytest.fixture(params=ARMS)
def arm(request, build):
    """arm(period): the model whose simulation takes one linearly implicit Euler step of this length."""
    name, changes = ARMS[request.param]
    return lambda period: build(name, {**changes, "integrator.columns": 1, "integrator.step": period})


@pytest.mark.parametrize("period", [0.002, 0.02])
def test_the_step_is_the_formula(arm, random_state, period):
    model = arm(period)
    q, q_dot = random_state(model, 0)
    terms = model.terms(q, q_dot)
    step = implicit_step(terms, q_dot, period)
    S = terms.mass + period * terms.damping + period**2 * terms.stiffness
    force = terms.external_force - terms.elastic_force - terms.bias - terms.damping @ q_dot - period * terms.stiffness @ q_dot
    np.testing.assert_allclose(implicit_inertia(terms, period), S, rtol=1e-12)
    np.testing.assert_allclose(step.metric, step.response.T @ S @ step.response, rtol=1e-9, atol=1e-12 * np.abs(step.metric).max())
    np.testing.assert_allclose(step.free, q_dot + np.linalg.solve(S, period * force), rtol=1e-7, atol=1e-9 * np.abs(q_dot).max())
    np.testing.assert_allclose(S @ step.response, period * terms.actuation, atol=1e-10 * np.abs(period * terms.actuation).max())


@pytest.mark.parametrize("period", [0.002, 0.01])
def test_the_step_is_the_simulation_s(arm, random_state, period):
    """Whatever the tensions; those of explicit strains stiffen the arm, which their terms are told."""
    model = arm(period)
    q, q_dot = random_state(model, 1)
    simulation = ste.Simulation(model)
    for seed in range(3):
        tension = np.random.default_rng(seed).uniform(0.0, 2.0, model.tendon_count)
        step = implicit_step(model.terms(q, q_dot, tension), q_dot, period)
        rates = step.free + step.response @ tension
        simulation.reset(q, q_dot)
        assert simulation.step(tension, period).steps == 1
        np.testing.assert_allclose(simulation.state.q_dot, rates, atol=1e-6 * np.abs(rates).max())
        np.testing.assert_allclose(simulation.state.q, q + period * rates, atol=1e-6 * np.abs(q).max())
        assert np.abs(rates - q_dot).max() > 0.1 * np.abs(q_dot).max()  # much has happened in it


def test_a_singular_step_is_an_error(build):
    model = build("three_tendon")
    terms = model.terms(np.zeros(3), np.zeros(3))._replace(mass=np.zeros((3, 3)), damping=np.zeros((3, 3)), stiffness=np.zeros((3, 3)))
    with pytest.raises(np.linalg.LinAlgError):
        implicit_step(terms, np.zeros(3), 0.02)


def continuous_poles(settling_time, damping, integral_time=None):
    """Two of damping ratio zeta, the slowest at -4 / settling_time, and that of the integral."""
    pair = np.roots([1.0, 2.0 * damping, 1.0])
    pair = pair / -pair.real.max() * DECADES / settling_time
    return pair if integral_time is None else np.append(pair, -DECADES / integral_time)


def loop(gains, period, integral):
    """The documented loop as a matrix for (e_dot, e, i), or (e_dot, e)."""
    kp, kd, ki = gains
    rate = np.array([1.0 - period * kd, -period * kp, -period * ki])
    error = np.array([0.0, 1.0, 0.0]) + period * rate
    total = np.array([0.0, 0.0, 1.0]) + period * error
    size = 3 if integral else 2
    return np.stack([rate, error, total])[:size, :size]


def characteristic(matrix):
    """Coefficients of its characteristic polynomial, by traces and determinants: exact also where eigenvalues coincide."""
    if len(matrix) == 2:
        return np.array([-np.trace(matrix), np.linalg.det(matrix)])
    return np.array([-np.trace(matrix), 0.5 * (np.trace(matrix) ** 2 - np.trace(matrix @ matrix)), -np.linalg.det(matrix)])


@pytest.mark.cases("period", PERIODS)
@pytest.mark.cases("integral_time", INTEGRAL_TIMES)
def test_the_loop_has_the_poles_of_the_continuous_one(period, integral_time):
    """Compared as polynomials in (z - 1) / period, which stay well conditioned at short periods and double poles."""
    for settling_time, damping in itertools.product(SETTLING_TIMES, DAMPINGS):
        matrix = loop(discrete_gains(settling_time, damping, period, integral_time), period, integral_time is not None)
        found = characteristic((matrix - np.eye(len(matrix))) / period)
        wanted = np.poly(np.expm1(continuous_poles(settling_time, damping, integral_time) * period) / period)[1:]
        np.testing.assert_allclose(found, wanted.real, rtol=1e-6)
        slowest = np.exp(-DECADES / max(settling_time, integral_time or 0.0) * period)
        assert np.abs(np.linalg.eigvals(matrix)).max() == pytest.approx(slowest, rel=1e-4, abs=1e-6) and np.exp(-DECADES) < 0.02


@pytest.mark.cases("name", ["settling_time", "damping", "period", "integral_time"])
@pytest.mark.cases("value", [0.0, -1.0, np.nan, np.inf, "short"])
def test_what_is_no_positive_number_is_named(name, value):
    with pytest.raises((TypeError, ValueError), match=f"{name} should be a positive number"):
        discrete_gains(**{"settling_time": 0.5, "damping": 1.0, "period": 0.02, "integral_time": 0.5, name: value})
