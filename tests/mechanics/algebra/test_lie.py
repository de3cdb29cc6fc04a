"""SE(3) against its definitions, as power series summed with 50 digits: near zero, across the series switch, over several turns.

The closed forms of the package are compared with sum ad^n / (n + 1)!, so a wrong coefficient cannot be wrong in both.
Every function runs on floats and on packs; linear parts are nonzero, since that is where T and T_dot lose their digits.
"""

import math

import numpy as np
import pytest
from mpmath import mp, mpf

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.lie import (
    SERIES_LIMIT,
    Ad_apply,
    Ad_inverse_apply,
    ad_apply,
    coad_apply,
    coefficients,
    columns_of,
    cross,
    dexp_dot_apply,
    dexp_operator,
    dot,
    exp_se3,
    log_se3,
    matmul,
    operator_apply,
    rotate,
    rotate_back,
    rotation_log,
    skew_times,
    times_skew,
)
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store3, store6

pytestmark = pytest.mark.no_jit

ACCURACY = 1e-12  # relative to the norm of the exact 3-vector
DIGITS = 50
SWITCH = math.sqrt(SERIES_LIMIT)
ANGLES = (
    0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 0.3, 0.7,
    0.999, np.nextafter(SWITCH, 0), SWITCH, np.nextafter(SWITCH, 2), 1.001, 1.5, 2.0, 3.0, math.pi, 4.0, 6.0, 2 * math.pi, 7.0, 13.0, 20.0,
)  # fmt: skip


# the package's functions on numbers and on packs ------------------------------------------------------------------------


@kernel(inline=True)
def everything(Omega, Omega_dot, x):
    """Rows of exp as three vectors, r, T x, T_dot x."""
    c = coefficients(dot(Omega[0], Omega[0]))
    R, r = exp_se3(Omega, c)
    A, C = dexp_operator(Omega, c)
    return R, r, operator_apply(A, C, x), dexp_dot_apply(Omega, Omega_dot, c, x)


@kernel
def on_numbers(Omegas, rates, xs, out):
    for i in range(Omegas.shape[0]):
        a, b, x = Omegas[i], rates[i], xs[i]
        R, r, T, T_dot = everything(
            ((a[0], a[1], a[2]), (a[3], a[4], a[5])), ((b[0], b[1], b[2]), (b[3], b[4], b[5])), ((x[0], x[1], x[2]), (x[3], x[4], x[5]))
        )
        for j in range(9):
            out[i, j] = R[j]
        for j in range(3):
            out[i, 9 + j] = r[j]
            out[i, 12 + j], out[i, 15 + j] = T[0][j], T[1][j]
            out[i, 18 + j], out[i, 21 + j] = T_dot[0][j], T_dot[1][j]


@kernel
def on_packs(Omegas, rates, xs, out):
    """Flat fields (pack, component, lane); 24 components out."""
    for i in range(Omegas.size // (6 * LANES)):
        at, out_at = i * 6 * LANES, i * 24 * LANES
        R, r, T, T_dot = everything(load6(Omegas, at), load6(rates, at), load6(xs, at))
        store3(out, out_at, (R[0], R[1], R[2]))
        store3(out, out_at + 3 * LANES, (R[3], R[4], R[5]))
        store3(out, out_at + 6 * LANES, (R[6], R[7], R[8]))
        store3(out, out_at + 9 * LANES, r)
        store6(out, out_at + 12 * LANES, T)
        store6(out, out_at + 18 * LANES, T_dot)


def evaluated(Omegas, rates, xs, packs=False):
    if not packs:
        out = np.empty((len(Omegas), 24))
        on_numbers(Omegas, rates, xs, out)
        return out
    lanes_last = [np.ascontiguousarray(v.reshape(-1, LANES, 6).swapaxes(1, 2)).ravel() for v in (Omegas, rates, xs)]
    out = np.empty(len(Omegas) * 24)
    on_packs(*lanes_last, out)
    return out.reshape(-1, 24, LANES).swapaxes(1, 2).reshape(-1, 24)


# their definitions in 50 digits -----------------------------------------------------------------------------------------


def mp_cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def mp_ad(a, x):
    """[k x x_k, p x x_k + k x x_p]."""
    return mp_cross(a[:3], x[:3]) + [s + t for s, t in zip(mp_cross(a[3:], x[:3]), mp_cross(a[:3], x[3:]), strict=True)]


def exact_tangent(Omega, Omega_dot, x):
    """T x = sum ad^n x / (n + 1)! and its derivative along Omega_dot, term by term."""
    term, rate = list(x), [mpf(0)] * 6
    total, total_rate = list(term), list(rate)
    for n in range(1, 160):
        rate = [(s + t) / (n + 1) for s, t in zip(mp_ad(Omega, rate), mp_ad(Omega_dot, term), strict=True)]
        term = [t / (n + 1) for t in mp_ad(Omega, term)]
        total, total_rate = [s + t for s, t in zip(total, term, strict=True)], [s + t for s, t in zip(total_rate, rate, strict=True)]
    return total, total_rate


def exact_exp(Omega):
    """R (columns, one per unit vector, then as 9 numbers by rows) and r = sum k~^n p / (n + 1)!."""
    columns, r = [], [mpf(0)] * 3
    for start in ([1, 0, 0], [0, 1, 0], [0, 0, 1], Omega[3:]):
        is_unit = len(columns) < 3
        term = [mpf(v) for v in start]
        total = list(term)
        for n in range(1, 160):
            term = [t / (n if is_unit else n + 1) for t in mp_cross(Omega[:3], term)]
            total = [s + t for s, t in zip(total, term, strict=True)]
        if is_unit:
            columns.append(total)
        else:
            r = total
    return [columns[j][i] for i in range(3) for j in range(3)] + r


def exact(Omegas, rates, xs):
    """The 24 numbers of `everything` in floats, from 50 digits."""
    rows = []
    with mp.workdps(DIGITS):
        for Omega, rate, x in zip(Omegas, rates, xs, strict=True):
            Omega, rate, x = ([mpf(float(v)) for v in values] for values in (Omega, rate, x))
            T, T_dot = exact_tangent(Omega, rate, x)
            rows.append([float(v) for v in exact_exp(Omega) + T + T_dot])
    return np.array(rows)


@pytest.fixture(scope="module")
def samples():
    """Twists of every angle with linear parts from tiny to large, random directions; a whole number of packs."""
    rng = np.random.default_rng(1)
    axes, pushes = rng.normal(size=(2, len(ANGLES) * 3, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    angles, sizes = np.repeat(ANGLES, 3), np.tile([1e-3, 1.0, 30.0], len(ANGLES))
    Omegas = np.hstack([axes * angles[:, None], pushes * sizes[:, None]])
    Omegas = np.vstack([Omegas, np.tile(Omegas[-1], (-len(Omegas) % LANES, 1))])
    rates, xs = rng.normal(size=(2, len(Omegas), 6))
    return (Omegas, rates, xs), exact(Omegas, rates, xs)


def relative_errors(found, expected):
    """Per 3-vector, relative to its own norm: (samples, vectors)."""
    found, expected = found.reshape(len(found), -1, 3), expected.reshape(len(expected), -1, 3)
    return np.linalg.norm(found - expected, axis=-1) / np.maximum(np.linalg.norm(expected, axis=-1), 1e-290)


@pytest.mark.parametrize("packs", (False, True), ids=("numbers", "packs"))
def test_exp_T_and_T_dot_are_accurate_at_every_angle(samples, packs):
    arguments, expected = samples
    errors = relative_errors(evaluated(*arguments, packs=packs), expected)
    names = ("R", "R", "R", "r", "T k", "T p", "T_dot k", "T_dot p")
    for name, column in zip(names, errors.T, strict=True):
        worst = int(np.argmax(column))
        assert column[worst] < ACCURACY, f"{name} is off by {column[worst]:.1e} at Omega = {arguments[0][worst]}"


@pytest.mark.parametrize("angle", (1e-300, 1e-160, 1e-12))
def test_first_order_terms_of_tiny_rotations(angle):
    """R - I = k~ and T_dot x = ad x / 2 there; beside the identity their digits would not show."""
    k, x = angle * np.array([0.6, 0.0, 0.8]), np.array([0, 0, 0, 0.3, -2.0, 1.1])
    Omega = np.append(k, [0, 0, 0])
    out = evaluated(Omega[None], Omega[None], x[None])[0]
    np.testing.assert_allclose(out[[7, 2, 3]], k, rtol=0, atol=1e-11 * angle)
    np.testing.assert_allclose(out[21:24], 0.5 * np.cross(k, x[3:]), rtol=0, atol=1e-11 * angle)


# the coefficients themselves -------------------------------------------------------------------------------------------


@kernel
def coefficients_of(x, packs, out):
    """The six coefficients, a pack each."""
    if packs:
        c = coefficients(load(x, 0))
        for i in range(6):
            store(out, i * LANES, c[i])
    else:
        for j in range(LANES):
            d = coefficients(x[j])
            for i in range(6):
                out[i * LANES + j] = d[i]


def exact_coefficients(x):
    """a, b, a1, b1, a2, b2, a3, b3 by their power series, f1 = 2 df/dx."""
    with mp.workdps(DIGITS + 20):
        x, rows = mpf(float(x)), []
        a = [mpf(-1) ** m / mp.factorial(2 * m + 2) for m in range(120)]
        b = [mpf(-1) ** m / mp.factorial(2 * m + 3) for m in range(120)]
        for _ in range(4):
            rows += [float(sum(factor * x**m for m, factor in enumerate(row))) for row in (a, b)]
            a, b = ([2 * (m + 1) * f[m + 1] for m in range(len(f) - 1)] for f in (a, b))
        return rows


MOST = [1e-15, 1e-15, 1e-14, 1e-14, 1e-13, 1e-12]


@pytest.mark.parametrize("packs", (False, True), ids=("numbers", "packs"))
def test_coefficients_to_round_off(packs):
    """Relative to |f| and to x f', by which round-off in x moves f. Most is lost just above the switch."""
    squares = np.array([angle * angle for angle in ANGLES] + [np.nextafter(SERIES_LIMIT, 0)])
    for x in squares.reshape(-1, LANES):
        out = np.empty(6 * LANES)
        coefficients_of(x, packs, out)
        expected = np.array([exact_coefficients(number) for number in x]).T
        scale = np.abs(expected[:6]) + x * np.abs(expected[2:])
        errors = (np.abs(out.reshape(6, LANES) - expected[:6]) / scale).max(axis=1)
        assert (errors < MOST).all(), f"a, b, a1, b1, a2, b2 at {x}: {errors}"


def test_nan_and_infinity_come_through():
    for bad in (np.nan, np.inf):
        out = np.empty(6 * LANES)
        with np.errstate(invalid="ignore"):
            try:
                coefficients_of(np.array([bad, 0.1, 0.2, 4.0]), True, out)
            except ValueError:  # math.sin(inf) without the compiler
                continue
        out = out.reshape(6, LANES)
        assert np.isnan(out[:, 0]).any() and np.isfinite(out[:, 1:]).all()


# logarithm --------------------------------------------------------------------------------------------------------------


AXES = np.vstack([np.eye(3), -np.eye(3), [1, 1, 1], [1, -1, 0], [1e-9, 1, 1e-5], np.random.default_rng(2).normal(size=(12, 3))])
AXES = AXES / np.linalg.norm(AXES, axis=1)[:, None]
LOG_ANGLES = (1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 0.1, 0.9999999, 1.0, 2.0, 2.1, 3.0, math.pi - 1e-3, math.pi - 1e-6, math.pi - 1e-9)


def exact_pose(Omega):
    with mp.workdps(DIGITS):
        numbers = [float(v) for v in exact_exp([mpf(float(v)) for v in Omega])]
    return tuple(numbers[:9]), tuple(numbers[9:])


@pytest.mark.cases("angle", LOG_ANGLES)
def test_log_inverts_exp_on_exactly_rounded_poses(angle):
    """Up to pi - 1e-9; the pose is the exact one, rounded, so this tests the logarithm alone."""
    rng = np.random.default_rng(5)
    for axis in AXES[::2]:
        p = rng.normal(size=3)
        k, found = (np.array(part) for part in log_se3(*exact_pose([*(angle * axis), *p])))
        np.testing.assert_allclose(np.linalg.norm(k - angle * axis), 0, atol=4e-15 * angle)
        np.testing.assert_allclose(np.linalg.norm(found - p), 0, atol=1e-14 * np.linalg.norm(p))


@pytest.mark.cases("short_of_pi", (1e-9, 1e-12, 1e-15, 0.0))
@pytest.mark.cases("axis", AXES)
def test_log_next_to_a_half_turn(axis, short_of_pi):
    """Within 1e-15 of pi the axis may come out reversed: the rotation is the same."""
    angle = math.pi - short_of_pi
    k = np.array(rotation_log(exact_pose([*(angle * axis), 0, 0, 0])[0]))
    sign = 1.0 if short_of_pi > 1e-14 else np.sign(k @ axis)
    np.testing.assert_allclose(k, sign * angle * axis, atol=1e-14)


def test_log_of_the_identity_and_of_pure_translation():
    identity = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    k, p = log_se3(identity, (1.0, -2.0, 3.0))
    assert k == (0.0, 0.0, 0.0) and p == (1.0, -2.0, 3.0)


# identities -------------------------------------------------------------------------------------------------------------


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
    return np.array([np.ravel(function(pair(e))) for e in np.eye(6)]).T


def skew(x):
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


@pytest.fixture(params=range(2))
def two_twists(request):
    return np.random.default_rng(request.param).normal(size=(2, 6))


def test_ad_and_coad_are_the_matrices_of_appendix_A(two_twists):
    x = two_twists[0]
    expected = np.block([[skew(x[:3]), np.zeros((3, 3))], [skew(x[3:]), skew(x[:3])]])
    ad = matrix(lambda y: ad_apply(pair(x), y))
    np.testing.assert_allclose(ad, expected, atol=1e-16)
    np.testing.assert_allclose(matrix(lambda w: coad_apply(pair(x), w)), -ad.T, atol=1e-16)


def test_Ad_is_the_matrix_of_appendix_A_and_its_inverse(two_twists):
    R, r = pose_of(two_twists[0][:3], two_twists[0][3:])
    full = np.reshape(R, (3, 3))
    Ad = matrix(lambda x: Ad_apply(R, r, x))
    np.testing.assert_allclose(Ad, np.block([[full, np.zeros((3, 3))], [skew(r) @ full, full]]), atol=1e-15)
    np.testing.assert_allclose(matrix(lambda x: Ad_inverse_apply(R, r, x)) @ Ad, np.eye(6), atol=2e-15)


def test_T_gives_the_body_twist_of_exp(two_twists):
    """g^-1 dg/dt = Ad_g^-1 T Omega_dot, by central differences of the pose."""
    Omega, rate, step = two_twists[0], two_twists[1], 1e-5

    def g(t):
        R, r = pose_of(Omega[:3] + t * rate[:3], Omega[3:] + t * rate[3:])
        return np.vstack([np.column_stack([np.reshape(R, (3, 3)), r]), [0, 0, 0, 1]])

    twist = np.linalg.solve(g(0.0), (g(step) - g(-step)) / (2 * step))
    R, r = pose_of(Omega[:3], Omega[3:])
    c = coefficients_number(dot(pair(Omega)[0], pair(Omega)[0]))
    expected = np.ravel(Ad_inverse_apply(R, r, operator_apply(*dexp_operator(pair(Omega), c), pair(rate))))
    np.testing.assert_allclose([twist[2, 1], twist[0, 2], twist[1, 0], *twist[:3, 3]], expected, atol=1e-9)


def test_3x3_helpers_against_numpy():
    rng = np.random.default_rng(7)
    A, B, x, y, z = (*rng.normal(size=(2, 9)), *rng.normal(size=(3, 3)))
    a, b = tuple(A.tolist()), tuple(B.tolist())
    u, v, w = (tuple(vector.tolist()) for vector in (x, y, z))
    full_A, full_B = A.reshape(3, 3), B.reshape(3, 3)
    np.testing.assert_allclose(cross(u, v), np.cross(x, y), atol=1e-15)
    np.testing.assert_allclose(rotate(a, u), full_A @ x, atol=1e-14)
    np.testing.assert_allclose(rotate_back(a, u), full_A.T @ x, atol=1e-14)
    np.testing.assert_allclose(matmul(a, b), (full_A @ full_B).ravel(), atol=1e-14)
    np.testing.assert_allclose(skew_times(u, b), (skew(x) @ full_B).ravel(), atol=1e-14)
    np.testing.assert_allclose(times_skew(a, u), (full_A @ skew(x)).ravel(), atol=1e-14)
    np.testing.assert_array_equal(np.reshape(columns_of(u, v, w), (3, 3)), np.column_stack([x, y, z]))
