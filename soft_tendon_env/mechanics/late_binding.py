"""Kernels that are compiled when they are first called, not with those that call them: for what most arms never come to.

A call of one kernel by another makes numba compile both. What an arm needs that has effects is a fifth of the mechanics, so it is called
through a slot of its caller's machine code, which holds an address from the first call on.
"""

import _thread
import ctypes
import hashlib
import importlib
import threading
from typing import Any, NamedTuple

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic

from soft_tendon_env.compiler.numba_internals import IS_TESTED, cache_of, compile_inside, emit_call_at, link_with

RESOLVER = "soft_tendon_env/resolve_late_kernel"
"""The symbol by which machine code asks for an address."""
AFTER_RETURN = 0.01  # [s]
_ADDRESS, _KEY = ir.IntType(64), ir.IntType(8).as_pointer()


class Late(NamedTuple):
    """A kernel for arguments of these types, to be compiled later; called where machine code is loaded that may come to ask for it."""

    module: str
    kernel: str
    arguments: tuple[Any, ...]
    key: str  # by which machine code asks

    def __call__(self) -> None:
        _KNOWN[self.key.encode()] = self

    def address(self) -> int:
        """Where the kernel is, compiled now at the latest."""
        dispatcher = getattr(importlib.import_module(self.module), self.kernel)
        compile_inside(dispatcher, self.arguments)
        return int(binding.address_of_symbol(cache_of(dispatcher).symbol(self.arguments, dispatcher.targetctx)))


_KNOWN: dict[bytes, Late] = {}


@ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.POINTER(ctypes.c_int64))
def _resolve(key, slot):
    """Write the address of a kernel into the slot that waits for it; what goes wrong is printed by ctypes, and leaves the slot empty."""
    try:
        slot[0] = _KNOWN[key].address()
    except KeyboardInterrupt:
        threading.Timer(AFTER_RETURN, _thread.interrupt_main).start()  # nothing that is raised here gets through machine code
        raise


@intrinsic
def _call_late(typingctx, function, arguments):
    dispatcher, given_types = function.dispatcher, tuple(arguments.types)

    def emit(context, builder, signature, given):
        own, symbol = dispatcher.py_func, cache_of(dispatcher).symbol(given_types, context)
        key = hashlib.sha256(symbol.encode()).hexdigest()[:32]
        late = Late(own.__module__, own.__qualname__, given_types, key)
        late()
        link_with(context, late)
        slot = builder.module.globals.get(key) or cgutils.add_global_variable(builder.module, _ADDRESS, key)
        slot.linkage, slot.initializer = "internal", _ADDRESS(0)
        with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", builder.load(slot), _ADDRESS(0))):
            kind = ir.FunctionType(ir.VoidType(), [_KEY, _ADDRESS.as_pointer()])
            resolver = cgutils.get_or_insert_function(builder.module, kind, RESOLVER)
            builder.call(resolver, [context.insert_const_string(builder.module, key), slot])
        address = builder.load(slot)
        with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", address, _ADDRESS(0))):
            context.call_conv.return_user_exc(builder, RuntimeError, (f"{own.__name__} could not be compiled",))
        return emit_call_at(context, builder, address, given_types, cgutils.unpack_tuple(builder, given[1]))

    return types.none(function, arguments), emit


def call_late(function, arguments):
    """Call a kernel that returns nothing with a tuple of arguments; it is compiled when that happens first."""
    function(*arguments)


@intrinsic
def _call_at_once(typingctx, function, arguments):
    called = function.get_call_type(typingctx, arguments.types, {})

    def emit(context, builder, signature, given):
        call = context.get_function(function, called)
        call(builder, cgutils.unpack_tuple(builder, given[1]))
        context.add_linking_libs(getattr(call, "libs", ()))
        return context.get_dummy_value()

    return types.none(function, arguments), emit


if IS_TESTED and not config.DISABLE_JIT:
    binding.add_symbol(RESOLVER, ctypes.cast(_resolve, ctypes.c_void_p).value)
    call_late = _call_late
elif not config.DISABLE_JIT:
    call_late = _call_at_once
