"""Effects as the kernels see them: what an effect reads and adds to, its own kernels, their addresses, and how they are called.

The kernels of an effect are compiled by themselves and called through their addresses, which stand in a table of numbers: the mechanics
are compiled once, whatever effects an arm has, and an effect that no scene names is not compiled at all.

The parameters of an effect are a NamedTuple class of its own: float, bool, tuples of floats, `Vector` and `Matrix`. They travel as one row
of numbers, so that they may differ from row to row and from episode to episode; its kernels get them as an instance of the class.
"""

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple, NewType, cast, get_args, get_origin, get_type_hints

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic, overload

from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.tools.code_digest import class_name, selects_code
from soft_tendon_env.tools.compilation import kernel

Vector = NewType("Vector", np.ndarray)
"""An array (m,) of numbers."""
Matrix = NewType("Matrix", np.ndarray)
"""An array (m, k) of numbers."""


class Nodes(NamedTuple):
    """The slices of the rod that the nodes stand for: what an effect reads of them, and what it adds to; layout as in types.py."""

    packs: int
    time: float  # [s]
    state: np.ndarray  # the effect's own internal state
    mass: np.ndarray  # nodes [kg], of the rod and its payload
    inertia: np.ndarray  # nodes x 6, screw inertia about the slice's axes [kg m^2, kg], with what effects add
    pose: np.ndarray  # nodes x 12, R rows, r
    twist: np.ndarray  # nodes x 6, body frame
    base: np.ndarray  # (24) pose of the base, R rows and r; its twist and the rate of that, as in Base
    wrench: np.ndarray  # nodes x 6, body frame, of the whole slice
    stiffness: np.ndarray  # nodes x 21, -d wrench / d displacement, symmetric, its lower triangle by rows: where it is stiff
    damping: np.ndarray  # nodes x 21, -d wrench / d twist: where that is large


class Points(NamedTuple):
    """The sections at the quadrature points: what an effect reads of them, and what it adds to; layout as in types.py."""

    packs: int
    time: float  # [s]
    state: np.ndarray  # the effect's own internal state
    strain: np.ndarray  # points x 6, xi
    rate: np.ndarray  # points x 6, xi_dot
    reference: np.ndarray  # points x 6, xi*
    root_stiffness: np.ndarray  # points x 6, diag(Sigma)^1/2, 0 for a rigid strain
    stress: np.ndarray  # points x 6, moments and forces besides the linear elastic and viscous ones
    stiffness: np.ndarray  # points x 6, the diagonal of d stress / d strain
    damping: np.ndarray  # points x 6, the diagonal of d stress / d rate


class Base(NamedTuple):
    """The base of the arm, which an effect moves."""

    time: float  # [s]
    pose: np.ndarray  # (12) R rows, r; that of the arm at rest to begin with
    twist: np.ndarray  # (6) world frame: angular velocity, and velocity of the point of the base that is at the world's origin
    acceleration: np.ndarray  # (6) its rate


class EffectTable(Struct):
    """The effects of an arm: addresses of their kernels, 0 where there is none, and their numbers.

    The same type whatever the effects. Addresses hold within a process: a copy that is unpickled in another one gets its own.
    """

    count: int
    wrench: np.ndarray  # (count) int64
    stress: np.ndarray
    advance: np.ndarray
    base: np.ndarray
    energy: np.ndarray
    first_value: np.ndarray  # (count + 1) int64, where in `values` the parameters of each begin
    first_state: np.ndarray  # (count + 1) int64
    values: np.ndarray  # parameters of all effects
    state: np.ndarray  # internal states of all effects, in the unloaded arm that has always been at rest

    def __len__(self) -> int:
        return self.count

    def __getstate__(self) -> dict[str, Any]:
        kinds = {hook: [_KINDS.get(int(address)) for address in getattr(self, hook)] for hook in HOOKS}
        return {**super().__getstate__(), **kinds}

    def __setstate__(self, fields: dict[str, Any]) -> None:
        own = {hook: [0 if kind is None else _address(hook, kind) for kind in fields[hook]] for hook in HOOKS}
        super().__setstate__({**fields, **{hook: np.array(row, dtype=np.int64) for hook, row in own.items()}})


HOOKS = ("wrench", "stress", "advance", "base", "energy")
"""What an effect can have kernels for: a wrench at the nodes, stress at the points, an internal state that advances in time, motion of
the base, and the energy that it stores."""

_KERNELS: dict[tuple[str, type], Any] = {}
_ADDRESSES: dict[tuple[str, type], tuple[Any, int]] = {}  # with the kernel that is there
_KINDS: dict[int, type] = {}
_FUNCTIONS: dict[int, Callable[..., None]] = {}  # by address, where nothing is compiled

Decorator = Callable[[Any], Any]


def adds_wrench(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, nodes) of an effect with parameters of this class. It adds to `nodes.wrench`, and where the wrench
    is stiff or damps, to `nodes.stiffness` and `nodes.damping`, see `Nodes`."""
    return _registers("wrench", kind)


def adds_stress(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, points) of an effect. It adds to `points.stress`, and the diagonals of its derivatives to
    `points.stiffness` and `points.damping`, see `Points`."""
    return _registers("stress", kind)


def advances_state(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, step, nodes, points) of an effect with an internal state, `nodes.state` and `points.state` alike.

    It advances the state by a time step [s], from the configuration before the step and the rates after it; a step of infinity leads to
    where the state rests in this configuration.
    """
    return _registers("advance", kind)


def moves_base(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, base) of an effect that moves the base: it sets `base.pose`, `base.twist` and
    `base.acceleration` as they are at `base.time`, see `Base`."""
    return _registers("base", kind)


def stores_energy(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, nodes, energy) of an effect that acts at once and stiffly, as contact does. It adds the energy [J]
    that its wrench stores to `energy` (1,).

    A step at whose end more is stored than the arm could have spent is tried again at half of its length: it went into the obstacle between
    two evaluations.
    """
    return _registers("energy", kind)


def _registers(hook: str, kind: type) -> Decorator:
    def register(function: Any) -> Any:
        _KERNELS[hook, kind] = function
        selects_code(kind, hook, function)
        return function

    return register


def kinds_of(table: EffectTable) -> list[type]:
    """The classes of the parameters of a table's effects, in their order."""
    return [_KINDS[next(int(row[i]) for hook in HOOKS if (row := getattr(table, hook))[i])] for i in range(len(table))]


def has_kernel(kind: type) -> bool:
    """Whether any kernel is registered for parameters of this class."""
    return class_name(kind) is not None


def make_table(parameters: list[Any], states: list[np.ndarray]) -> EffectTable:
    """The table of effects with these parameters and internal states, in their order; compiles their kernels when needed."""
    kernels = {hook: np.array([_address(hook, type(own)) for own in parameters], dtype=np.int64) for hook in HOOKS}
    values = [flat(own) for own in parameters]
    return EffectTable(
        count=len(parameters),
        first_value=np.cumsum([0, *(part.size for part in values)]),
        first_state=np.cumsum([0, *(part.size for part in states)]),
        values=np.concatenate([np.zeros(0), *values]),
        state=np.concatenate([np.zeros(0), *states]),
        **kernels,
    )


def _address(hook: str, kind: type) -> int:
    """The address of the kernel for parameters of this class, 0 where there is none; compiles it when needed."""
    function = _KERNELS.get((hook, kind))
    if function is None:
        return 0
    known, address = _ADDRESSES.get((hook, kind), (None, 0))
    if known is not function:
        address = _bound(hook, kind)
        _ADDRESSES[hook, kind] = function, address
        _KINDS[address] = kind
    return address


def _bound(hook: str, kind: type) -> int:
    caller, arguments = _CALLERS[hook]
    if config.DISABLE_JIT:
        address = len(_FUNCTIONS) + 1
        _FUNCTIONS[address] = lambda *given: caller(kind, *given)
        return address
    signature = (numba.typeof(kind), *(numba.typeof(value) for value in arguments))
    caller.compile(signature)
    compiled = caller.overloads[signature]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def call(address, arguments):
    """Call the kernel at an address with a tuple of arguments."""
    _FUNCTIONS[address](*arguments)


@intrinsic
def _call(typingctx, address, arguments):
    def emit(context, builder, signature, given):
        kinds = (types.voidptr, *signature.args[1].types)  # the class of the parameters is a type alone, and empty
        values = [ir.Constant(cgutils.voidptr_t, None), *cgutils.unpack_tuple(builder, given[1])]
        function = context.call_conv.get_function_type(types.none, kinds)
        pointer = builder.inttoptr(given[0], function.as_pointer())
        status, _ = context.call_conv.call_function(builder, pointer, types.none, kinds, values)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.none(address, arguments), emit


@overload(call)
def _call_overload(address, arguments):
    return lambda address, arguments: _call(address, arguments)


def flat(parameters: Any) -> np.ndarray:
    """The numbers of an instance of a parameter class in one row, for `_reader` to read; arrays with their shapes before them."""
    numbers = [np.zeros(0)]
    for (name, hint), value in zip(get_type_hints(type(parameters)).items(), parameters, strict=True):
        value = np.asarray(value, dtype=np.float64)
        if hint in _DIMENSIONS:
            if value.ndim != _DIMENSIONS[hint]:
                kind = type(parameters).__name__
                raise TypeError(f"{kind}.{name} should be an array with {_DIMENSIONS[hint]} axes, not of shape {value.shape}")
            numbers.append(np.array(value.shape, dtype=np.float64))
        numbers.append(value.ravel())
    return np.concatenate(numbers)


_DIMENSIONS: dict[Any, int] = {Vector: 1, Matrix: 2}


def _reader(kind: type) -> Callable[[np.ndarray], Any]:
    """The function from a row of numbers to an instance of the class, written out for its fields.

    Its name is one that no other has: machine code from the cache is linked by names, and numba tells functions of one name and
    signature apart by numbers that two processes, of which each compiled one, give twice.
    """
    lines = ["    at = 0"]
    for name, hint in get_type_hints(kind).items():
        if hint is float:
            lines.append(f"    {name}, at = values[at], at + 1")
        elif hint is bool:
            lines.append(f"    {name}, at = values[at] != 0.0, at + 1")
        elif get_origin(hint) is tuple and set(get_args(hint)) == {float}:
            entries = "".join(f"values[at + {i}], " for i in range(len(get_args(hint))))
            lines.append(f"    {name}, at = ({entries}), at + {len(get_args(hint))}")
        elif hint is Vector:
            lines.append("    at, end = at + 1, at + 1 + int(values[at])")
            lines.append(f"    {name}, at = values[at:end], end")
        elif hint is Matrix:
            lines.append("    rows, columns = int(values[at]), int(values[at + 1])")
            lines.append("    at, end = at + 2, at + 2 + rows * columns")
            lines.append(f"    {name}, at = values[at:end].reshape(rows, columns), end")
        else:
            allowed = "float, bool, a tuple of floats, Vector or Matrix"
            raise TypeError(f"{kind.__name__}.{name} is of type {hint}: parameters of an effect should be {allowed}")
    lines.append(f"    return Parameters({', '.join(get_type_hints(kind))})")
    digest = hashlib.sha256("\n".join([kind.__module__, kind.__qualname__, *lines]).encode()).hexdigest()[:16]
    names: dict[str, Any] = {"Parameters": kind}
    exec("\n".join([f"def read_{digest}(values):", *lines]), names)
    return cast(Callable[[np.ndarray], Any], names[f"read_{digest}"])


def parameters_at(kind, values):
    """The parameters of the class that stand in `values`."""
    return _reader(kind)(values)


@overload(parameters_at)
def _parameters_at_overload(kind, values):
    read = kernel(_reader(kind.instance_class))
    return lambda kind, values: read(values)


def add_wrench(kind, values, nodes):
    """The wrench kernel of the class, with the parameters that stand in `values`."""
    _KERNELS["wrench", kind](_reader(kind)(values), nodes)


@overload(add_wrench)
def _add_wrench_overload(kind, values, nodes):
    function, read = _KERNELS["wrench", kind.instance_class], kernel(_reader(kind.instance_class))
    return lambda kind, values, nodes: function(read(values), nodes)


def add_stress(kind, values, points):
    """The stress kernel of the class."""
    _KERNELS["stress", kind](_reader(kind)(values), points)


@overload(add_stress)
def _add_stress_overload(kind, values, points):
    function, read = _KERNELS["stress", kind.instance_class], kernel(_reader(kind.instance_class))
    return lambda kind, values, points: function(read(values), points)


def advance_state(kind, values, step, nodes, points):
    """The state kernel of the class."""
    _KERNELS["advance", kind](_reader(kind)(values), step, nodes, points)


@overload(advance_state)
def _advance_state_overload(kind, values, step, nodes, points):
    function, read = _KERNELS["advance", kind.instance_class], kernel(_reader(kind.instance_class))
    return lambda kind, values, step, nodes, points: function(read(values), step, nodes, points)


def move_base(kind, values, base):
    """The base kernel of the class."""
    _KERNELS["base", kind](_reader(kind)(values), base)


@overload(move_base)
def _move_base_overload(kind, values, base):
    function, read = _KERNELS["base", kind.instance_class], kernel(_reader(kind.instance_class))
    return lambda kind, values, base: function(read(values), base)


def add_energy(kind, values, nodes, energy):
    """The energy kernel of the class."""
    _KERNELS["energy", kind](_reader(kind)(values), nodes, energy)


@overload(add_energy)
def _add_energy_overload(kind, values, nodes, energy):
    function, read = _KERNELS["energy", kind.instance_class], kernel(_reader(kind.instance_class))
    return lambda kind, values, nodes, energy: function(read(values), nodes, energy)


@kernel
def wrench_of_kind(kind, values, nodes):
    """What an address of a wrench kernel leads to."""
    add_wrench(kind, values, nodes)


@kernel
def stress_of_kind(kind, values, points):
    """What that of a stress kernel leads to."""
    add_stress(kind, values, points)


@kernel
def advance_of_kind(kind, values, step, nodes, points):
    """What that of a state kernel leads to."""
    advance_state(kind, values, step, nodes, points)


@kernel
def base_of_kind(kind, values, base):
    """What that of a base kernel leads to."""
    move_base(kind, values, base)


@kernel
def energy_of_kind(kind, values, nodes, energy):
    """What that of an energy kernel leads to."""
    add_energy(kind, values, nodes, energy)


_ROW = np.zeros(1)
_NODES = Nodes(1, 0.0, *(_ROW for _ in Nodes._fields[2:]))
_POINTS = Points(1, 0.0, *(_ROW for _ in Points._fields[2:]))
_CALLERS: dict[str, tuple[Any, tuple[Any, ...]]] = {  # and examples of their arguments
    "wrench": (wrench_of_kind, (_ROW, _NODES)),
    "stress": (stress_of_kind, (_ROW, _POINTS)),
    "advance": (advance_of_kind, (_ROW, 0.0, _NODES, _POINTS)),
    "base": (base_of_kind, (_ROW, Base(0.0, _ROW, _ROW, _ROW))),
    "energy": (energy_of_kind, (_ROW, _NODES, _ROW)),
}
