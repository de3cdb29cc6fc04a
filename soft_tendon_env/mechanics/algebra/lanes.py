"""SIMD packs: LANES neighbouring numbers that one processor instruction handles together.

The quadrature points of a rod all undergo the same arithmetic, so the kernels take LANES of them at once. Inside compiled
code a pack is a machine vector: it supports `+ - * /` with packs and with floats, and the functions below. A kernel written
on packs reads like a kernel written on numbers, and works on plain floats too (that is how the scalar functions of `lie` are
made). Without the compiler (NUMBA_DISABLE_JIT=1) a pack is a NumPy array of shape (LANES,) and the same code runs.
"""

import math
import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, lower_builtin, models, overload, register_model, type_callable

LANES = 4
WIDE = 2 * LANES
"""Numbers of a wide pack, of which sums of products take two packs at once: one instruction on processors of 512 bits, two on others."""

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
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes))


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


for _operator, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")):
    _register_operator(_operator, _instruction)


@type_callable(operator.neg)
def _type_negation(context):
    return lambda value: value if value == pack else None


@lower_builtin(operator.neg, pack)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0], flags=_FLAGS)


def _pack_pointer(context, builder, array_type, array, index, kind):
    data = context.data_model_manager[array_type].get(builder, array, "data")
    return builder.bitcast(builder.gep(data, [index]), kind.vector.as_pointer())


def _loaded(context, builder, sig, args):
    return builder.load(_pack_pointer(context, builder, sig.args[0], *args, sig.return_type), align=8)


@intrinsic
def _load(typingctx, array, index):
    return pack(array, types.intp), _loaded


@intrinsic
def _load_wide(typingctx, array, index):
    return wide(array, types.intp), _loaded


@intrinsic
def _store(typingctx, array, index, value):
    def codegen(context, builder, sig, args):
        builder.store(args[2], _pack_pointer(context, builder, sig.args[0], *args[:2], sig.args[2]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, pack), codegen


def _spread_out(context, builder, sig, args):
    return _splat(builder, args[0], sig.return_type)


@intrinsic
def _spread(typingctx, number):
    return pack(types.float64), _spread_out


@intrinsic
def _spread_wide(typingctx, number):
    return wide(types.float64), _spread_out


@intrinsic
def _folded(typingctx, value):
    def codegen(context, builder, sig, args):
        halves = (_shuffled(builder, args[0], args[0], [*range(start, start + LANES)]) for start in (0, LANES))
        return builder.fadd(*halves)

    return pack(wide), codegen


@intrinsic
def _sqrt(typingctx, value):
    def codegen(context, builder, sig, args):
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(pack.vector, [pack.vector]), f"llvm.sqrt.v{LANES}f64")
        return builder.call(function, args)

    return pack(pack), codegen


@intrinsic
def _lane(typingctx, value, index):
    def codegen(context, builder, sig, args):
        return builder.extract_element(args[0], args[1])

    return types.float64(pack, types.intp), codegen


@intrinsic
def _with_lane(typingctx, value, index, number):
    def codegen(context, builder, sig, args):
        return builder.insert_element(args[0], args[2], args[1])

    return pack(pack, types.intp, types.float64), codegen


@intrinsic
def _prefix_sum(typingctx, value):
    def codegen(context, builder, sig, args):
        zero, total, step = ir.Constant(pack.vector, [0.0] * LANES), args[0], 1
        while step < LANES:
            total = builder.fadd(total, _shuffled(builder, zero, total, [i + LANES - step for i in range(LANES)]))
            step *= 2
        return total

    return pack(pack), codegen


@intrinsic
def _lane_sums(typingctx, values):
    def codegen(context, builder, sig, args):
        packs, size = cgutils.unpack_tuple(builder, args[0]), 1
        while size < LANES:  # pairs of packs are added, with blocks of each in turn, until one is left
            even = [start + of + i for start in range(0, LANES, 2 * size) for of in (0, LANES) for i in range(size)]
            odd = [i + size for i in even]
            pairs = zip(packs[::2], packs[1::2], strict=True)
            packs = [builder.fadd(_shuffled(builder, *pair, even), _shuffled(builder, *pair, odd)) for pair in pairs]
            size *= 2
        return packs[0]

    return pack(values), codegen


def aligned_zeros(*shape, dtype=np.float64):
    """Zeros, of eight bytes each, that begin where a cache line does: packs that lie across two lines take twice as long."""
    size = math.prod(shape)
    room = np.zeros(size + LINE // 8, dtype=dtype)
    start = -room.ctypes.data % LINE // 8
    return room[start : start + size].reshape(shape)


def aligned(values):
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


def smallest(value):
    """The smallest lane of a pack, or the float itself; NaN if any lane is NaN."""
    return -largest(-value)


def with_lane(value, index, number):
    """The pack with one lane replaced."""
    replaced = value.copy()
    replaced[index] = number
    return replaced


def _compiled_as(function, intrinsic, place=None):
    """Has kernels take an intrinsic for a function, if its argument at this place is a pack."""

    @overload(function)
    def _select(*given):
        if place is None or isinstance(given[place], Pack):
            return lambda *given: intrinsic(*given)


_compiled_as(load, _load)
_compiled_as(load_wide, _load_wide)
_compiled_as(store, _store, 2)
_compiled_as(spread, _spread)
_compiled_as(spread_wide, _spread_wide)
_compiled_as(lane, _lane, 0)
_compiled_as(prefix_sum, _prefix_sum, 0)
_compiled_as(with_lane, _with_lane, 0)


@overload(lane_sum)
def _lane_sum_overload(value):
    if value == pack:
        return lambda value: _lane(_prefix_sum(value), LANES - 1)


@overload(lane_sums)
def _lane_sums_overload(values):
    if values == types.UniTuple(wide, LANES):
        return lambda values: _lane_sums((_folded(values[0]), _folded(values[1]), _folded(values[2]), _folded(values[3])))
    if values == types.UniTuple(pack, LANES):
        return lambda values: _lane_sums(values)


@overload(sqrt)
def _sqrt_overload(value):
    if isinstance(value, Pack):
        return lambda value: _sqrt(value)
    return lambda value: math.sqrt(value)


@overload(largest)
def _largest_overload(value):
    if not isinstance(value, Pack):
        return lambda value: value

    def pick(value):
        found = _lane(value, 0)
        for i in range(1, LANES):
            number = _lane(value, i)
            if found == found and not number <= found:  # a NaN stays
                found = number
        return found

    return pick


@overload(smallest)
def _smallest_overload(value):
    return lambda value: -largest(-value)
