"""Effects: what acts on the arm besides its tendons, and the table by which a scene names them.

An effect is a configuration class under `@register_effect("name")`, its parameters, a `Struct` of numbers and arrays, and the kernels that
it needs, see mechanics/effects.py; here or in a user's own file as `examples/own_effect.py`. It is then the optional table `[effects.name]`
of every scene. A scene without that table neither compiles nor calls it.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from pydantic import ConfigDict

from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import DIRECT, EffectTable, kernels_of
from soft_tendon_env.tools.configuration import Configuration, ConfigurationError, Problem, not_registered, shown
from soft_tendon_env.tools.types import Array as Array


@dataclass(frozen=True)
class Discretisation:
    """The discretised rod as effects see it when their parameters are made: slices around nodes, and quadrature points.

    Arrays over nodes and points are in order from base to tip; `mechanics.types.node_field` and `point_field` lay them out for kernels.
    """

    length: float  # [m] of the rod
    borders: Array  # arc lengths [m] of base, tip and ends of tendons and segments, between which all fields are smooth
    node: Array  # (nodes,) arc lengths [m]
    point: Array  # (nodes, 2) arc lengths [m]
    radius: Callable[[Array], Array]  # [m] of the rod at arc lengths (m,) [m], (m,)
    elasticity: Callable[[Array], Array]  # screw elasticity diag(Sigma) [N m^2, N] of the section there, (m, 6)
    line_mass: Callable[[Array], Array]  # mass per length [kg/m] there, (m,)
    over_nodes: Callable[[Callable[[Array], Array]], Array]  # integral of a line density, (m,) to (m, k), over each slice, (nodes, k)
    tendon_length: Array  # (n_a,) [m] along the stress-free rod
    tendon_turn: Array  # (n_a,) [rad] by which the tendons turn along it
    tension_limits: Array  # (n_a, 2) [N]
    effects: "Effects"  # all of the scene, for those that depend on another one, as buoyancy on gravity
    step: float  # [s], the longest time step of the scene's integrator


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

    acceleration: tuple[float, ...] = (0.0, 0.0, 0.0)  # [m/s^2] of all mass, payload included
    force: tuple[float, ...] = (0.0, 0.0, 0.0)  # [N] at the tip
    moment: tuple[float, ...] = (0.0, 0.0, 0.0)  # [N m] at the tip


class Solid(NamedTuple):
    """A simple solid, as pictures and recordings show it."""

    kind: str  # plane, the half-space below it with its normal along z; sphere, capsule, cylinder, box
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
        """Potential energy [J]: that of an effect between commands and tensions is 0. Raises ValueError where it has none, as unless a
        class says so."""
        if self.is_actuation and self.command_unit == "N":
            return 0.0
        raise ValueError(f"the effect {type(self).__name__} has no potential energy")

    def dead_loads(self) -> DeadLoads | None:
        """Dead loads in place of the kernel, for a strain with `include_loads`: all that it would add, or None."""
        return None

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        """Solids that show the effect at a time [s], always as many, in the same order: none unless a class says so."""
        return ()


def _check_kernels(name: str, kind: type[Struct]) -> None:
    """Raises TypeError where no kernel is registered for parameters of this class; warns of one that reads the time, but lets steps be as
    long as they like."""
    kernels = kernels_of(kind)
    if not kernels:
        raise TypeError(f"the effect {name!r} has no kernel for its parameters: decorate one with @adds_wrench({kind.__name__})")
    read = {word for own in kernels.values() for word in getattr(own, "py_func", own).__code__.co_names}
    if "limit" not in kernels and "time" in read and "time" not in kind.names():
        text = "reads the time, but no kernel of it is decorated with @limits_step: steps may pass over its changes"
        warnings.warn(f"the effect with parameters {kind.__name__} {text}", stacklevel=2)


Class = TypeVar("Class", bound=type[Effect])

EFFECTS: dict[str, type[Effect]] = {}
"""Every registered effect's configuration class, by the name that scenes use."""
STRENGTHS = {"gravity": ("acceleration",), "tip_load": ("force", "moment", "mass"), "fluid": ("density", "current")}
"""Keys of effects, numbers or vectors, whose size says how strong they are."""


def register_effect(name: str) -> Callable[[Class], Class]:
    """Class decorator: make an `Effect` available to scenes as `[effects.name]`.

    Registering a class of the same module and name again replaces it, as in a notebook. Raises ValueError for a name that is taken.
    """

    def add(effect: Class) -> Class:
        present = EFFECTS.get(name, effect)
        if hasattr(Effects, name) or (present.__module__, present.__qualname__) != (effect.__module__, effect.__qualname__):
            raise ValueError(f"the name of the effect {name!r} is taken, by an effect of {present.__module__} or a method of Effects")
        EFFECTS[name] = effect
        return effect

    return add


class Effects(Configuration):
    """The effects of a scene: a table each, by the names of EFFECTS; None where the scene has none of that name."""

    model_config = ConfigDict(extra="allow")

    def __init__(self, /, **tables: Any):
        """Raises ConfigurationError."""
        chosen, problems = {}, list[Problem]()
        for name, table in sorted(tables.items()):
            try:
                if name not in EFFECTS:
                    problems.append(Problem((name,), f"is an unknown key (given {shown(table)}): {not_registered(name, EFFECTS)}"))
                elif isinstance(table, dict | EFFECTS[name]):
                    chosen[name] = EFFECTS[name](**table) if isinstance(table, dict) else table
                elif table is not None:
                    problems.append(Problem((name,), f"is {shown(table)}: it should be a table"))
            except ConfigurationError as error:
                problems += [Problem((name, *key), text) for key, text in error.problems]
        if problems:
            raise ConfigurationError(problems, type(self).__name__)
        super().__init__(**chosen)

    def chosen(self) -> dict[str, Effect]:
        """Effects that the scene has, by name, in the order of their names: that in which they act."""
        return dict(self.__pydantic_extra__ or {})

    def acting(self) -> dict[str, Effect]:
        """Effects whose kernels do anything, by name."""
        return {name: effect for name, effect in self.chosen().items() if effect.acts}

    def table(self, rod: Discretisation) -> EffectTable:
        """Table of the acting effects for the kernels, in the order of their names. Raises TypeError where one has no kernel."""
        effects, parameters, numbers = self.acting(), list[Struct](), dict[str, Any]()
        states = [effect.state(rod) for effect in effects.values()]
        for i, (name, effect) in enumerate(effects.items()):
            parameters.append(Struct() if effect.is_actuation else effect.parameters(rod))
            if not effect.is_actuation:
                _check_kernels(name, type(parameters[i]))
            numbers.update(effect.transmission(rod), **({"filter": i} if effect.is_actuation and states[i].size else {}))
        return EffectTable(parameters, states, DIRECT.replaced(**numbers))

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
        energy, first = 0.0, 0
        for effect in self.chosen().values():
            last = first + effect.state(arm.rod).size
            energy, first = energy + effect.potential_energy(arm._replace(state=arm.state[first:last])), last
        return energy

    @property
    def command_unit(self) -> str:
        """Unit of commands: "N" where they are tensions, as far as the arm is at rest."""
        return next((effect.command_unit for effect in self.chosen().values() if effect.command_unit != "N"), "N")

    def command_limits(self, limits: Array) -> Array:
        """Limits (n_a, 2) of commands where those of tensions are `limits` (n_a, 2) [N]."""
        elastic = self.tendon_elasticity
        return limits if elastic is None else np.tile(np.array(elastic.displacement_limits), (len(limits), 1))

    def _those(self, keep: Callable[[Effect], bool]) -> "Effects":
        return Effects(**{name: effect for name, effect in self.chosen().items() if keep(effect)})

    def on_arm(self) -> "Effects":
        """Effects that act on the arm, without what lies between commands and tensions."""
        return self._those(lambda effect: not effect.is_actuation)

    def everywhere(self) -> "Effects":
        """Effects that act on the arm, and that it does not come upon in places only."""
        return self._those(lambda effect: not (effect.is_contact or effect.is_actuation))

    def outside(self) -> "Effects":
        """Effects without dead loads, which stay outside of a strain with `include_loads`."""
        return self._those(lambda effect: effect.dead_loads() is None)

    def dead_loads(self) -> DeadLoads:
        """The sum of what a strain with `include_loads` answers to."""
        own = [loads for effect in self.chosen().values() if (loads := effect.dead_loads())]
        return DeadLoads(*(tuple(np.sum(vectors, axis=0).tolist()) for vectors in zip(DeadLoads(), *own, strict=True)))

    def solids(self, time: float = 0.0) -> tuple[Solid, ...]:
        """Solids that show all effects at a time [s]."""
        return tuple(solid for effect in self.chosen().values() for solid in effect.solids(time))

    def sample_smaller(self, random: np.random.Generator) -> "Effects":
        """These effects with their STRENGTHS at a random size up to their own, and vectors in random directions."""
        tables = self.model_dump()
        for name in tables:
            drawn = {key: (1.0 - random.random()) * np.array(tables[name][key]) for key in STRENGTHS.get(name, ())}
            for key, own in drawn.items():
                direction = random.normal(size=own.size) if own.ndim else np.ones(1)
                tables[name][key] = (np.linalg.norm(own) / np.linalg.norm(direction) * direction) if own.ndim else own
        return Effects(**tables)

    def includes(self, other: "Effects") -> bool:
        """Whether `sample_smaller` reaches all of the other effects: what was made under these holds under those."""
        own = self.model_dump()
        for name, table in other.everywhere().model_dump().items():
            mine, strong = own.get(name), STRENGTHS.get(name, ())
            weaker = mine and any(np.linalg.norm(mine[key]) < np.linalg.norm(table[key]) for key in strong)
            if mine is None or weaker or any(mine[key] != value for key, value in table.items() if key not in strong):
                return False
        return True

    def __getattr__(self, name: str) -> Any:
        """The effect of this name, None where the scene has none."""
        if name in EFFECTS:
            return self.chosen().get(name)
        return super().__getattr__(name)  # type: ignore[misc] # which pydantic hides
