"""Effects as the kernels see them: what an effect reads and adds to, its own kernels, their addresses, and how they are called.

The kernels of an effect are compiled by themselves and called through their addresses, which stand in a table of numbers: the mechanics
are compiled once, whatever effects an arm has, and an effect that no scene names is not compiled at all.

The parameters of an effect are a NamedTuple class of its own, see effect_parameters.py; its kernels get them as an instance of the class.
"""

import functools
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from soft_tendon_env.compiler.compilation import OPTIONS, Kernel, address_of, emit_call_at, is_of_package, kernel
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effect_parameters import flat, parameters_at

TURN = 2.0 * math.pi / 16.0
"""Angle [rad] by which what is periodic may go on within one integrator step."""


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
    touched: np.ndarray  # (1) set to 1 by an effect under `sweeps_motion` where the arm touches what it came upon


class ContactFlags(Struct):
    """Result of a continuous collision check of a step: flags, 1 or 0."""

    tunnelled: np.ndarray  # (1) the arm went through something on its way: the step is tried again at half of its length
    active: np.ndarray  # (1) it touches something or is about to: the next step is as short as its error calls for, with fixed steps too


def make_contact_flags() -> ContactFlags:
    """Flags of zeros."""
    return ContactFlags(tunnelled=np.zeros(1), active=np.zeros(1))


class Before(NamedTuple):
    """Poses of the nodes and of the base before a step."""

    time: float  # [s]
    pose: np.ndarray  # as in Nodes
    base: np.ndarray


class Points(NamedTuple):
    """The sections at the quadrature points: what an effect reads of them, and what it adds to; layout as in types.py."""

    packs: int
    time: float  # [s]
    since: float  # [s] since the strain was `before` and the effect's own state was what it is; infinity: the arm has rested
    state: np.ndarray  # the effect's own internal state then, which its stress brings up to the present
    before: np.ndarray  # points x 6, xi then
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


class Transmission(Struct):
    """Path from commands to tensions: a filter in front of the tendons, elastic tendons, friction along them. Each may be off."""

    filter: int  # index of the effect whose internal state is that of the filter, see transmission; -1: commands act at once
    lags: int  # 1 where what has arrived acts with a lag or a limited rate, else 0
    delay: float  # [s]
    time_constant: float  # [s] of the lag
    rate_limit: float  # [N/s], or where commands are displacements [m/s]
    finest: float  # [s], the shortest step that a command on its way asks for
    elastic: int  # 1 where tendons are springs and commands are displacements of their actuators [m], else 0
    stiffness: np.ndarray  # (n_a) [N/m] of the springs
    strength: np.ndarray  # (n_a) [N] of their actuators
    length: np.ndarray  # (n_a) [m] of the tendons along the stress-free rod
    friction: float  # coefficient of friction [-]; 0: tensions are the same all along a tendon
    stiction_speed: float  # [m/s] at which friction is 1 / sqrt(2) of that of fast sliding

    @property
    def makes_tensions(self) -> bool:
        """True if tendons are elastic or rub."""
        return self.elastic != 0 or self.friction > 0.0

    @property
    def acts(self) -> bool:
        """True if any of it is on."""
        return self.filter >= 0 or self.makes_tensions


DIRECT = Transmission(
    filter=-1, lags=0, delay=0.0, time_constant=0.0, rate_limit=math.inf, finest=0.0, elastic=0,
    stiffness=np.zeros(0), strength=np.zeros(0), length=np.zeros(0), friction=0.0, stiction_speed=1.0,
)  # fmt: skip
"""Commands that are tensions at once."""


_ROW = np.zeros(1)
_NODES = Nodes(1, 0.0, *(_ROW for _ in Nodes._fields[2:]))
_POINTS = Points(1, 0.0, 0.0, *(_ROW for _ in Points._fields[3:]))
HOOKS: dict[str, tuple[Any, ...]] = {
    "wrench": (_NODES,),
    "stress": (_POINTS,),
    "base": (Base(0.0, _ROW, _ROW, _ROW),),
    "limit": (_NODES, _ROW),
    "sweep": (Before(0.0, _ROW, _ROW), _NODES, _ROW, make_contact_flags()),
}
"""Kinds of kernels that an effect can have, with examples of their arguments but for the parameters, and of the fields of `EffectTable`: a
wrench at the nodes, stress at the points, motion of the base, the longest step that it allows, what the arm meets on its way."""


class EffectTable(Struct):
    """The effects of an arm: addresses of their kernels for every hook, 0 where there is none, and their numbers.

    The same type whatever the effects. Addresses hold within a process: a copy that is unpickled in another one gets its own.
    """

    count: int
    wrench: np.ndarray  # (count) int64
    stress: np.ndarray
    base: np.ndarray
    limit: np.ndarray
    sweep: np.ndarray
    transmission: Transmission
    first_value: np.ndarray  # (count + 1) int64, where in `values` the parameters of each begin
    first_state: np.ndarray  # (count + 1) int64
    values: np.ndarray  # parameters of all effects
    state: np.ndarray  # internal states of all effects, in the unloaded arm that has always been at rest

    def __len__(self) -> int:
        return self.count

    @property
    def load(self) -> bool:
        """True if any of them acts on an arm at rest, or moves its base: what the path from commands to tensions holds does not."""
        return bool(np.any([self.wrench, self.stress, self.base]))

    @property
    def filter_size(self) -> int:
        """Numbers of the internal state of the filter in front of the tendons."""
        i = self.transmission.filter
        return int(self.first_state[i + 1] - self.first_state[i]) if i >= 0 else 0

    @property
    def remembers(self) -> bool:
        """True if a stress depends on the strain before."""
        return self.state.size > self.filter_size

    def __getstate__(self) -> dict[str, Any]:
        kinds = {hook: [_KINDS.get(int(address)) for address in getattr(self, hook)] for hook in HOOKS}
        return {**super().__getstate__(), **kinds}

    def __setstate__(self, fields: dict[str, Any]) -> None:
        own = {hook: [0 if kind is None else _address(hook, kind) for kind in fields[hook]] for hook in HOOKS}
        super().__setstate__({**fields, **{hook: np.array(row, dtype=np.int64) for hook, row in own.items()}})


_KERNELS: dict[tuple[str, type], Any] = {}
_ADDRESSES: dict[tuple[str, type], tuple[Any, int, Any]] = {}  # with the kernel that is there, and what keeps it there
_KINDS: dict[int, type] = {}
_FUNCTIONS: dict[int, Callable[..., None]] = {}  # by address, where nothing is compiled

Decorator = Callable[[Any], Any]


class TimeWarning(UserWarning):
    """An effect depends on time without limiting the length of integrator steps."""


def adds_wrench(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, nodes) of an effect with parameters of this class. It adds to `nodes.wrench`, and where the wrench
    is stiff or damps, to `nodes.stiffness` and `nodes.damping`, see `Nodes`."""
    return _registers("wrench", kind)


def adds_stress(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, points) of an effect. It adds to `points.stress`, and the diagonals of its derivatives to
    `points.stiffness` and `points.damping`, see `Points`. Of an effect with an internal state it brings `points.state` up to the present,
    by the strain `before`, that of now and its rate; for a time `since` of 0 it leaves it, for one of infinity it is that at rest."""
    return _registers("stress", kind)


def moves_base(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, base) of an effect that moves the base: it sets `base.pose`, `base.twist` and
    `base.acceleration` as they are at `base.time`, see `Base`."""
    return _registers("base", kind)


def limits_step(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, nodes, longest) of an effect that changes in time faster than an arm does by itself. It lowers
    `longest` (1,) [s], the longest integrator step that may begin in this configuration. Steps with and without error control keep to it.

    What is periodic calls `allow_turning`; what begins or ends, as a pulse, allows a step up to there.
    """
    return _registers("limit", kind)


def sweeps_motion(kind: type) -> Decorator:
    """Decorator: the kernel (parameters, before, nodes, longest, flags) of an effect that is stiff and begins at once, as contact: a
    continuous collision check between the poses before and after a step, see `Before`. It sets `flags`, see `ContactFlags`, and lowers
    `longest` (1,) [s], which begins with the longest step of all, so that the next step ends where a contact begins."""
    return _registers("sweep", kind)


@kernel
def allow_turning(rate, longest):
    """Lower `longest` (1,) [s] to a sixteenth of the period of what turns at a rate [rad/s]."""
    if rate != 0.0:
        longest[0] = min(longest[0], TURN / abs(rate))


def _registers(hook: str, kind: type) -> Decorator:
    def register(function: Any) -> Any:
        _KERNELS[hook, kind] = function
        return function

    return register


def kinds_of(table: EffectTable) -> list[type]:
    """The classes of the parameters of a table's effects, in their order."""
    return [_KINDS.get(max(int(getattr(table, hook)[i]) for hook in HOOKS), object) for i in range(len(table))]


def has_kernel(kind: type) -> bool:
    """True if any kernel is registered for parameters of this class."""
    return any((hook, kind) in _KERNELS for hook in HOOKS)


def make_table(parameters: list[Any], states: list[np.ndarray], transmission: Transmission = DIRECT) -> EffectTable:
    """The table of effects with these parameters and internal states, in their order, and a transmission; compiles their kernels when
    needed. Those whose parameters no kernel reads, as an empty tuple, act by the transmission alone."""
    kernels = {hook: np.array([_address(hook, type(own)) for own in parameters], dtype=np.int64) for hook in HOOKS}
    for own in parameters:
        _tell_of_unlimited_steps(type(own))
    values = [flat(own) for own in parameters]
    return EffectTable(
        count=len(parameters),
        first_value=np.cumsum([0, *(part.size for part in values)]),
        first_state=np.cumsum([0, *(part.size for part in states)]),
        values=np.concatenate([np.zeros(0), *values]),
        state=np.concatenate([np.zeros(0), *states]),
        transmission=transmission,
        **kernels,
    )


def _address(hook: str, kind: type) -> int:
    """The address of the kernel for parameters of this class, 0 where there is none; compiles it when needed."""
    function = _KERNELS.get((hook, kind))
    if function is None:
        return 0
    known, address, _ = _ADDRESSES.get((hook, kind), (None, 0, None))
    if known is not function:
        address, kept = _entry(hook, kind, function)
        _ADDRESSES[hook, kind] = function, address, kept
        _KINDS[address] = kind
    return address


def _tell_of_unlimited_steps(kind: type) -> None:
    """Warns of an effect whose kernels read the time and which lets steps be as long as they like."""
    loads = [_KERNELS[hook, kind] for hook in ("wrench", "stress", "base") if (hook, kind) in _KERNELS]
    own_name = "time" in kind._fields  # type: ignore[attr-defined]  # of a parameter, which is read too
    if not own_name and ("limit", kind) not in _KERNELS and any(_reads_time(load) for load in loads):
        text = "reads the time, but no kernel of it is decorated with @limits_step: steps may pass over its changes"
        warnings.warn(f"the effect with parameters {kind.__name__} {text}", TimeWarning, stacklevel=2)


@functools.cache
def _reads_time(function: Any) -> bool:
    """True if a kernel, or one that it calls by name, reads an attribute `time`."""
    own = getattr(function, "py_func", function)
    called = (own.__globals__.get(name) for name in own.__code__.co_names)
    return "time" in own.__code__.co_names or any(_reads_time(other) for other in called if hasattr(other, "py_func"))


def _entry(hook: str, kind: type, function: Any) -> tuple[int, Any]:
    """Address of what reads the parameters of a class and calls a kernel with them, and what keeps it there."""

    def enter(values: np.ndarray, arguments: tuple[Any, ...]) -> None:
        function(parameters_at(kind, values), *arguments)

    if config.DISABLE_JIT:
        address = len(_FUNCTIONS) + 1
        _FUNCTIONS[address] = enter
        return address, enter
    entry = Kernel(enter, OPTIONS, keep=is_of_package(function) and is_of_package(kind))
    return address_of(entry.compiled((numba.typeof(_ROW), numba.typeof(HOOKS[hook])))), entry


def call(address, arguments):
    """Call the kernel at an address with a tuple of arguments, the row of parameters first."""
    values, *given = arguments
    _FUNCTIONS[address](values, tuple(given))


@intrinsic
def _call(typingctx, address, arguments):
    def emit(context, builder, signature, given):
        values_type, *types_given = signature.args[1].types
        kinds = (values_type, types.Tuple(types_given))
        values, *arguments_given = cgutils.unpack_tuple(builder, given[1])
        packed = context.make_tuple(builder, kinds[1], arguments_given)
        return emit_call_at(context, builder, given[0], types.none, kinds, [values, packed])

    return types.none(address, arguments), emit


@overload(call)
def _call_overload(address, arguments):
    return lambda address, arguments: _call(address, arguments)
