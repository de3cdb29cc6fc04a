"""Effects: what acts on the arm besides its tendons, and the table by which a scene names them.

An effect is one file, in this package or a user's own: its configuration class under `@register_effect("name")`, its parameters, a
`Struct` of numbers and arrays, and the kernels that it needs, see mechanics/effects.py. It is then the optional table
`[effects.name]` of every scene. A scene without that table neither compiles nor calls it. `examples/own_effect.py` is one from outside.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Self, TypeVar

import numpy as np
from pydantic import ConfigDict

from soft_tendon_env.effects.kernel_checks import check_kernels
from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import DIRECT, EffectTable
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_among, odd_keys, shown
from soft_tendon_env.tools.types import Array as Array


@dataclass(frozen=True)
class Discretisation:
    """The discretised rod as effects see it when their parameters are made: slices around nodes, and quadrature points.

    Arrays over nodes and points are in order from base to tip; `mechanics.types.node_field` and `point_field` lay them out for kernels.

    Attributes:
        length: of the rod [m].
        borders: arc lengths [m] of base, tip and ends of tendons and segments, between which all fields are smooth.
        node: arc lengths (nodes,) [m].
        point: arc lengths (nodes, 2) [m].
        radius: the rod's radius [m] at arc lengths (m,) [m], (m,).
        elasticity: screw elasticity diag(Sigma) [N m^2, N] of its section at arc lengths (m,) [m], (m, 6).
        line_mass: mass per length [kg/m] at arc lengths (m,) [m], (m,).
        over_nodes: the integral of a line density, a function from arc lengths (m,) [m] to (m, k), over the slice of each node, (nodes, k).
        tendon_length: lengths (n_a,) [m] of the tendons along the stress-free rod.
        tendon_turn: angles (n_a,) [rad] by which the tendons turn along the stress-free rod.
        tension_limits: of the tendons (n_a, 2) [N].
        effects: all effects of the scene, for those that depend on another one, as buoyancy on gravity.
        step: the longest time step [s] of the scene's integrator.
    """

    length: float
    borders: Array
    node: Array
    point: Array
    radius: Callable[[Array], Array]
    elasticity: Callable[[Array], Array]
    line_mass: Callable[[Array], Array]
    over_nodes: Callable[[Callable[[Array], Array]], Array]
    tendon_length: Array
    tendon_turn: Array
    tension_limits: Array
    effects: "Effects"
    step: float


class Configured(NamedTuple):
    """An arm in one configuration, of which effects tell their potential energy."""

    mass: Array  # (nodes,) [kg], of the rod and its payload
    pose: Array  # (nodes, 4, 4)
    strain: Array  # (points, 6), less the stress-free one
    weight: Array  # (points,) [m]
    stiffness: Array  # (points, 6) diag(Sigma), 0 for rigid strains
    rod: Discretisation
    state: Array  # (m,) internal state of the effect


class DeadLoads(NamedTuple):
    """Loads whose size and direction in the world frame never change: what a strain can have inside, see paper III-B."""

    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m/s^2] of all mass, payload included
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [N] at the tip
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [N m] at the tip

    @property
    def exist(self) -> bool:
        """Whether there are any."""
        return any(component != 0.0 for vector in self for component in vector)


class NoParameters(Struct):
    """Parameters of an effect that no kernel reads."""


class Solid(NamedTuple):
    """A simple solid, as pictures and recordings show it."""

    kind: Literal["plane", "sphere", "capsule", "cylinder", "box"]  # a plane bounds the half-space below it; its normal is z
    size: tuple[float, ...]  # [m]: none; radius; radius and length along z, that of a capsule without its caps; the same; edges x, y, z
    pose: Array  # (4, 4) of its middle


class Effect(Configuration):
    """Base of the effects' configurations: what a scene's table says, checked.

    Attributes:
        is_contact: whether the arm comes upon it in places only, as upon obstacles: passive fields are made without it.
        is_actuation: whether it lies between commands and tensions, as numbers of the `transmission`: what is told of the arm under given
            tensions is without it.
        command_unit: unit of the commands that it takes; "N": the tension that comes of them at rest.
    """

    is_contact: ClassVar[bool] = False
    is_actuation: ClassVar[bool] = False
    command_unit: ClassVar[str] = "N"

    @property
    def acts(self) -> bool:
        """Whether its kernels do anything with these numbers: one that does not costs nothing, as a payload without a force."""
        return True

    def parameters(self, rod: Discretisation) -> Any:
        """The parameters that the kernels read: an instance of the effect's own `Struct` class, see mechanics/effects.py."""
        if self.is_actuation:
            return NoParameters()
        raise NotImplementedError(f"{type(self).__name__} needs a method parameters(rod)")

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        """Numbers of `mechanics.effects.Transmission` by name, of an effect between commands and tensions."""
        return {}

    def added_inertia(self, rod: Discretisation) -> Array:
        """Screw inertia (nodes, 6) [kg m^2, kg] that moves with the slices of the rod, about their axes: none unless a class says so."""
        return np.zeros((rod.node.size, 6))

    @property
    def payload(self) -> Array:
        """Screw inertia (6,) [kg m^2, kg] of a body fixed to the tip, at which gravity pulls: none unless a class says so."""
        return np.zeros(6)

    def state(self, rod: Discretisation) -> Array:
        """The internal state (m,) of the effect in the stress-free arm that has always been at rest: none unless a class says so."""
        return np.zeros(0)

    def potential_energy(self, arm: Configured) -> float:
        """Potential energy [J] of the effect. Raises ValueError where it has none, as unless a class says so."""
        raise ValueError(f"the effect {type(self).__name__} has no potential energy")

    def dead_loads(self) -> DeadLoads | None:
        """Dead loads in place of the kernel, for a strain with `include_loads`: all that it would add, or None."""
        return None

    def command_limits(self, limits: Array) -> Array:
        """Limits (n_a, 2) of commands where those of tensions are `limits` (n_a, 2) [N]."""
        return limits

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        """Solids that show the effect at a time [s], always as many, in the same order: none unless a class says so."""
        return ()

    def sample_smaller(self, random: np.random.Generator) -> Self:
        """This effect at a random size up to its own and in a random direction, for what is to hold under all of those; unless a class
        says how, itself."""
        return self

    def includes(self, other: Self) -> bool:
        """Whether `sample_smaller` reaches another effect of the class: what was made under the one holds under the other."""
        return self == other


def size(vector: tuple[float, float, float]) -> float:
    """Euclidean norm."""
    return float(np.linalg.norm(vector))


def random_vector(random: np.random.Generator, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """A vector in a random direction with a size between zero and that of `vector`."""
    direction = random.normal(size=3)
    x, y, z = (random.random() * size(vector) * direction / np.linalg.norm(direction)).tolist()
    return x, y, z


Class = TypeVar("Class", bound=type[Effect])

EFFECTS: dict[str, type[Effect]] = {}
"""Every registered effect's configuration class, by the name that scenes use."""


def register_effect(name: str) -> Callable[[Class], Class]:
    """Class decorator: make an `Effect` available to scenes as `[effects.name]`.

    Registering a class of the same module and name again replaces it, as in a notebook. Raises ValueError for a name that is taken or
    no identifier, TypeError for what is no Effect.
    """
    if not name.isidentifier() or hasattr(Effects, name):
        raise ValueError(f"an effect's name should be an identifier that no method of a table has, not {name!r}")

    def add(effect: Class) -> Class:
        if not (isinstance(effect, type) and issubclass(effect, Effect)):
            raise TypeError(f"the effect {name!r} should be a class derived from soft_tendon_env.effects.Effect, not {shown(effect)}")
        present = EFFECTS.get(name, effect)
        if (present.__module__, present.__qualname__) != (effect.__module__, effect.__qualname__):
            raise ValueError(f"the effect {name!r} is registered twice: {present.__module__}, {effect.__module__}")
        EFFECTS[name] = effect
        return effect

    return add


class Effects(Configuration):
    """The effects of a scene: a table each, by the names of EFFECTS; None where the scene has none of that name."""

    model_config = ConfigDict(extra="allow")

    def __init__(self, /, **tables: Any):
        """Raises ConfigurationError."""
        chosen, problems = {}, list(odd_keys(tables))
        for name, table in tables.items() if not problems else ():
            try:
                if name not in EFFECTS:
                    problems.append(Problem((name,), f"is an unknown key (given {shown(table)}): {not_among(name, EFFECTS)}"))
                elif isinstance(table, dict):
                    chosen[name] = EFFECTS[name](**table)
                elif isinstance(table, EFFECTS[name]):
                    chosen[name] = table
                elif table is not None:
                    problems.append(Problem((name,), f"is {shown(table)}: it should be a table"))
            except ConfigurationError as error:
                problems += [Problem((name, *key), text) for key, text in error.problems]
        if problems:
            raise ConfigurationError(problems, type(self).__name__)
        super().__init__(**{name: chosen[name] for name in sorted(chosen)})

    def chosen(self) -> dict[str, Effect]:
        """Effects that the scene has, by name, in the order of their names: that in which they act."""
        return dict(self.__pydantic_extra__ or {})

    def acting(self) -> dict[str, Effect]:
        """Effects whose kernels do anything, by name."""
        return {name: effect for name, effect in self.chosen().items() if effect.acts}

    def table(self, rod: Discretisation) -> EffectTable:
        """Table of the acting effects for the kernels, in the order of their names. Raises TypeError where one has no kernel."""
        effects = self.acting()
        parameters = {name: effect.parameters(rod) for name, effect in effects.items()}
        for name, own in parameters.items():
            if not effects[name].is_actuation:
                check_kernels(name, type(own))
        numbers: dict[str, Any] = {}
        states = [effect.state(rod) for effect in effects.values()]
        for i, effect in enumerate(effects.values()):
            numbers.update(effect.transmission(rod), **({"filter": i} if effect.is_actuation and states[i].size else {}))
        return EffectTable(list(parameters.values()), states, DIRECT.replaced(**numbers))

    def added_inertia(self, rod: Discretisation) -> Array:
        """Screw inertia (nodes, 6) that the effects add to the slices of the rod."""
        return sum((effect.added_inertia(rod) for effect in self.chosen().values()), np.zeros((rod.node.size, 6)))

    @property
    def payload(self) -> Array:
        """Screw inertia (6,) of what is fixed to the tip."""
        return sum((effect.payload for effect in self.chosen().values()), np.zeros(6))

    def potential_energy(self, arm: Configured) -> float:
        """Potential energy [J] of all effects, `arm.state` being their internal states one after the other. Raises ValueError where one
        has none."""
        total, first = 0.0, 0
        for effect in self.chosen().values():
            last = first + effect.state(arm.rod).size
            total += effect.potential_energy(arm._replace(state=arm.state[first:last]))
            first = last
        return float(total)

    def everywhere(self) -> "Effects":
        """Effects that act on the arm, and that it does not come upon in places only."""
        return self._those(lambda effect: not (effect.is_contact or effect.is_actuation))

    @property
    def command_unit(self) -> str:
        """Unit of commands: "N" where they are tensions, as far as the arm is at rest."""
        return next((effect.command_unit for effect in self.chosen().values() if effect.command_unit != "N"), "N")

    @property
    def command_tension(self) -> bool:
        """Whether commands are tensions [N], as far as the arm is at rest."""
        return self.command_unit == "N"

    def on_arm(self) -> "Effects":
        """Effects that act on the arm, without what lies between commands and tensions."""
        return self._those(lambda effect: not effect.is_actuation)

    def command_limits(self, limits: Array) -> Array:
        """Limits (n_a, 2) of commands where those of tensions are `limits` (n_a, 2) [N]."""
        for effect in reversed(self.chosen().values()):
            limits = effect.command_limits(limits)
        return limits

    def outside(self) -> "Effects":
        """Effects without dead loads, which stay outside of a strain with `include_loads`."""
        return self._those(lambda effect: effect.dead_loads() is None)

    def _those(self, keep: Callable[[Effect], bool]) -> "Effects":
        return Effects(**{name: effect for name, effect in self.chosen().items() if keep(effect)})

    def dead_loads(self) -> DeadLoads:
        """The sum of what a strain with `include_loads` answers to."""
        own = [loads for effect in self.chosen().values() if (loads := effect.dead_loads()) is not None]
        sums = [[float(value) for value in np.sum(vectors, axis=0)] for vectors in zip(DeadLoads(), *own, strict=True)]
        return DeadLoads(*((x, y, z) for x, y, z in sums))

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        """Solids that show all effects at a time [s]."""
        return tuple(solid for effect in self.chosen().values() for solid in effect.solids(time))

    def sample_smaller(self, random: np.random.Generator) -> "Effects":
        """Each effect at a random size up to its own and in a random direction, as far as it varies."""
        return Effects(**{name: effect.sample_smaller(random) for name, effect in self.chosen().items()})

    def includes(self, other: "Effects") -> bool:
        """Whether `sample_smaller` reaches all of the other effects."""
        own = self.chosen()
        return all(name in own and own[name].includes(effect) for name, effect in other.everywhere().chosen().items())

    def __getattr__(self, name: str) -> Any:
        """The effect of this name, None where the scene has none."""
        if name in EFFECTS:
            return self.chosen().get(name)
        return super().__getattr__(name)  # type: ignore[misc] # which pydantic hides
