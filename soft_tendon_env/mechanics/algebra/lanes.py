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
"""Numbers of a pack."""
WIDE = 2 * LANES
"""Numbers of a wide pack, of which sums of products take two packs at once: one instruction on
processors of 512 bits, two on others."""

LINE = 64  # bytes of a cache line

_FLAGS = ("contract",)  # a * b + c may become one fused instruction


class Pack(types.Type):
    """Numba type of neighbouring float64."""

    def __init__(self, lanes: int) -> None:
        super().__init__(name=f"Pack{lanes}")
        self.lanes = lanes
        self.vector = ir.VectorType(ir.DoubleType(), lanes)


pack = Pack(LANES)
wide = Pack(WIDE)


@register_model(Pack)
class PackModel(models.PrimitiveModel):
    """Data model of packs: the vector type of LLVM."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, fe_type.vector)


def _shuffled(builder, first, second, lanes):
    """Vector of these lanes of two vectors, those of the second one after those of the first."""
    kind = ir.VectorType(ir.IntType(32), len(lanes))
    return builder.shuffle_vector(first, second, ir.Constant(kind, lanes))


def _splat(builder, number, kind):
    undefined = ir.Constant(kind.vector, ir.Undefined)
    lane_0 = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(undefined, number, lane_0)
    return _shuffled(builder, vector, undefined, [0] * kind.lanes)


def _register_operator(python_operator, instruction):
    """Machine code of an operator on packs of a kind, or a pack and a float."""

    @type_callable(python_operator)
    def type_packs(context):
        return _signature_of_packs

    def emit(context, builder, sig, args):
        kind = sig.return_type
        operands = []
        for operand_type, value in zip(sig.args, args, strict=True):
            is_pack = operand_type == kind
            operands.append(value if is_pack else _splat(builder, value, kind))
        return getattr(builder, instruction)(*operands, flags=_FLAGS)

    for kind in (pack, wide):
        lower_builtin(python_operator, kind, kind)(emit)
        lower_builtin(python_operator, kind, types.float64)(emit)
        lower_builtin(python_operator, types.float64, kind)(emit)


def _signature_of_packs(left, right):
    """Signature of an operator, None where it has no packs, or packs of two kinds."""
    operands = (left, right)
    kinds = {operand for operand in operands if isinstance(operand, Pack)}
    if len(kinds) != 1:
        return None
    (kind,) = kinds
    return kind(*(kind if operand == kind else types.float64 for operand in operands))


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
    """Zeros, of eight bytes each, that begin where a cache line does.

    Packs that lie across two lines take twice as long.
    """
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
    """Registers the machine code of a function in kernels: a decorator.

    `typed` makes a signature of the types of its arguments, or None.
    """

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
    zero = ir.Constant(pack.vector, [0.0] * LANES)
    total = args[0]
    step = 1
    # sums over 2, 4, ... lanes up to each: zeros, of the first vector, move in from below
    while step < LANES:
        lanes = [i + LANES - step for i in range(LANES)]
        total = builder.fadd(total, _shuffled(builder, zero, total, lanes))
        step *= 2
    return total


@_emits(lane_sum, lambda value: types.float64(value) if value == pack else None)
def _lane_sum(context, builder, sig, args):
    last = ir.Constant(ir.IntType(32), LANES - 1)
    return builder.extract_element(_prefix_sum(context, builder, sig, args), last)


@_emits(
    lane_sums,
    lambda values: (
        pack(values)
        if isinstance(values, types.UniTuple) and isinstance(values.dtype, Pack)
        else None
    ),
)
def _lane_sums(context, builder, sig, args):
    packs = cgutils.unpack_tuple(builder, args[0])
    if sig.args[0].dtype == wide:
        packs = [_sum_of_halves(builder, vector) for vector in packs]
    # pairs of packs are added, with blocks of each in turn, until one pack is left
    size = 1
    while size < LANES:
        even, odd = _blocks_in_turn(size)
        pairs = zip(packs[::2], packs[1::2], strict=True)
        packs = [
            builder.fadd(
                _shuffled(builder, first, second, even),
                _shuffled(builder, first, second, odd),
            )
            for first, second in pairs
        ]
        size *= 2
    return packs[0]


def _sum_of_halves(builder, vector):
    """Sum, a pack, of the two halves of a wide pack."""
    lower = _shuffled(builder, vector, vector, [*range(LANES)])
    upper = _shuffled(builder, vector, vector, [*range(LANES, WIDE)])
    return builder.fadd(lower, upper)


def _blocks_in_turn(size):
    """Lanes of two packs, block by block in turn, and the blocks in between.

    They are every other block of `size` lanes of the first one and of the second one.
    """
    even = []
    for start in range(0, LANES, 2 * size):
        for offset in (0, LANES):
            even += range(start + offset, start + offset + size)
    return even, [lane + size for lane in even]


@_emits(sqrt, lambda value: value(value) if value == pack else types.float64(types.float64))
def _sqrt(context, builder, sig, args):
    kind = args[0].type
    name = f"v{LANES}f64" if sig.return_type == pack else "f64"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.{name}"
    )
    return builder.call(function, args)


@overload(largest)
def _largest_overload(value):
    if not isinstance(value, Pack):
        return lambda value: value

    def pick(value):
        most = lane(value, 0)
        for i in range(1, LANES):
            number = lane(value, i)
            is_nan = most != most  # it stays
            if not is_nan and not number <= most:
                most = number
        return most

    return pick
