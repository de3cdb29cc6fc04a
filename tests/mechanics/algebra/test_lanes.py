"""Packs inside kernels do what NumPy does on arrays of LANES numbers."""

import numpy as np
import pytest

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import (
    LANES,
    lane,
    lane_sum,
    largest,
    load,
    prefix_sum,
    store,
)

pytestmark = pytest.mark.no_jit

X = np.array([1.5, -2.25, 1e-300, 3e20])
Y = np.array([-0.75, 4.0, 7e-301, 1e19])


@kernel
def arithmetic(x, y, s, out):
    """Every operator, pack with pack and with a float on either side; one pack of `out` each."""
    a, b = load(x, 0), load(y, 0)
    store(out, 0, a + b)
    store(out, 1 * LANES, a - b)
    store(out, 2 * LANES, a * b)
    store(out, 3 * LANES, a / b)
    store(out, 4 * LANES, a + s)
    store(out, 5 * LANES, s + a)
    store(out, 6 * LANES, a - s)
    store(out, 7 * LANES, s - a)
    store(out, 8 * LANES, a * s)
    store(out, 9 * LANES, s * a)
    store(out, 10 * LANES, a / s)
    store(out, 11 * LANES, s / a)
    store(out, 12 * LANES, -a)


def test_operators_agree_with_numpy_bit_for_bit():
    s, out = 3.7, np.full(13 * LANES, np.nan)
    arithmetic(X, Y, s, out)
    expected = [X + Y, X - Y, X * Y, X / Y, X + s, s + X, X - s, s - X, X * s, s * X, X / s, s / X, -X]
    np.testing.assert_array_equal(out.reshape(-1, LANES), expected)


@kernel
def reductions(x, sums, out):
    a = load(x, 0)
    store(sums, 0, prefix_sum(a))
    out[0], out[1], out[2] = lane_sum(a), largest(a), -largest(-a)
    for i in range(LANES):
        out[3 + i] = lane(a, i)


def reduce_pack(x):
    sums, out = np.empty(LANES), np.empty(3 + LANES)
    reductions(np.array(x), sums, out)
    return sums, out


@pytest.mark.cases("seed", range(3))
def test_sums_and_extremes_agree_with_numpy(seed):
    x = np.random.default_rng(seed).normal(size=LANES)
    sums, out = reduce_pack(x)
    np.testing.assert_allclose(sums, np.cumsum(x), rtol=0, atol=4e-16 * np.abs(x).sum())
    np.testing.assert_allclose(out[0], x.sum(), rtol=0, atol=4e-16 * np.abs(x).sum())
    np.testing.assert_array_equal(out[1:], [x.max(), x.min(), *x])


@pytest.mark.cases("where", range(LANES))
@pytest.mark.cases("others", (0.0, np.inf, -np.inf))
def test_extremes_are_nan_if_any_lane_is(where, others):
    x = np.full(LANES, others)
    x[where] = np.nan
    with np.errstate(invalid="ignore"):
        _, out = reduce_pack(x)
    assert np.isnan(out[1]) and np.isnan(out[2])
