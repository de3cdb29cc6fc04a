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
    smallest,
    spread,
    sqrt,
    store,
    with_lane,
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
def copy_pack(source, source_at, target, target_at):
    store(target, target_at, load(source, source_at))


@pytest.mark.cases("source_at, target_at", [(0, 0), (1, 3), (4, 1)])
def test_load_and_store_move_only_their_pack_at_any_offset(source_at, target_at):
    source, target = np.arange(4.0 + LANES), np.full(2 * LANES, -1.0)
    copy_pack(source, source_at, target, target_at)
    expected = np.full(2 * LANES, -1.0)
    expected[target_at : target_at + LANES] = source[source_at : source_at + LANES]
    np.testing.assert_array_equal(target, expected)


@kernel
def overwrite(field):
    """A pack that was loaded keeps its value when the array changes."""
    before = load(field, 0)
    store(field, 0, before * 2.0)
    store(field, LANES, before)


def test_a_loaded_pack_is_a_copy():
    field = np.concatenate([X, np.zeros(LANES)])
    overwrite(field)
    np.testing.assert_array_equal(field, np.concatenate([2 * X, X]))


@kernel
def reductions(x, sums, out):
    a = load(x, 0)
    store(sums, 0, prefix_sum(a))
    out[0], out[1], out[2] = lane_sum(a), largest(a), smallest(a)
    for i in range(LANES):
        out[3 + i] = lane(a, i)


def reduced(x):
    sums, out = np.empty(LANES), np.empty(3 + LANES)
    reductions(np.array(x), sums, out)
    return sums, out


@pytest.mark.cases("seed", range(3))
def test_sums_and_extremes_agree_with_numpy(seed):
    x = np.random.default_rng(seed).normal(size=LANES)
    sums, out = reduced(x)
    np.testing.assert_allclose(sums, np.cumsum(x), rtol=0, atol=4e-16 * np.abs(x).sum())
    np.testing.assert_allclose(out[0], x.sum(), rtol=0, atol=4e-16 * np.abs(x).sum())
    np.testing.assert_array_equal(out[1:], [x.max(), x.min(), *x])


@pytest.mark.cases("where", range(LANES))
@pytest.mark.cases("others", (0.0, np.inf, -np.inf))
def test_extremes_are_nan_if_any_lane_is(where, others):
    x = np.full(LANES, others)
    x[where] = np.nan
    with np.errstate(invalid="ignore"):
        _, out = reduced(x)
    assert np.isnan(out[1]) and np.isnan(out[2])


@pytest.mark.cases("where", range(LANES))
def test_extremes_find_every_lane_and_infinities(where):
    x = np.zeros(LANES)
    x[where] = np.inf
    assert reduced(x)[1][1] == np.inf and reduced(-x)[1][2] == -np.inf


@kernel
def roots(x, out):
    store(out, 0, sqrt(load(x, 0)))
    out[LANES] = sqrt(x[0])
    out[LANES + 1] = largest(x[0])
    out[LANES + 2] = smallest(x[0])


def test_square_root_of_packs_and_of_floats():
    x, out = np.array([2.0, 0.0, 1e-300, 9e300]), np.empty(LANES + 3)
    roots(x, out)
    np.testing.assert_array_equal(out, [*np.sqrt(x), np.sqrt(2.0), 2.0, 2.0])


@kernel
def replace_lane(x, index, number, out):
    a = load(x, 0)
    store(out, 0, with_lane(a, index, number))
    store(out, LANES, a)
    store(out, 2 * LANES, spread(number))


@pytest.mark.cases("index", range(LANES))
def test_with_lane_replaces_one_lane_of_a_copy(index):
    out = np.empty(3 * LANES)
    replace_lane(X, index, 42.0, out)
    expected = X.copy()
    expected[index] = 42.0
    np.testing.assert_array_equal(out.reshape(3, LANES), [expected, X, np.full(LANES, 42.0)])
