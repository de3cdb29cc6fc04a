"""A tendon's wrench column and stiffness are the first and second derivatives of its length with respect to the strain."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, store
from soft_tendon_env.mechanics.algebra.symmetric6 import load6, store3, store6
from soft_tendon_env.mechanics.terms.tendons import add_stiffness, chord, tangent_rate, unit_tangent, wrench_column

pytestmark = pytest.mark.no_jit

OUT = 3 + 1 + 6 + 21 + 1 + 3
LOWER = np.tril_indices(6)


@kernel
def one_tendon(geometry, xi, xi_dot, tension, out):
    """Packs out: t, 1/|t_c|, s, the stiffness of `tension` (21), relative rate of |t_c|, t_dot."""
    k, p = load6(xi, 0)
    t, inverse = unit_tangent(chord(geometry, 0, k, p))
    s = wrench_column(geometry, 0, t)
    store3(out, 0, t)
    store(out, 3 * LANES, inverse)
    store6(out, 4 * LANES, s)
    o = load(out, 0) * 0.0
    nothing = (o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o, o)
    h = add_stiffness(nothing, geometry, 0, tension * inverse, s, (0, 1, 2, 3, 4, 5))
    for i in range(21):
        store(out, (10 + i) * LANES, h[i])
    stretch, t_dot = tangent_rate(geometry, 0, load6(xi_dot, 0), t, inverse)
    store(out, 31 * LANES, stretch)
    store3(out, 32 * LANES, t_dot)


def by_lane(values):
    return np.ascontiguousarray(values.T).ravel()


@pytest.fixture
def sample():
    """Offsets and slopes, strains and their rates of four sections: bent, twisted, sheared, tendons far off the axis."""
    rng = np.random.default_rng(0)
    geometry = np.hstack([rng.uniform(-0.3, 0.3, (LANES, 2)), rng.uniform(-0.5, 0.5, (LANES, 2)), np.ones((LANES, 1))])
    xi = np.array([0, 0, 0, 1, 0, 0]) + rng.uniform(-0.4, 0.4, (LANES, 6))
    return geometry, xi, rng.normal(size=(LANES, 6))


def kernel_values(geometry, xi, xi_dot, tension):
    out = np.zeros(OUT * LANES)
    one_tendon(by_lane(geometry), by_lane(xi), by_lane(xi_dot), tension, out)
    return np.split(out.reshape(OUT, LANES).T, [3, 4, 10, 31, 32], axis=1)


def chord_of(geometry, xi):
    """t_c = k x d + p + d' (22), with NumPy, (LANES, 3)."""
    y, z, y_prime, z_prime, _ = geometry.T
    zero = np.zeros_like(y)
    return np.cross(xi[:, :3], np.stack([zero, y, z], axis=1)) + xi[:, 3:] + np.stack([zero, y_prime, z_prime], axis=1)


def length_of(geometry, xi):
    """Length of tendon per length of rod."""
    return np.linalg.norm(chord_of(geometry, xi), axis=1)


def test_tangent_is_the_chord_of_unit_length(sample):
    geometry, xi, xi_dot = sample
    t, inverse, *_ = kernel_values(geometry, xi, xi_dot, 1.0)
    expected = chord_of(geometry, xi)
    np.testing.assert_allclose(t / inverse, expected, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(t, axis=1), 1.0, rtol=1e-15)


def test_wrench_column_is_the_gradient_of_the_length(sample):
    """Work of the tension along any strain; at the straight rod it is (d x t, t) by definition."""
    geometry, xi, xi_dot = sample
    s, step = kernel_values(geometry, xi, xi_dot, 1.0)[2], 1e-6
    for j in range(6):
        change = step * np.eye(6)[j]
        expected = (length_of(geometry, xi + change) - length_of(geometry, xi - change)) / (2 * step)
        np.testing.assert_allclose(s[:, j], expected, atol=1e-10)


def test_stiffness_is_the_hessian_of_tension_times_length(sample):
    """w S (I - t t^T) S^T with w = tension / |t_c|: central differences of tension times the wrench column."""
    geometry, xi, xi_dot = sample
    tension, step = 3.5, 1e-6
    h = kernel_values(geometry, xi, xi_dot, tension)[3]
    full = np.zeros((LANES, 6, 6))
    full[:, LOWER[0], LOWER[1]] = full[:, LOWER[1], LOWER[0]] = h
    for j in range(6):
        change = step * np.eye(6)[j]
        ahead, behind = (kernel_values(geometry, xi + sign * change, xi_dot, 1.0)[2] for sign in (1, -1))
        np.testing.assert_allclose(full[:, :, j], tension * (ahead - behind) / (2 * step), atol=1e-8)


def test_tangent_rate_against_differences(sample):
    geometry, xi, xi_dot = sample
    *_, stretch, t_dot = kernel_values(geometry, xi, xi_dot, 1.0)
    step = 1e-6
    ahead, behind = (chord_of(geometry, xi + sign * step * xi_dot) for sign in (1, -1))
    sizes = [np.linalg.norm(c, axis=1)[:, None] for c in (ahead, behind)]
    np.testing.assert_allclose(stretch, (np.log(sizes[0]) - np.log(sizes[1])) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(t_dot, (ahead / sizes[0] - behind / sizes[1]) / (2 * step), atol=1e-8)
