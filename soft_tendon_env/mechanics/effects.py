"""Effects as the kernels see them: their own kernels, addresses and calls.

A kernel of an effect reads nodes or points of the rod, and adds to them.

The kernels of an effect are compiled by themselves and called through their addresses, which stand
in a table with those of their parameters, a `Struct`: the mechanics are compiled once, whatever
effects an arm has, and an effect that no scene names is not compiled at all. An effect is a pure
function of its parameters, of the time, and of poses and twists, or of strains.
"""

import dis
import functools
import math
from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise
from types import CodeType
from typing import Annotated, Any, NamedTuple

import numba
import numpy as np
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from soft_tendon_env.compiler.compilation import address_of, emit_call_at, kernel
from soft_tendon_env.mechanics.algebra.structs import Struct, StructType, struct_at

TURN = 2.0 * math.pi / 16.0  # [rad] by which what is periodic may go on within one integrator step

IntArray = NDArray[np.int64]
"""Marks fields of integers for workspace.zeros(): `Annotated[IntArray, "n"]`."""

NO = 0
YES = 1
"""Values of a flag."""


class BeforeStep(Struct):
    """Poses before the step that was just taken."""

    time: Annotated[np.ndarray, "1"]  # [s]
    pose: Annotated[np.ndarray, "nodes x 12"]  # as in Nodes
    base: Annotated[np.ndarray, "24"]


class ContactFlags(Struct):
    """Flags of a step, YES or NO: whether the arm touches something or goes through it."""

    touched: Annotated[IntArray, "1"]  # the arm touched something within the step
    # the arm went through something on its way: the step is tried again at half of its length
    tunnelled: Annotated[IntArray, "1"]
    # it touches something or is about to: the next step is as short as its error calls for, with
    # fixed steps too
    active: Annotated[IntArray, "1"]


class Collision(Struct):
    """Inputs and results of the check for collisions."""

    before_step: BeforeStep
    flags: ContactFlags


class Nodes(NamedTuple):
    """Slices of the rod that the nodes stand for.

    They are what an effect reads of them, and what it adds to; layout as in types.py.
    """

    packs: int
    time: float  # [s]
    mass: np.ndarray  # nodes [kg], of the rod and its payload
    inertia: (
        np.ndarray
    )  # nodes x 6, screw inertia about the slice's axes [kg m^2, kg], with what effects add
    pose: np.ndarray  # nodes x 12, R rows, r
    twist: np.ndarray  # nodes x 6, body frame
    base: (
        np.ndarray
    )  # (24) pose of the base, R rows and r; its twist and the rate of that, as in Base
    wrench: np.ndarray  # nodes x 6, body frame, of the whole slice
    # nodes x 21, -d wrench / d displacement, symmetric, its lower triangle by rows: where it is
    # stiff
    stiffness: np.ndarray
    damping: np.ndarray  # nodes x 21, -d wrench / d twist: where that is large
    before_step: (
        BeforeStep  # for a continuous collision check between two poses, under `limits_step`
    )
    contact: ContactFlags


class Points(NamedTuple):
    """Sections at the quadrature points.

    They are what an effect reads of them, and what it adds to; layout as in types.py.
    """

    packs: int
    time: float  # [s]
    # [s] since the strain was `before` and the effect's own state was what it is; infinity: the arm
    # has rested
    since: float
    state: (
        np.ndarray
    )  # the effect's own internal state then, which its stress brings up to the present
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
    pose: np.ndarray  # (12) R rows, r, world frame; to begin with as the scene has it
    # (6) world frame: angular velocity, and velocity of the point of the base that is at the
    # world's origin
    twist: np.ndarray
    acceleration: np.ndarray  # (6) its rate


class Transmission(Struct):
    """Path from commands to tensions: filter, elastic tendons, friction along them.

    The filter is in front of the tendons. Each may be off.
    """

    # index of the effect whose internal state is that of the filter, see transmission; -1: commands
    # act at once
    filter: int
    lags: int  # 1 where what has arrived acts with a lag or a limited rate, else 0
    delay: float  # [s]
    time_constant: float  # [s] of the lag
    rate_limit: float  # [N/s], or where commands are displacements [m/s]
    finest: float  # [s], the shortest step that a command on its way asks for
    # 1 where tendons are springs and commands are displacements of their actuators [m], else 0
    elastic: int
    stiffness: np.ndarray  # (n_a) [N/m] of the springs
    strength: np.ndarray  # (n_a) [N] of their actuators
    length: np.ndarray  # (n_a) [m] of the tendons along the stress-free rod
    friction: float  # coefficient of friction [-]; 0: tensions are the same all along a tendon
    stiction_speed: float  # [m/s] of sliding at which friction is 1 / sqrt(2) of that of fast one

    @property
    def acts(self) -> bool:
        """True if any of it is on."""
        return self.filter >= 0 or self.elastic != 0 or self.friction > 0.0


DIRECT = Transmission(
    filter=-1,
    lags=0,
    delay=0.0,
    time_constant=0.0,
    rate_limit=math.inf,
    finest=0.0,
    elastic=0,
    stiffness=np.zeros(0),
    strength=np.zeros(0),
    length=np.zeros(0),
    friction=0.0,
    stiction_speed=1.0,
)
"""Commands that are tensions at once."""


EXPLICIT = 0
IMPLICIT_TWIST = 1
IMPLICIT_POSE = 2
"""Bits of what a wrench is differentiated by for the implicit step."""

_ROW = np.zeros(1)


def make_contact_flags() -> ContactFlags:
    """Flags that say NO."""
    return ContactFlags(*(np.zeros(1, dtype=np.int64) for _ in range(3)))


_NODES = Nodes(
    packs=1,
    time=0.0,
    mass=_ROW,
    inertia=_ROW,
    pose=_ROW,
    twist=_ROW,
    base=_ROW,
    wrench=_ROW,
    stiffness=_ROW,
    damping=_ROW,
    before_step=BeforeStep(_ROW, _ROW, _ROW),
    contact=make_contact_flags(),
)
HOOKS: dict[str, tuple[Any, ...]] = {
    "wrench": (_NODES,),
    "stress": (Points(1, 0.0, 0.0, *[_ROW] * 9),),
    "base": (Base(0.0, *[_ROW] * 3),),
    "limit": (_NODES, _ROW),
}
"""Kinds of kernels that an effect can have, as fields of `EffectTable`, with examples of their
arguments after the parameters."""

_KERNELS: dict[tuple[str, type], Any] = {}
_IMPLICIT: dict[type, int] = {}
_PARAMETERS = StructType(Struct, ())
"""Numba's type of parameters, of which a call passes the address alone."""

_FUNCTIONS: list[Callable[..., None]] = []
"""Kernels by their addresses less 1, where nothing is compiled."""

Decorator = Callable[[Any], Any]


class EffectTable(Struct):
    """Effects of an arm: addresses of their kernels for every hook, and of their parameters.

    The address is 0 where there is no kernel.

    The same type whatever the effects. Addresses hold within a process: a copy that is unpickled in
    another one gets its own.
    """

    count: int
    wrench: np.ndarray  # (count) int64
    stress: np.ndarray
    base: np.ndarray
    limit: np.ndarray
    implicit: np.ndarray  # (count) int64, IMPLICIT_TWIST + IMPLICIT_POSE
    parameters: np.ndarray  # (count) int64
    transmission: Transmission
    first_state: np.ndarray  # (count + 1) int64
    state: (
        np.ndarray
    )  # internal states of all effects, in the unloaded arm that has always been at rest

    def __init__(
        self,
        structs: Sequence[Struct],
        states: Sequence[np.ndarray],
        transmission: Transmission = DIRECT,
    ) -> None:
        """Makes the table of effects with these parameters and internal states, in their order.

        Compiles their kernels when needed. Those whose parameters no kernel reads act by the
        transmission alone.
        """
        self.__dict__["_structs"] = tuple(structs)  # which their addresses do not keep
        kernels = {
            hook: _words(_address_of_kernel(hook, struct) for struct in structs) for hook in HOOKS
        }
        super().__init__(
            count=len(structs),
            **kernels,
            implicit=_words(_IMPLICIT.get(type(struct), EXPLICIT) for struct in structs),
            parameters=_words(struct.address for struct in structs),
            transmission=transmission,
            first_state=np.cumsum([0, *(part.size for part in states)]),
            state=np.concatenate([np.zeros(0), *states]),
        )

    def __reduce__(self) -> tuple[Any, ...]:
        states = [self.state[first:last].copy() for first, last in pairwise(self.first_state)]
        return EffectTable, (self.structs, states, self.transmission)

    @property
    def structs(self) -> tuple[Struct, ...]:
        """The parameters of every effect."""
        return tuple(self.__dict__["_structs"])

    @property
    def load(self) -> bool:
        """True if any of them acts on an arm at rest, or moves its base.

        What the path from commands to tensions holds does not.
        """
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


def _words(values: Any) -> np.ndarray:
    return np.array([*values], dtype=np.int64)


def _register(hook: str, kind: type) -> Decorator:
    if not (isinstance(kind, type) and issubclass(kind, Struct)):
        raise TypeError(
            "parameters of an effect should be a class derived from"
            f" soft_tendon_env.effects.Struct, not {kind!r}"
        )

    def register(function: Any) -> Any:
        if not (config.DISABLE_JIT or hasattr(function, "kernel") or hasattr(function, "compile")):
            raise TypeError(
                f"{getattr(function, '__name__', function)!r} should be a kernel: put @kernel"
                f" beneath the decorator for {kind.__name__}"
            )
        _KERNELS[hook, kind] = function
        return function

    return register


def adds_wrench(kind: type, implicit: Sequence[str] = ()) -> Decorator:
    """Registers a kernel (parameters, nodes) that adds to `nodes.wrench`: a decorator.

    A wrench that is stiff or damps fast belongs to the implicit step. Either `implicit` names what
    it depends on so, and the step takes its derivatives at every node by differences; or the kernel
    adds them to `nodes.stiffness` and `nodes.damping` itself. The decorator raises ValueError where
    both would count.

    Args:
        kind: class of the parameters, see `Nodes` for the other argument of the kernel.
        implicit: "pose", "twist" or both.

    Returns:
        The decorator.

    Raises:
        ValueError: for another name in `implicit`.
    """
    bits = {"twist": IMPLICIT_TWIST, "pose": IMPLICIT_POSE}
    odd = {*implicit} - {*bits}
    if odd:
        raise ValueError(
            f"implicit is {implicit!r}: it should name pose, twist or both, as in"
            f" implicit=('twist',), not {min(odd)!r}"
        )
    register = _register("wrench", kind)

    def register_once(function: Any) -> Any:
        code = getattr(function, "py_func", function).__code__
        stiff = _attributes_of_nodes(code) & {"stiffness", "damping"}
        if stiff and implicit:
            raise ValueError(
                f"the kernel {code.co_name} for {kind.__name__} adds to nodes.{min(stiff)} what"
                f" implicit={implicit!r} finds by differences: leave out one of the two, or it"
                " counts twice"
            )
        _IMPLICIT[kind] = sum(bits[name] for name in {*implicit})
        return register(function)

    return register_once


def _attributes_of_nodes(code: CodeType) -> set[Any]:
    """Names that the code of a kernel (parameters, nodes) reads of its nodes."""
    nodes = code.co_varnames[1]
    names = set()
    for before, now in pairwise(dis.get_instructions(code)):
        # an instruction may load two variables, of which the last one is on top
        if before.argrepr.split(", ")[-1] == nodes:
            names.add(now.argval)
    return names


adds_stress = functools.partial(_register, "stress")
"""Decorator: the kernel (parameters, points) adds to `points.stress`, and the diagonals of its
derivatives to `points.stiffness` and `points.damping`, see `Points`. An internal state,
`points.state`, it brings up to the present: after a time `points.since` of 0 that stays as it is,
for one of infinity it is that at rest."""
moves_base = functools.partial(_register, "base")
"""Decorator: the kernel (parameters, base) sets pose, twist and acceleration of the base at a time,
see `Base`."""
limits_step = functools.partial(_register, "limit")
"""Decorator: the kernel (parameters, nodes, longest) of an effect that changes in time faster than
an arm does by itself, or begins at once. It lowers `longest` (1,) [s], the longest integrator step
that may begin in this configuration: to the time until something begins or ends, or for what is
periodic by `allow_turning`. Contact checks for collisions between `nodes.before_step` and now, see
`ContactFlags`."""


@kernel
def allow_turning(rate, longest):
    """Lowers the longest step to a sixteenth of the period of what turns at a rate.

    Args:
        rate: angular rate [rad/s]; 0 allows any step.
        longest: (1,) [s], which is changed.
    """
    if rate != 0.0:
        longest[0] = min(longest[0], TURN / abs(rate))


def kernels_of(kind: type) -> dict[str, Any]:
    """The kernels for parameters of this class, by hook."""
    return {hook: _KERNELS[hook, kind] for hook in HOOKS if (hook, kind) in _KERNELS}


def _address_of_kernel(hook: str, parameters: Struct) -> int:
    """Address of the kernel for these parameters, 0 where there is none.

    Compiles it when needed.
    """
    function = _KERNELS.get((hook, type(parameters)))
    if function is None:
        return 0
    kind: Any = type(parameters) if config.DISABLE_JIT else numba.typeof(parameters)
    return _address(hook, function, kind)


@functools.cache
def _address(hook: str, function: Any, kind: Hashable) -> int:
    """The address of a kernel for parameters of a type, where it stays."""
    if config.DISABLE_JIT:
        _FUNCTIONS.append(function)
        return len(_FUNCTIONS)
    kinds = (kind, *map(numba.typeof, HOOKS[hook]))
    if hasattr(function, "kernel"):
        return address_of(function.kernel.compiled(kinds))
    function.compile(kinds)  # of a user's own file
    return address_of(function.overloads[kinds])


def call(address, parameters, arguments):
    """Calls the kernel at an address.

    Its arguments are the parameters at another address and a tuple of further arguments.
    """
    _FUNCTIONS[address - 1](struct_at(None, [parameters], 0), *arguments)


@intrinsic
def _call(typingctx, address, parameters, arguments):
    def emit(context, builder, signature, given):
        address_value, parameters_value, arguments_value = given
        kinds = (_PARAMETERS, *signature.args[2].types)
        pointer = builder.inttoptr(parameters_value, context.get_value_type(_PARAMETERS))
        values = [pointer, *cgutils.unpack_tuple(builder, arguments_value)]
        return emit_call_at(context, builder, address_value, types.none, kinds, values)

    return types.none(address, parameters, arguments), emit


@overload(call)
def _call_overload(address, parameters, arguments):
    return lambda address, parameters, arguments: _call(address, parameters, arguments)
