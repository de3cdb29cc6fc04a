"""Packs inside kernels do what NumPy does on arrays of LANES numbers; structs of the package inside
kernels."""

import copy
import pickle

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
from soft_tendon_env.mechanics.algebra.structs import Struct, struct_at

pytestmark = pytest.mark.no_jit

X = np.array([1.5, -2.25, 1e-300, 3e20])
Y = np.array([-0.75, 4.0, 7e-301, 1e19])


@kernel
def arithmetic(x, y, s, out):
    """Every operator, pack with pack and with a float on either side; one pack of `out` each."""
    a = load(x, 0)
    b = load(y, 0)
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
    s = 3.7
    out = np.full(13 * LANES, np.nan)
    arithmetic(X, Y, s, out)
    expected = [
        X + Y,
        X - Y,
        X * Y,
        X / Y,
        X + s,
        s + X,
        X - s,
        s - X,
        X * s,
        s * X,
        X / s,
        s / X,
        -X,
    ]
    np.testing.assert_array_equal(out.reshape(-1, LANES), expected)


@kernel
def reductions(x, sums, out):
    a = load(x, 0)
    store(sums, 0, prefix_sum(a))
    out[0] = lane_sum(a)
    out[1] = largest(a)
    out[2] = -largest(-a)
    for i in range(LANES):
        out[3 + i] = lane(a, i)


def reduce_pack(x):
    sums = np.empty(LANES)
    out = np.empty(3 + LANES)
    reductions(np.array(x), sums, out)
    return sums, out


@pytest.mark.parametrize("seed", range(3))
def test_sums_and_extremes_agree_with_numpy(seed):
    random = np.random.default_rng(seed)
    x = random.normal(size=LANES)
    sums, out = reduce_pack(x)
    round_off = 4e-16 * np.abs(x).sum()
    expected_sums = np.cumsum(x)
    np.testing.assert_allclose(sums, expected_sums, rtol=0, atol=round_off)
    np.testing.assert_allclose(out[0], x.sum(), rtol=0, atol=round_off)
    expected_out = [x.max(), x.min(), *x]
    np.testing.assert_array_equal(out[1:], expected_out)


@pytest.mark.parametrize("where", range(LANES))
@pytest.mark.parametrize("others", [0.0, np.inf, -np.inf])
def test_extremes_are_nan_if_any_lane_is(where, others):
    x = np.full(LANES, others)
    x[where] = np.nan
    with np.errstate(invalid="ignore"):
        _, out = reduce_pack(x)
    assert np.isnan(out[1])
    assert np.isnan(out[2])


class Inner(Struct):
    values: np.ndarray
    table: np.ndarray


class Outer(Struct):
    count: int
    inner: Inner
    share: float
    places: np.ndarray
    cube: np.ndarray
    free: tuple[int, ...]


def inner(start=0.0):
    return Inner(values=start + np.arange(3.0), table=start + np.arange(6.0).reshape(2, 3))


def outer(**changes):
    fields = {
        "count": 7,
        "inner": inner(),
        "share": 0.25,
        "places": np.array([3, 4]),
        "free": (5, 6),
    }
    fields["cube"] = np.arange(24.0).reshape(2, 3, 4)
    return Outer(**{**fields, **changes})


@kernel
def read(struct, out):
    out[0] = struct.count
    out[1] = struct.inner.values[2]
    out[2] = struct.inner.table[1, 2]
    out[3] = struct.share
    out[4] = struct.places[1]
    out[5] = struct.cube[1, 2, 3] + struct.cube.shape[2]
    out[6] = struct.free[1] + len(struct.free)
    struct.inner.values[0] += 1.0


@kernel
def read_at(like, addresses, i):
    return struct_at(like, addresses, i).inner.values.sum()


@pytest.mark.no_jit
def test_compiled_code_reads_and_fills_the_fields():
    struct = outer()
    out = np.zeros(7)
    read(struct, out)
    np.testing.assert_array_equal(out, [7.0, 2.0, 5.0, 0.25, 4.0, 27.0, 8.0])
    assert struct.inner.values[0] == 1.0


@pytest.mark.no_jit
@pytest.mark.parametrize(
    "copied",
    [copy.deepcopy, lambda struct: pickle.loads(pickle.dumps(struct))],
    ids=["deepcopy", "pickle"],
)
def test_copies_stand_on_their_own(copied):
    struct = outer()
    twin = copied(struct)
    out = np.zeros(7)
    read(twin, out)
    assert struct.inner.values[0] == 0.0
    assert twin.inner.values[0] == 1.0
    assert out[4] == 4.0


@pytest.mark.no_jit
def test_structs_are_found_by_their_addresses():
    structs = [outer(inner=inner(start)) for start in (0.0, 10.0)]
    addresses = np.array([struct.address for struct in structs])
    assert [read_at(structs[0], addresses, i) for i in range(2)] == [3.0, 33.0]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"values": np.zeros(3)}, "Inner should get values, table, not values"),
        (
            {"values": np.zeros(3), "table": np.zeros((2, 2)), "more": 1},
            "Inner should get values, table, not values, table, more",
        ),
        (
            {"values": np.zeros(3, dtype=np.float32), "table": np.zeros((2, 2))},
            "Inner.values should be a contiguous array of float64",
        ),
        (
            {"values": np.zeros(6)[::2], "table": np.zeros((2, 2))},
            "Inner.values should be a contiguous array.* not a strided one",
        ),
        ({"values": "text", "table": np.zeros((2, 2))}, "Inner.values should be .* not 'text'"),
        (
            {"values": (1, 2.5), "table": np.zeros((2, 2))},
            r"Inner.values .* a tuple of int alone or of float alone, .* not \(1, 2.5\)",
        ),
    ],
    ids=["missing", "too many", "float32", "strided", "text", "mixed"],
)
def test_what_compiled_code_could_not_read_is_refused(fields, message):
    with pytest.raises(TypeError, match=message):
        Inner(**fields)


def test_fields_are_not_replaced():
    with pytest.raises(AttributeError, match=r"Inner.values cannot be replaced: fill the array"):
        inner().values = np.zeros(3)
