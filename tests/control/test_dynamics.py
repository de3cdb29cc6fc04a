"""The implicit step against its formula, gains by the poles that were asked for, the quadratic
program against another solver."""

import itertools

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from soft_tendon_env.control.allocation import allocate
from soft_tendon_env.control.dynamics import (
    DECADES,
    discrete_gains,
    implicit_inertia,
    implicit_step,
)

STRAINS = ["torsion", "bend_y", "bend_z", "stretch", "shear_y", "shear_z"]
GRAVITY = {"effects.gravity.acceleration": [0.0, 0.0, -9.81]}
EXPLICIT = {
    "strain": {"type": "explicit", "modes": [{"strains": STRAINS, "order": 1, "span": "rod"}]}
}
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


@pytest.mark.parametrize("period", [0.002, 0.02])
@pytest.mark.parametrize("arm", ARMS)
def test_the_step_is_the_formula(build, random_state, arm, period):
    """Of a model whose simulation takes one linearly implicit Euler step a period."""
    name, changes = ARMS[arm]
    model = build(name, {**changes, "integrator.columns": 1, "integrator.step": period})
    q, q_dot = random_state(model, 0)
    terms = model.terms(q, q_dot)
    step = implicit_step(terms, q_dot, period)
    S = terms.mass + period * terms.damping + period**2 * terms.stiffness
    force = (
        terms.external_force
        - terms.elastic_force
        - terms.bias
        - terms.damping @ q_dot
        - period * terms.stiffness @ q_dot
    )
    np.testing.assert_allclose(implicit_inertia(terms, period), S, rtol=1e-12)
    np.testing.assert_allclose(
        step.metric,
        step.response.T @ S @ step.response,
        rtol=1e-9,
        atol=1e-12 * np.abs(step.metric).max(),
    )
    np.testing.assert_allclose(
        step.free,
        q_dot + np.linalg.solve(S, period * force),
        rtol=1e-7,
        atol=1e-9 * np.abs(q_dot).max(),
    )
    np.testing.assert_allclose(
        S @ step.response,
        period * terms.actuation,
        atol=1e-10 * np.abs(period * terms.actuation).max(),
    )


def loop(gains, period, integral):
    """The documented loop as a matrix for (e_dot, e, i), or (e_dot, e)."""
    kp, kd, ki = gains
    rate = np.array([1.0 - period * kd, -period * kp, -period * ki])
    error = np.array([0.0, 1.0, 0.0]) + period * rate
    total = np.array([0.0, 0.0, 1.0]) + period * error
    size = 3 if integral else 2
    return np.stack([rate, error, total])[:size, :size]


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("integral_time", INTEGRAL_TIMES)
def test_the_loop_has_the_poles_of_the_continuous_one(period, integral_time):
    """Two of damping ratio zeta, the slowest at -4 / settling_time, and that of the integral.
    Compared as polynomials in (z - 1) / period, by their values at some points, which stay well
    conditioned at short periods and double poles."""
    for settling_time, damping in itertools.product(SETTLING_TIMES, DAMPINGS):
        pair = np.roots([1.0, 2.0 * damping, 1.0])
        poles = np.append(
            pair / -pair.real.max() * DECADES / settling_time,
            [] if integral_time is None else -DECADES / integral_time,
        )
        matrix = loop(
            discrete_gains(settling_time, damping, period, integral_time),
            period,
            integral_time is not None,
        )
        scale = np.abs(poles).max()
        for z in (0.0, 1.0, 1.0j, -3.0):
            found = np.linalg.det(
                z * scale * np.eye(len(matrix)) - (matrix - np.eye(len(matrix))) / period
            )
            assert found == pytest.approx(
                np.prod(z * scale - np.expm1(poles * period) / period),
                rel=1e-6,
                abs=1e-9 * scale ** len(matrix),
            )


@pytest.fixture(params=range(12))
def problem(request):
    """A random full-rank task |A x - b|^2 with bounds: A (m + 2, m), b, least, greatest."""
    rng = np.random.default_rng(request.param)
    size = rng.integers(1, 13)
    A, b = rng.normal(size=(size + 2, size)), 3.0 * rng.normal(size=size + 2)
    unit = 10.0 ** rng.uniform(-3.0, 3.0)
    return unit * A, unit * b, rng.uniform(-1.0, 0.0, size), rng.uniform(0.0, 1.0, size)


def test_another_solver_agrees_and_the_conditions_of_an_optimum_hold(problem):
    """Where bounds are loose the slope is zero, at the least it does not fall inwards, at the
    greatest neither."""
    A, b, least, greatest = problem
    found = allocate(A.T @ A, -A.T @ b, least, greatest)
    assert found.solved
    np.testing.assert_allclose(
        found.x, lsq_linear(A, b, (least, greatest), method="bvls", tol=1e-14).x, atol=1e-7
    )
    slope = A.T @ (A @ found.x - b) / np.trace(A.T @ A)
    at_least, at_greatest = found.x - least < 1e-9, greatest - found.x < 1e-9
    assert (found.x >= least).all()
    assert (found.x <= greatest).all()
    assert (slope[at_least] > 0.0).all()
    assert (slope[at_greatest] < 0.0).all()
    np.testing.assert_allclose(slope[~at_least & ~at_greatest], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        found.multipliers, -slope * slope.size, atol=1e-9
    )  # what the bounds push back with
