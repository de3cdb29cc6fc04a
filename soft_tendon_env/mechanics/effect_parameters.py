"""Parameters of an effect as a row of numbers, so that they may differ from row to row and from episode to episode.

They are a NamedTuple class of its own: float, bool, tuples of floats, `Vector` and `Matrix`. An array stands behind its shape.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple, NewType, get_args, get_origin, get_type_hints

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from soft_tendon_env.mechanics.algebra.structs import array_value

Vector = NewType("Vector", np.ndarray)
"""An array (m,) of numbers."""
Matrix = NewType("Matrix", np.ndarray)
"""An array (m, k) of numbers."""


class Field(NamedTuple):
    """A field of a parameter class: how many axes it has, its type in compiled code, and how many numbers it is unless it is an array."""

    name: str
    axes: int
    kind: types.Type
    numbers: int = 1


def fields_of(kind: type) -> Iterator[Field]:
    """The fields of a parameter class, in their order. Raises TypeError for one of another type than those that are allowed."""
    for name, hint in get_type_hints(kind).items():
        if hint in (float, bool):
            yield Field(name, 0, types.float64 if hint is float else types.boolean)
        elif hint in (Vector, Matrix):
            axes = 1 if hint is Vector else 2
            yield Field(name, axes, types.Array(types.float64, axes, "C"))
        elif get_origin(hint) is tuple and set(get_args(hint)) == {float}:
            count = len(get_args(hint))
            yield Field(name, 0, types.UniTuple(types.float64, count), count)
        else:
            allowed = "float, bool, a tuple of floats, Vector or Matrix"
            raise TypeError(f"{kind.__name__}.{name} is of type {hint}: parameters of an effect should be {allowed}")


def flat(parameters: Any) -> np.ndarray:
    """The numbers of an instance of a parameter class in one row, for `parameters_at` to read. Raises TypeError, ValueError."""
    numbers = [np.zeros(0)]
    for field, value in zip(fields_of(type(parameters)), parameters, strict=True):
        value = np.asarray(value, dtype=np.float64)
        if field.axes:
            if value.ndim != field.axes:
                kind = type(parameters).__name__
                raise TypeError(f"{kind}.{field.name} should be an array with {field.axes} axes, not of shape {value.shape}")
            numbers.append(np.array(value.shape, dtype=np.float64))
        numbers.append(value.ravel())
    return np.concatenate(numbers)


def parameters_at(kind, values):
    """The instance of a parameter class whose numbers begin a row of them; its arrays are parts of the row."""
    found, at = [], 0
    for field in fields_of(kind):
        shape = tuple(int(size) for size in values[at : at + field.axes])
        at, count = at + field.axes, math.prod(shape) if field.axes else field.numbers
        part, at = values[at : at + count], at + count
        if field.axes:
            found.append(part.reshape(shape))
        elif isinstance(field.kind, types.UniTuple):
            found.append(tuple(part))
        else:
            found.append(part[0] != 0.0 if field.kind == types.boolean else part[0])
    return kind(*found)


@intrinsic
def _parameters_at(typingctx, kind, values):
    fields = [*fields_of(kind.instance_class)]
    read = types.BaseTuple.from_types([field.kind for field in fields], kind.instance_class)

    def emit(context, builder, signature, given):
        numbers, at, found = context.make_array(values)(context, builder, given[1]).data, ir.Constant(ir.IntType(64), 0), []
        for field in fields:
            shape = [builder.fptosi(_number(builder, numbers, at, i), at.type) for i in range(field.axes)]
            at = builder.add(at, at.type(field.axes))
            found.append(_value(context, builder, field, builder.gep(numbers, [at]), shape))
            count = at.type(field.numbers)
            for size in shape:
                count = builder.mul(count, size)
            at = builder.add(at, count)
        return context.make_tuple(builder, read, found)

    return read(kind, values), emit


def _value(context, builder, field, numbers, shape):
    """The field whose numbers are at an address, an array of this shape."""
    if field.axes:
        return array_value(context, builder, field.kind, numbers, shape)
    first = [_number(builder, numbers, ir.Constant(ir.IntType(64), 0), i) for i in range(field.numbers)]
    if isinstance(field.kind, types.UniTuple):
        return cgutils.pack_array(builder, first)
    return builder.fcmp_unordered("!=", first[0], ir.Constant(first[0].type, 0.0)) if field.kind == types.boolean else first[0]


def _number(builder, numbers, at, i):
    return builder.load(builder.gep(numbers, [builder.add(at, at.type(i))]))


@overload(parameters_at)
def _parameters_at_overload(kind, values):
    return lambda kind, values: _parameters_at(kind, values)
