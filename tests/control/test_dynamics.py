"""The implicit step against its formula and its balance of forces, gains by the poles that were
asked for."""

import itertools

import numpy as np
import pytest

from soft_tendon_env.control.dynamics import (
    DECADES,
    discrete_gains,
    implicit_inertia,
    implicit_step,
)
from soft_tendon_env.model.terms import Terms

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
    rate, error, total = np.eye(3)
    # e_ddot = -kd e_dot - kp e - ki i, then e and i with the values after it
    acceleration = -np.array([kd, kp, ki])
    rate = rate + period * acceleration
    error = error + period * rate
    total = total + period * error
    matrix = np.stack([rate, error, total])
    if integral:
        return matrix
    return matrix[:2, :2]


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


@pytest.fixture
def terms():
    """Terms of an arm of four coordinates and two tendons among effects that are stiff and damp, as
    random numbers."""
    rng = np.random.default_rng(5)
    M, D, G, stiffness, damping = (
        factor @ factor.T + np.eye(4) for factor in rng.normal(size=(5, 4, 4))
    )
    bias, elastic, external = rng.normal(size=(3, 4))
    return Terms(
        mass=M,
        bias=bias,
        damping=D,
        stiffness=G,
        actuation=rng.normal(size=(4, 2)),
        elastic_force=elastic,
        external_force=external,
        tip_pose=np.eye(4),
        tip_jacobian=np.zeros((6, 4)),
        tip_bias=np.zeros(6),
        external_stiffness=stiffness,
        external_damping=damping,
    )


@pytest.mark.parametrize("h", [0.01, 0.3])
def test_the_step_balances_the_linearised_equation_of_motion(terms, h):
    """At its end, with forces linearised about its beginning: those of the effects change with the
    rates by -D_F (v+ - v), and both stiffnesses act on the way h v+."""
    rng = np.random.default_rng(0)
    v = rng.normal(size=4)
    u = rng.normal(size=2)
    step = implicit_step(terms, v, h)
    end = step.free + step.response @ u
    way = h * end
    of_arm = terms.elastic_force + terms.stiffness @ way + terms.damping @ end + terms.bias
    of_effects = (
        terms.external_force - terms.external_stiffness @ way - terms.external_damping @ (end - v)
    )
    force = terms.actuation @ u - of_arm + of_effects
    np.testing.assert_allclose(terms.mass @ (end - v) / h, force, rtol=1e-9, atol=1e-9)
    inertia = implicit_inertia(terms, h)
    expected_metric = step.response.T @ inertia @ step.response
    np.testing.assert_allclose(step.metric, expected_metric, rtol=1e-9)


def test_a_singular_step_is_an_error(terms):
    nothing = np.zeros((4, 4))
    names = ("mass", "damping", "stiffness", "external_stiffness", "external_damping")
    singular = terms._replace(**dict.fromkeys(names, nothing))
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        implicit_step(singular, np.zeros(4), 0.02)


@pytest.mark.parametrize("name", ["settling_time", "damping", "period", "integral_time"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "short"])
def test_what_is_no_positive_number_is_named(name, value):
    numbers = {"settling_time": 0.5, "damping": 1.0, "period": 0.02, "integral_time": 0.5}
    with pytest.raises((TypeError, ValueError), match=f"{name} should be a positive number"):
        discrete_gains(**{**numbers, name: value})


def test_short_periods_give_the_gains_of_the_continuous_loop():
    """s^3 + kd s^2 + kp s + ki has the three poles; to first order in the period: ten times
    shorter, ten times nearer."""
    natural = DECADES / 0.5 / 0.8
    pair = np.roots([1.0, 2.0 * 0.8 * natural, natural**2])
    _, kd, kp, ki = np.poly([*pair, -DECADES / 0.4]).real
    off = []
    for period in (1e-4, 1e-5):
        gains = discrete_gains(0.5, 0.8, period, 0.4)
        off.append(np.array(gains) / [kp, kd, ki] - 1.0)
    np.testing.assert_allclose(off[0] / off[1], 10.0, rtol=0.02)


def test_errors_settle_to_two_percent():
    assert np.exp(-DECADES) == pytest.approx(0.02, rel=0.1)
