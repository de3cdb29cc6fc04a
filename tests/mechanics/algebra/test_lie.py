"""SE(3) against its definitions, as power series summed with 50 digits: near zero, across the
series switch, over several turns.

The closed forms of the package are compared with sum ad^n / (n + 1)!, so a wrong coefficient cannot
be wrong in both. They run on packs; linear parts are nonzero, since that is where T and T_dot lose
their digits.
"""

import math

import numpy as np
import pytest
from mpmath import mp, mpf
from scipy.linalg import expm

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.algebra.lie import (
    SERIES_LIMIT,
    Ad_apply,
    Ad_inverse_apply,
    ad_apply,
    coad_apply,
    coefficients,
    dexp_dot_apply,
    dexp_inverse_transposed_apply,
    dexp_operator,
    dexp_transposed_apply,
    dot,
    exp_se3,
    log_se3,
    matmul,
    operator_apply,
    pose_step,
    rotate_back,
    rotation_log,
    skew_times,
    times_skew,
    twist_difference,
    twist_of,
    write_twist,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store6

pytestmark = pytest.mark.no_jit

ACCURACY = 1e-12  # relative to the norm of the exact 3-vector
DIGITS = 50
SWITCH = math.sqrt(SERIES_LIMIT)
ANGLES = (
    0.0,
    1e-300,
    1e-160,
    1e-12,
    1e-8,
    1e-6,
    1e-4,
    1e-3,
    1e-2,
    0.1,
    0.3,
    0.7,
    0.999,
    np.nextafter(SWITCH, 0),
    SWITCH,
    np.nextafter(SWITCH, 2),
    1.001,
    1.5,
    2.0,
    3.0,
    math.pi,
    4.0,
    6.0,
    2 * math.pi,
    7.0,
    13.0,
    20.0,
)


@kernel
def on_packs(Omegas, rates, xs, out):
    """T x and T_dot x, flat fields (pack, component, lane)."""
    packs = Omegas.size // (6 * LANES)
    for i in range(packs):
        Omega = load6(Omegas, i)
        rate = load6(rates, i)
        x = load6(xs, i)
        angle_squared = dot(Omega[0], Omega[0])
        c = coefficients(angle_squared)
        A, C = dexp_operator(Omega, c)
        applied = operator_apply(A, C, x)
        store6(out, 2 * i, applied)
        applied_dot = dexp_dot_apply(Omega, rate, c, x)
        store6(out, 2 * i + 1, applied_dot)


def evaluate_on_packs(Omegas, rates, xs):
    lanes_last = [
        np.ascontiguousarray(v.reshape(-1, LANES, 6).swapaxes(1, 2)).ravel()
        for v in (Omegas, rates, xs)
    ]
    out = np.empty(len(Omegas) * 12)
    on_packs(*lanes_last, out)
    return out.reshape(-1, 12, LANES).swapaxes(1, 2).reshape(-1, 12)


def mp_cross(a, b):
    a_x, a_y, a_z = a
    b_x, b_y, b_z = b
    x = a_y * b_z - a_z * b_y
    y = a_z * b_x - a_x * b_z
    z = a_x * b_y - a_y * b_x
    return [x, y, z]


def mp_ad(a, x):
    """[k x x_k, p x x_k + k x x_p]."""
    return mp_cross(a[:3], x[:3]) + [
        s + t for s, t in zip(mp_cross(a[3:], x[:3]), mp_cross(a[:3], x[3:]), strict=True)
    ]


def exact_tangent(Omega, Omega_dot, x):
    """T x = sum ad^n x / (n + 1)! and its derivative along Omega_dot, term by term."""
    term = list(x)
    rate = [mpf(0)] * 6
    total = list(term)
    total_rate = list(rate)
    n = 0
    while max(map(abs, term + rate)) > mpf(10) ** -DIGITS:
        n += 1
        rate = [
            (s + t) / (n + 1)
            for s, t in zip(mp_ad(Omega, rate), mp_ad(Omega_dot, term), strict=True)
        ]
        term = [t / (n + 1) for t in mp_ad(Omega, term)]
        total = [s + t for s, t in zip(total, term, strict=True)]
        total_rate = [s + t for s, t in zip(total_rate, rate, strict=True)]
    return total, total_rate


def exact(Omegas, rates, xs):
    """T x and T_dot x in floats, from 50 digits: (samples, 12)."""
    rows = []
    with mp.workdps(DIGITS):
        for Omega, rate, x in zip(Omegas, rates, xs, strict=True):
            Omega, rate, x = ([mpf(float(v)) for v in values] for values in (Omega, rate, x))
            T, T_dot = exact_tangent(Omega, rate, x)
            rows.append([float(v) for v in T + T_dot])
    return np.array(rows)


@pytest.fixture(scope="module")
def samples():
    """Twists of every angle with linear parts from tiny to large, random directions; a whole number
    of packs."""
    rng = np.random.default_rng(1)
    sizes = [1e-3, 1.0, 30.0]
    count = len(ANGLES) * len(sizes)
    axes, pushes = rng.normal(size=(2, count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angular = axes * np.repeat(ANGLES, len(sizes))[:, None]
    linear = pushes * np.tile(sizes, len(ANGLES))[:, None]
    Omegas = np.hstack([angular, linear])
    # The last pack is filled with the last twist.
    missing = -count % LANES
    filling = np.tile(Omegas[-1], (missing, 1))
    Omegas = np.vstack([Omegas, filling])
    rates, xs = rng.normal(size=(2, len(Omegas), 6))
    return (Omegas, rates, xs), exact(Omegas, rates, xs)


def relative_errors(found, expected):
    """Per 3-vector, relative to its own norm: (samples, vectors)."""
    found = found.reshape(len(found), -1, 3)
    expected = expected.reshape(len(expected), -1, 3)
    return np.linalg.norm(found - expected, axis=-1) / np.maximum(
        np.linalg.norm(expected, axis=-1), 1e-290
    )


def test_T_and_T_dot_are_accurate_at_every_angle(samples):
    arguments, expected = samples
    errors = relative_errors(evaluate_on_packs(*arguments), expected)
    for name, column in zip(("T k", "T p", "T_dot k", "T_dot p"), errors.T, strict=True):
        worst = int(np.argmax(column))
        assert column[worst] < ACCURACY, (
            f"{name} is off by {column[worst]:.1e} at Omega = {arguments[0][worst]}"
        )


def pose_of(k, p):
    Omega = (tuple(k.tolist()), tuple(p.tolist()))
    return exp_se3(Omega, coefficients_number(dot(Omega[0], Omega[0])))


@kernel
def coefficients_number(x):
    return coefficients(x)


def pair(x):
    return tuple(x[:3].tolist()), tuple(x[3:].tolist())


def matrix(function):
    """The 6x6 matrix of a function of twists."""
    columns = []
    for unit in np.eye(6):
        image = function(pair(unit))
        columns.append(np.ravel(image))
    return np.array(columns).T


def skew(x):
    a, b, c = x
    return np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])


@pytest.fixture(params=range(2))
def two_twists(request):
    rng = np.random.default_rng(request.param)
    return rng.normal(size=(2, 6))


def test_ad_and_coad_are_the_matrices_of_appendix_A(two_twists):
    x = two_twists[0]
    k = skew(x[:3])
    p = skew(x[3:])
    nothing = np.zeros((3, 3))
    expected = np.block([[k, nothing], [p, k]])
    ad = matrix(lambda y: ad_apply(pair(x), y))
    np.testing.assert_allclose(ad, expected, atol=1e-16)
    coad = matrix(lambda w: coad_apply(pair(x), w))
    np.testing.assert_allclose(coad, -ad.T, atol=1e-16)


def test_Ad_is_the_matrix_of_appendix_A_and_its_inverse(two_twists):
    R, r = pose_of(two_twists[0][:3], two_twists[0][3:])
    full = np.reshape(R, (3, 3))
    Ad = matrix(lambda x: Ad_apply(R, r, x))
    np.testing.assert_allclose(
        Ad, np.block([[full, np.zeros((3, 3))], [skew(r) @ full, full]]), atol=1e-15
    )
    np.testing.assert_allclose(
        matrix(lambda x: Ad_inverse_apply(R, r, x)) @ Ad, np.eye(6), atol=2e-15
    )


@kernel
def transposed_tangents(Omega, psi):
    """T^T psi, and the transposed inverses T_x^-T psi at Omega and at its negative."""
    c = coefficients(dot(Omega[0], Omega[0]))
    of_inverse = dexp_inverse_transposed_apply(Omega, c, 1.0, psi)
    of_opposite = dexp_inverse_transposed_apply(Omega, c, -1.0, psi)
    return dexp_transposed_apply(Omega, c, psi), of_inverse, of_opposite


@kernel
def tangent(Omega, x):
    """T x."""
    A, C = dexp_operator(Omega, coefficients(dot(Omega[0], Omega[0])))
    return operator_apply(A, C, x)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.3, 0.999, 1.001, 2.5, 3.1])
def test_transposed_tangents_are_the_transposes_of_the_tangent_and_its_inverse(angle):
    rng = np.random.default_rng(3)
    x = rng.normal(size=6)
    x[:3] *= angle / np.linalg.norm(x[:3])
    Omega = pair(x)
    Omega_opposite = pair(-x)
    T = matrix(lambda y: tangent(Omega, y))
    T_opposite = matrix(lambda y: tangent(Omega_opposite, y))

    def result_matrix(position):
        return matrix(lambda psi: transposed_tangents(Omega, psi)[position])

    transposed = result_matrix(0)
    inverse = result_matrix(1)
    opposite = result_matrix(2)
    identity = np.eye(6)
    np.testing.assert_allclose(transposed, T.T, atol=1e-13)
    np.testing.assert_allclose(inverse @ T.T, identity, atol=1e-12)
    np.testing.assert_allclose(opposite @ T_opposite.T, identity, atol=1e-12)


def exponential_of(k, p):
    """exp of a twist as a matrix (4, 4)."""
    hat = np.zeros((4, 4))
    hat[:3, :3] = skew(k)
    hat[:3, 3] = p
    return expm(hat)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.999, 1.001, 2.0, 3.1, math.pi - 1e-7])
@pytest.mark.parametrize("seed", range(4))
def test_exponential_and_logarithm_are_those_of_matrices(angle, seed):
    """Whichever component of the quaternion is the largest."""
    rng = np.random.default_rng(seed)
    axis, p = rng.normal(size=(2, 3))
    if seed > 0:
        axis[seed - 1] += 5.0
    k = angle * axis / np.linalg.norm(axis)
    exact = exponential_of(k, p)
    R, r = pose_of(k, p)
    rotation = np.reshape(R, (3, 3))
    np.testing.assert_allclose(rotation, exact[:3, :3], atol=1e-14)
    np.testing.assert_allclose(r, exact[:3, 3], atol=1e-14)
    k_again, p_again = log_se3(R, r)
    np.testing.assert_allclose(k_again, k, atol=1e-13)
    np.testing.assert_allclose(p_again, p, atol=1e-12)
    np.testing.assert_allclose(rotation_log(R), k, atol=1e-13)


def test_steps_and_products_are_those_of_matrices(two_twists):
    first, second = two_twists
    start = exponential_of(first[:3], first[3:])
    R, r = pose_of(first[:3], first[3:])
    R_end, r_end = pose_step(R, r, pair(second))
    step = exponential_of(second[:3], second[3:])
    end = start @ step
    rotation_end = np.reshape(R_end, (3, 3))
    np.testing.assert_allclose(rotation_end, end[:3, :3], atol=1e-14)
    np.testing.assert_allclose(r_end, end[:3, 3], atol=1e-14)
    A = np.arange(9.0).reshape(3, 3)
    k = second[:3]
    flat = tuple(A.ravel().tolist())
    vector = tuple(k.tolist())
    expected_products = [
        (matmul(flat, R), A @ np.reshape(R, (3, 3))),
        (skew_times(vector, flat), skew(k) @ A),
        (times_skew(flat, vector), A @ skew(k)),
    ]
    for product, expected in expected_products:
        np.testing.assert_allclose(np.reshape(product, (3, 3)), expected, atol=1e-14)
    np.testing.assert_allclose(rotate_back(flat, vector), A.T @ k, atol=1e-14)
    difference = twist_difference(pair(first), pair(second))
    np.testing.assert_allclose(np.ravel(difference), first - second, atol=1e-16)


def test_twists_are_written_as_they_are_read():
    """Angular before linear."""
    twist = ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    row = np.zeros(6)
    write_twist(twist, row)
    np.testing.assert_array_equal(row, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert twist_of(row) == twist
