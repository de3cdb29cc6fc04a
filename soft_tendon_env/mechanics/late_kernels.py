"""Kernels that only arms with effects come to, called by their addresses: each is compiled when an arm is made whose effects need it.

A call of one kernel by another makes numba compile both. What arms with effects need is a fifth of the mechanics, so it is called as the
effects' own kernels are, by addresses in the arm's `EffectTable`.
"""

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.core.errors import TypingError
from numba.extending import intrinsic

from soft_tendon_env.compiler.numba_internals import address_of, emit_call_at
from soft_tendon_env.mechanics.effects import EffectTable

LATE = {
    "external_force": "terms.external_forces",
    "add_implicit": "terms.external_forces",
    "move_base": "terms.external_forces",
    "remember": "terms.external_forces",
    "arrive": "terms.command_filter",
    "transmit": "terms.transmission",
    "stretch_tendons": "motion.elastic_tendons",
    "slide_tendons": "motion.sliding_tendons",
    "find_longest": "motion.advance",
    "begin_limits": "motion.advance",
}
"""Their names, in the order of their addresses in `EffectTable.late`, and the modules that have them."""


class Late(NamedTuple):
    """A kernel that some effects need, and examples of its arguments for an arm."""

    kernel: Any
    is_needed: Callable[[EffectTable], Any]
    arguments: Callable[[Any], tuple[Any, ...]]


_KERNELS: dict[str, Late] = {}
_ADDRESSES: dict[tuple[Any, frozenset[str]], np.ndarray] = {}
_COMPILED: dict[tuple[str, types.Type], tuple[types.Type, ...]] = {}
"""Types of the arguments for which they are compiled, by name and the first of them."""


def late(is_needed: Callable[[EffectTable], Any], arguments: Callable[[Any], tuple[Any, ...]]) -> Callable[[Any], Any]:
    """Decorator of a kernel of LATE, which returns nothing: whether effects need it, and examples of its arguments for an arm."""

    def register(kernel: Any) -> Any:
        _KERNELS[kernel.__name__] = Late(kernel, is_needed, arguments)
        return kernel

    return register


def late_addresses(arm: Any) -> np.ndarray:
    """Addresses (LATE) of the kernels that an arm's effects need, 0 for the others; compiles them when needed."""
    if len(_KERNELS) < len(LATE):
        for module in LATE.values():
            importlib.import_module(f"{__package__}.{module}")
    needed = frozenset(name for name, own in _KERNELS.items() if own.is_needed(arm.effects))
    key = numba.typeof(arm), needed
    if key not in _ADDRESSES:
        _ADDRESSES[key] = np.array([_address(name, arm) if name in needed else 0 for name in LATE], dtype=np.int64)
    return _ADDRESSES[key]


def _address(name: str, arm: Any) -> int:
    kernel, _, arguments = _KERNELS[name]
    given = tuple(numba.typeof(value) for value in arguments(arm))
    _COMPILED[name, given[0]] = given
    kernel.compile(given)
    return address_of(kernel.overloads[given])


def call_late(kernel, addresses, arguments):
    """Call a kernel of LATE by its place in `EffectTable.late` with a tuple of arguments."""
    kernel(*arguments)


@intrinsic
def _call_late(typingctx, kernel, addresses, arguments):
    name, given_types = kernel.dispatcher.py_func.__name__, tuple(arguments.types)
    place, compiled = [*LATE].index(name), _COMPILED.get((name, given_types[0]), given_types)
    if compiled != given_types:
        raise TypingError(f"{name} is compiled for arguments of the types {compiled}, not {given_types}: see its @late")

    def emit(context, builder, signature, given):
        numbers = context.make_array(addresses)(context, builder, given[1]).data
        address = builder.load(builder.gep(numbers, [ir.Constant(ir.IntType(64), place)]))
        return emit_call_at(context, builder, address, given_types, cgutils.unpack_tuple(builder, given[2]))

    return types.none(kernel, addresses, arguments), emit


if not config.DISABLE_JIT:
    call_late = _call_late
