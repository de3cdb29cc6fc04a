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
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, overload, register_model

LANES = 4

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_FLAGS = ("contract",)  # a * b + c may become one fused instruction


class Pack(types.Type):
    """Numba type of LANES float64."""

    def __init__(self) -> None:
        super().__init__(name=f"Pack{LANES}")


pack = Pack()


@register_model(Pack)
class PackModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR)


def _splat(builder, number):
    vector = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, ir.Constant(_VECTOR, ir.Undefined), mask)


def _register_operator(python_operator, instruction):
    class PackOperator(ConcreteTemplate):
        cases = [signature(pack, pack, pack), signature(pack, pack, types.float64), signature(pack, types.float64, pack)]

    infer_global(python_operator)(PackOperator)

    def emit(builder, left, right):
        return getattr(builder, instruction)(left, right, flags=_FLAGS)

    @lower_builtin(python_operator, pack, pack)
    def both(context, builder, sig, args):
        return emit(builder, *args)

    @lower_builtin(python_operator, pack, types.float64)
    def left_only(context, builder, sig, args):
        return emit(builder, args[0], _splat(builder, args[1]))

    @lower_builtin(python_operator, types.float64, pack)
    def right_only(context, builder, sig, args):
        return emit(builder, _splat(builder, args[0]), args[1])


for _operator, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")):
    _register_operator(_operator, _instruction)


@infer_global(operator.neg)
class PackNegation(ConcreteTemplate):
    cases = [signature(pack, pack)]


@lower_builtin(operator.neg, pack)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0], flags=_FLAGS)


def _pack_pointer(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def _load(typingctx, array, index):
    def codegen(context, builder, sig, args):
        return builder.load(_pack_pointer(context, builder, sig.args[0], *args), align=8)

    return pack(array, types.intp), codegen


@intrinsic
def _store(typingctx, array, index, value):
    def codegen(context, builder, sig, args):
        builder.store(args[2], _pack_pointer(context, builder, sig.args[0], *args[:2]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, pack), codegen


@intrinsic
def _spread(typingctx, number):
    def codegen(context, builder, sig, args):
        return _splat(builder, args[0])

    return pack(types.float64), codegen


@intrinsic
def _sqrt(typingctx, value):
    def codegen(context, builder, sig, args):
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_VECTOR, [_VECTOR]), f"llvm.sqrt.v{LANES}f64")
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
        zero, total, step = ir.Constant(_VECTOR, [0.0] * LANES), args[0], 1
        while step < LANES:
            mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [i + LANES - step for i in range(LANES)])
            total = builder.fadd(total, builder.shuffle_vector(zero, total, mask))
            step *= 2
        return total

    return pack(pack), codegen


def load(array, index):
    """The pack array[index : index + LANES] of a contiguous float64 vector."""
    return array[index : index + LANES].copy()


def store(array, index, value):
    """Write a pack to array[index : index + LANES]."""
    array[index : index + LANES] = value


def spread(number):
    """The pack whose lanes all hold one number."""
    return np.full(LANES, number)


def lane(value, index):
    """One number of a pack."""
    return value[index]


def prefix_sum(value):
    """Lane i of the result is the sum of lanes 0..i."""
    return np.cumsum(value)


def lane_sum(value):
    """The sum over the lanes, a float."""
    return np.sum(value)


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


def _is_pack(value):
    return isinstance(value, Pack)


@overload(load)
def _load_overload(array, index):
    return lambda array, index: _load(array, index)


@overload(store)
def _store_overload(array, index, value):
    if _is_pack(value):
        return lambda array, index, value: _store(array, index, value)


@overload(spread)
def _spread_overload(number):
    return lambda number: _spread(number)


@overload(lane)
def _lane_overload(value, index):
    if _is_pack(value):
        return lambda value, index: _lane(value, index)


@overload(prefix_sum)
def _prefix_sum_overload(value):
    if _is_pack(value):
        return lambda value: _prefix_sum(value)


@overload(lane_sum)
def _lane_sum_overload(value):
    if _is_pack(value):
        return lambda value: _lane(_prefix_sum(value), LANES - 1)


@overload(sqrt)
def _sqrt_overload(value):
    if _is_pack(value):
        return lambda value: _sqrt(value)
    return lambda value: math.sqrt(value)


@overload(largest)
def _largest_overload(value):
    if not _is_pack(value):
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


@overload(with_lane)
def _with_lane_overload(value, index, number):
    if _is_pack(value):
        return lambda value, index, number: _with_lane(value, index, number)
