"""Structs that kernels get by reference, in place of named tuples.

One address stands for the fields of a tuple, with size and strides of every array.

A named tuple of thirty arrays is two hundred machine words, copied at every call from kernel to
kernel; a `Struct` is one word. Compiled code reads its fields by name, `work.xi`. Without the
compiler it is a plain object.
"""

import functools
import hashlib
from collections.abc import Iterator
from typing import Any, Self
from weakref import WeakValueDictionary

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate  # which infer_getattr asks for
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    overload,
    register_model,
    typeof_impl,
    unbox,
)

_WORD = ir.IntType(64)
_NUMBER = ir.DoubleType()

_INTERPRETED: WeakValueDictionary[int, "Struct"] = WeakValueDictionary()
"""Structs by their addresses, where nothing is compiled."""


class Struct:
    """Struct of named fields that compiled code reads at an address.

    A subclass annotates the fields: numbers (bool, int, float), tuples of int or of float,
    contiguous arrays of float64 or int64, and structs. Arrays are filled, fields never replaced;
    `replaced` makes another struct.

    Args:
        values: fields in their order.
        fields: fields by name.

    Raises:
        TypeError: where names or values are not as they should be.
    """

    def __init__(self, *values: Any, **fields: Any) -> None:
        """Lays out the fields."""
        names = self.names()
        given = {**dict(zip(names, values, strict=False)), **fields}
        if len(values) + len(fields) != len(names) or sorted(given) != sorted(names):
            raise TypeError(
                f"{type(self).__name__} should get {', '.join(names)}, not"
                f" {', '.join([*map(repr, values), *fields])}"
            )
        self._lay_out({name: given[name] for name in names})

    @classmethod
    @functools.cache
    def names(cls) -> tuple[str, ...]:
        """Returns the names of the fields, those of base classes first.

        A property takes the place of a base's field.

        Returns:
            Names in the order of the fields.
        """
        annotated = dict.fromkeys(
            name for base in reversed(cls.__mro__) for name in vars(base).get("__annotations__", ())
        )
        return tuple(
            name for name in annotated if not isinstance(getattr(cls, name, None), property)
        )

    def _lay_out(self, fields: dict[str, Any]) -> None:
        words: list[int] = []
        kinds: list[Any] = [type(self)]
        for name, value in fields.items():
            kinds.append(self._write(name, value, words))
        # never written to again, on which compiled code relies
        table = np.array(words, dtype=np.int64)
        self.__dict__.update(fields, _table=table, _address=_data(table), _layout=tuple(kinds))
        if config.DISABLE_JIT:
            _INTERPRETED[self.address] = self

    def _write(self, name: str, value: Any, words: list[int]) -> Any:
        """Append the words of a field; what tells its type."""
        if isinstance(value, np.ndarray) and value.dtype.char in "dl" and value.flags.c_contiguous:
            words += (_data(value), *value.shape)
            return value.dtype.char, value.ndim
        if isinstance(value, Struct):
            words.append(value.address)
            return value.__dict__["_layout"]
        if isinstance(value, int):
            words.append(int(value))
            return bool if isinstance(value, bool) else int
        if isinstance(value, float):
            words.append(int(np.float64(value).view(np.int64)))
            return float
        if isinstance(value, tuple) and all(isinstance(part, int) for part in value):
            words += value
            return int, len(value)
        if isinstance(value, tuple) and all(isinstance(part, float) for part in value):
            words += np.array(value).view(np.int64).tolist()
            return float, len(value)
        raise TypeError(
            f"{type(self).__name__}.{name} should be a contiguous array of float64 or int64, a"
            " tuple of int alone or of float alone, a Struct, or a number, not"
            f" {_described(value)}"
        )

    @property
    def address(self) -> int:
        """Address by which compiled code finds the struct, as long as this object exists."""
        return int(self.__dict__["_address"])

    def fields(self) -> dict[str, Any]:
        """Returns the fields by name.

        Returns:
            Values as they were given.
        """
        return {name: self.__dict__[name] for name in self.names()}

    def __iter__(self) -> Iterator[Any]:
        return iter(self.fields().values())

    def replaced(self, **changes: Any) -> Self:
        """Returns a struct with some fields changed, and the others shared.

        Args:
            changes: values by name of the field.

        Returns:
            The new struct.
        """
        return type(self)(**{**self.fields(), **changes})

    def __getstate__(self) -> dict[str, Any]:
        return self.fields()

    def __setstate__(self, fields: dict[str, Any]) -> None:
        self._lay_out(fields)

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(
            f"{type(self).__name__}.{name} cannot be replaced: fill the array that is there"
        )


def _described(value: Any) -> str:
    """Description of the value that a field was given, for an error."""
    if not isinstance(value, np.ndarray):
        return repr(value)
    return f"one of {value.dtype}" if value.flags.c_contiguous else "a strided one"


class StructType(types.Type):
    """Type of numba of structs of one class whose fields have these types.

    Attributes are as those of its named tuples.
    """

    def __init__(self, kind: type[Struct], fields: tuple[tuple[str, types.Type], ...]) -> None:
        described = f"{kind.__module__}.{kind.__qualname__}{fields}"
        digest = hashlib.sha256(described.encode()).hexdigest()[:16]
        # short: it is part of the name of every function that gets one, which compilers copy and
        # compare
        super().__init__(name=f"{kind.__qualname__}_{digest}")
        self.instance_class = kind
        self.fields = dict(fields)
        self.types = tuple(field for _, field in fields)
        self.slots: dict[str, int] = {}
        slot = 0
        for name, field in fields:
            self.slots[name] = slot
            slot += _size(field)


def _size(field):
    """Words that a field takes."""
    if isinstance(field, types.Array):
        return 1 + field.ndim
    return len(field) if isinstance(field, types.BaseTuple) else 1


def _data(array: np.ndarray) -> int:
    """The address of an array's numbers."""
    return int(array.__array_interface__["data"][0])


_TYPES: dict[tuple[Any, ...], StructType] = {}


@typeof_impl.register(Struct)
def _typeof_struct(value, context):
    attributes = value.__dict__
    if "_numba_type_" not in attributes:
        layout = attributes["_layout"]
        if layout not in _TYPES:
            fields = value.fields().items()
            typed = tuple((name, typeof_impl(field, context)) for name, field in fields)
            _TYPES[layout] = StructType(type(value), typed)
        attributes["_numba_type_"] = _TYPES[layout]  # where numba's dispatchers look first
    return attributes["_numba_type_"]


@register_model(StructType)
class _StructModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _WORD.as_pointer())


@unbox(StructType)
def _unbox_struct(kind, value, context):
    number = context.pyapi.object_getattr_string(value, "_address")
    address = context.pyapi.long_as_longlong(number)
    context.pyapi.decref(number)
    return NativeValue(context.builder.inttoptr(address, _WORD.as_pointer()))


@infer_getattr
class _FieldOfStruct(AttributeTemplate):
    key = StructType

    def generic_resolve(self, kind, name):
        return kind.fields.get(name)


@lower_getattr_generic(StructType)
def _field_of_struct(context, builder, kind, table, name):
    field = kind.fields[name]
    slot = kind.slots[name]

    def word(i, as_type=_WORD):
        place = builder.gep(table, [ir.Constant(_WORD, slot + i)])
        loaded = builder.load(builder.bitcast(place, as_type.as_pointer()))
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    if isinstance(field, StructType):
        return builder.inttoptr(word(0), _WORD.as_pointer())
    if isinstance(field, types.BaseTuple):
        as_type = _NUMBER if field.dtype == types.float64 else _WORD
        return cgutils.pack_array(builder, [word(i, as_type) for i in range(len(field))])
    if field == types.boolean:
        return builder.icmp_unsigned("!=", word(0), _WORD(0))
    if not isinstance(field, types.Array):
        return word(0, _NUMBER if field == types.float64 else _WORD)
    # an array: the address of its numbers, then its shape
    address = context.get_data_type(field.dtype).as_pointer()
    numbers = builder.inttoptr(word(0), address)
    shape = [word(1 + i) for i in range(field.ndim)]
    return array_value(context, builder, field, numbers, shape)


def array_value(context, builder, field, numbers, shape):
    """Compiled code's array of this type, whose numbers are at an address.

    Nobody counts references to it.
    """
    item_size = ir.Constant(_WORD, 8)
    strides = [item_size]
    count = shape[0]
    for size in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], size))
        count = builder.mul(count, size)
    nobody = ir.Constant(ir.IntType(8).as_pointer(), None)
    parts = {
        "meminfo": nobody,
        "parent": nobody,
        "nitems": count,
        "itemsize": item_size,
        "data": numbers,
        "shape": cgutils.pack_array(builder, shape),
        "strides": cgutils.pack_array(builder, strides),
    }
    model = context.data_model_manager[field]
    array = ir.Constant(model.get_value_type(), ir.Undefined)
    for part, value in parts.items():
        array = model.set(builder, array, value, part)
    return array


def struct_at(like, addresses, i):
    """The struct at the i-th of the addresses (m,), of the same type as `like`."""
    return _INTERPRETED[int(addresses[i])]


@intrinsic
def _struct_at(typingctx, like, address):
    def emit(context, builder, signature, given):
        return builder.inttoptr(given[1], _WORD.as_pointer())

    return like(like, types.int64), emit


@overload(struct_at)
def _struct_at_overload(like, addresses, i):
    return lambda like, addresses, i: _struct_at(like, addresses[i])
