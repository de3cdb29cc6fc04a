"""SIMD packs: LANES neighbouring numbers that one processor instruction handles together.

The quadrature points of a rod all undergo the same arithmetic, so the kernels take LANES of them at
once. Inside compiled code a pack is a machine vector: it supports `+ - * /` with packs and with
floats, and the functions below. A kernel written on packs reads like a kernel written on numbers,
and works on plain floats too (that is how the scalar functions of `lie` are made). Without the
compiler (NUMBA_DISABLE_JIT=1) a pack is a NumPy array of shape (LANES,) and the same code runs.
"""

import math
import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, models, overload, register_model, type_callable

LANES = 4
WIDE = 2 * LANES
"""Numbers of a wide pack, of which sums of products take two packs at once: one instruction on
processors of 512 bits, two on others."""

LINE = 64  # bytes of a cache line

_FLAGS = ("contract",)  # a * b + c may become one fused instruction


class Pack(types.Type):
    """Numba type of neighbouring float64."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"Pack{lanes}")
        self.lanes, self.vector = lanes, ir.VectorType(ir.DoubleType(), lanes)


pack, wide = Pack(LANES), Pack(WIDE)


@register_model(Pack)
class PackModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.vector)


def _shuffled(builder, one, other, lanes):
    return builder.shuffle_vector(
        one, other, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
    )


def _splat(builder, number, kind):
    undefined = ir.Constant(kind.vector, ir.Undefined)
    vector = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return _shuffled(builder, vector, undefined, [0] * kind.lanes)


def _register_operator(python_operator, instruction):
    @type_callable(python_operator)
    def type_packs(context):
        def signature_of(one, other):
            kinds = {of for of in (one, other) if isinstance(of, Pack)}
            if len(kinds) == 1:  # else it is no matter of packs
                (kind,) = kinds
                return kind(*(of if of == kind else types.float64 for of in (one, other)))

        return signature_of

    def emit(context, builder, sig, args):
        kind, given = sig.return_type, zip(sig.args, args, strict=True)
        packs = (value if of == kind else _splat(builder, value, kind) for of, value in given)
        return getattr(builder, instruction)(*packs, flags=_FLAGS)

    for kind in (pack, wide):
        for given in ((kind, kind), (kind, types.float64), (types.float64, kind)):
            lower_builtin(python_operator, *given)(emit)


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register_operator(_operator, _instruction)


@type_callable(operator.neg)
def _type_negation(context):
    return lambda value: value if value == pack else None


@lower_builtin(operator.neg, pack)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0], flags=_FLAGS)


def aligned_zeros(*shape, dtype=np.float64):
    """Zeros, of eight bytes each, that begin where a cache line does: packs that lie across two
    lines take twice as long."""
    size = math.prod(shape)
    room = np.zeros(size + LINE // 8, dtype=dtype)
    start = -room.ctypes.data % LINE // 8
    return room[start : start + size].reshape(shape)


def aligned_copy(values):
    """Copy of an array that begins where a cache line does, see aligned_zeros()."""
    copy = aligned_zeros(*values.shape, dtype=values.dtype)
    copy[...] = values
    return copy


def load(array, index):
    """Pack of array[index : index + LANES] of a contiguous float64 vector."""
    return array[index : index + LANES].copy()


def load_wide(array, index):
    """Wide pack of array[index : index + WIDE] of a contiguous float64 vector."""
    return array[index : index + WIDE].copy()


def store(array, index, value):
    """Write a pack to array[index : index + LANES]."""
    array[index : index + LANES] = value


def spread(number):
    """Pack whose lanes all hold one number."""
    return np.full(LANES, number)


def spread_wide(number):
    """Wide pack whose lanes all hold one number."""
    return np.full(WIDE, number)


def lane(value, index):
    """Number in one lane of a pack."""
    return value[index]


def prefix_sum(value):
    """Running sums over the lanes: lane i of the result is the sum of lanes 0..i."""
    return np.cumsum(value)


def lane_sum(value):
    """The sum over the lanes, a float."""
    return np.sum(value)


def lane_sums(values):
    """The pack of the sums over the lanes of LANES packs, wide or not."""
    return np.array([np.sum(value) for value in values])


def sqrt(value):
    """Square root of a float or, lane by lane, of a pack."""
    return np.sqrt(value)


def largest(value):
    """The largest lane of a pack, or the float itself; NaN if any lane is NaN."""
    return np.max(value)


def with_lane(value, index, number):
    """The pack with one lane replaced."""
    replaced = value.copy()
    replaced[index] = number
    return replaced


def _emits(function, typed):
    """Decorator: the machine code of a function in kernels, where `typed` makes a signature of the
    types of its arguments, or None."""

    def register(emit):
        type_callable(function)(lambda context: typed)
        lower_builtin(function, types.VarArg(types.Any))(emit)
        return emit

    return register


def _place_in(context, builder, sig, args, kind):
    data = context.data_model_manager[sig.args[0]].get(builder, args[0], "data")
    return builder.bitcast(builder.gep(data, [args[1]]), kind.vector.as_pointer())


@_emits(load, lambda array, index: pack(array, types.intp))
@_emits(load_wide, lambda array, index: wide(array, types.intp))
def _load(context, builder, sig, args):
    return builder.load(_place_in(context, builder, sig, args, sig.return_type), align=8)


@_emits(
    store,
    lambda array, index, value: (
        types.void(array, types.intp, value) if isinstance(value, Pack) else None
    ),
)
def _store(context, builder, sig, args):
    builder.store(args[2], _place_in(context, builder, sig, args, sig.args[2]), align=8)
    return context.get_dummy_value()


@_emits(spread, lambda number: pack(types.float64))
@_emits(spread_wide, lambda number: wide(types.float64))
def _spread(context, builder, sig, args):
    return _splat(builder, args[0], sig.return_type)


@_emits(lane, lambda value, index: types.float64(value, types.intp) if value == pack else None)
def _lane(context, builder, sig, args):
    return builder.extract_element(*args)


@_emits(
    with_lane,
    lambda value, index, number: value(value, types.intp, types.float64) if value == pack else None,
)
def _with_lane(context, builder, sig, args):
    return builder.insert_element(args[0], args[2], args[1])


@_emits(prefix_sum, lambda value: value(value) if value == pack else None)
def _prefix_sum(context, builder, sig, args):
    zero, total, step = ir.Constant(pack.vector, [0.0] * LANES), args[0], 1
    while step < LANES:
        total = builder.fadd(
            total, _shuffled(builder, zero, total, [i + LANES - step for i in range(LANES)])
        )
        step *= 2
    return total


@_emits(lane_sum, lambda value: types.float64(value) if value == pack else None)
def _lane_sum(context, builder, sig, args):
    return builder.extract_element(
        _prefix_sum(context, builder, sig, args), ir.Constant(ir.IntType(32), LANES - 1)
    )


@_emits(
    lane_sums,
    lambda values: (
        pack(values)
        if isinstance(values, types.UniTuple) and isinstance(values.dtype, Pack)
        else None
    ),
)
def _lane_sums(context, builder, sig, args):
    packs, size = cgutils.unpack_tuple(builder, args[0]), 1
    if sig.args[0].dtype == wide:  # its halves are added
        packs = [
            builder.fadd(
                *(_shuffled(builder, of, of, [*range(at, at + LANES)]) for at in (0, LANES))
            )
            for of in packs
        ]
    while size < LANES:  # pairs of packs are added, with blocks of each in turn, until one is left
        even = [
            start + of + i
            for start in range(0, LANES, 2 * size)
            for of in (0, LANES)
            for i in range(size)
        ]
        pairs = zip(packs[::2], packs[1::2], strict=True)
        packs = [
            builder.fadd(
                _shuffled(builder, *pair, even), _shuffled(builder, *pair, [i + size for i in even])
            )
            for pair in pairs
        ]
        size *= 2
    return packs[0]


@_emits(sqrt, lambda value: value(value) if value == pack else types.float64(types.float64))
def _sqrt(context, builder, sig, args):
    kind, name = args[0].type, f"v{LANES}f64" if sig.return_type == pack else "f64"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.{name}"
    )
    return builder.call(function, args)


@overload(largest)
def _largest_overload(value):
    if not isinstance(value, Pack):
        return lambda value: value

    def pick(value):
        found = lane(value, 0)
        for i in range(1, LANES):
            number = lane(value, i)
            if found == found and not number <= found:  # a NaN stays
                found = number
        return found

    return pick
