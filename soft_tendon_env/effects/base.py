"""Effects: what acts on the arm besides its tendons, and the table by which a scene names them.

An effect is a configuration class under `@register("effect", "name")`, its parameters, a `Struct`
of numbers and arrays, and the kernels that it needs, see mechanics/effects.py; here or in a user's
own file as `examples/own_effect.py`. It is then the optional table `[effects.name]` of every scene.
A scene without that table neither compiles nor calls it.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import ConfigDict

from soft_tendon_env.mechanics.algebra.structs import Struct
from soft_tendon_env.mechanics.effects import DIRECT, EffectTable, kernels_of
from soft_tendon_env.tools.configuration import (
    Configuration,
    ConfigurationError,
    Problem,
    not_registered,
    shown,
)
from soft_tendon_env.tools.registry import Registry, check_class
from soft_tendon_env.tools.types import Array as Array


@dataclass(frozen=True)
class Discretisation:
    """Discretised rod as effects see it when their parameters are made.

    It has slices around nodes, and quadrature points.

    Arrays over nodes and points are in order from base to tip; `mechanics.types.node_field` and
    `point_field` lay them out for kernels. `over_nodes` leaves out the share of the base, which
    does not move: a density of 1 can give 0.285 m in all on a rod of 0.3 m.
    """

    length: float  # [m] of the rod
    # arc lengths [m] of base, tip and ends of tendons and segments, between which all fields are
    # smooth
    borders: Array
    node: Array  # (nodes,) arc lengths [m]
    point: Array  # (nodes, 2) arc lengths [m]
    # [m] of the circle around the rod at arc lengths (m,) [m], (m,)
    radius: Callable[[Array], Array]
    # widths along y and z [m], perimeter [m] and area [m^2] of the rod's outline there, (4, m)
    hull: Callable[[Array], Array]
    has_corners: Callable[[Array], Array]  # whether that outline is a rectangle, else an ellipse
    discs: Array  # (d, 4) arc length [m], mass [kg], radius and thickness [m] of the spacer discs
    # screw elasticity diag(Sigma) [N m^2, N] of the section there, (m, 6)
    elasticity: Callable[[Array], Array]
    line_mass: Callable[[Array], Array]  # mass per length [kg/m] there, (m,)
    # integral of a line density, (m,) to (m, k), over each slice, (nodes, k)
    over_nodes: Callable[[Callable[[Array], Array]], Array]
    tendon_length: Array  # (n_a,) [m] along the stress-free rod
    tendon_turn: Array  # (n_a,) [rad] by which the tendons turn along it
    tension_limits: Array  # (n_a, 2) [N]
    # all of the scene, for those that depend on another one, as buoyancy on gravity
    effects: "Effects"
    step: float  # [s], the longest time step of the scene's integrator

    def half_widths(self, arc_length: Array) -> Array:
        """Returns half widths of the rod's outline along y and z.

        Args:
            arc_length: Arc lengths (m,) [m].

        Returns:
            Half widths (2, m) [m].
        """
        return 0.5 * self.hull(arc_length)[:2]


class Configured(NamedTuple):
    """Configuration of an arm, at which effects give their potential energy."""

    mass: Array  # (nodes,) [kg], of the rod and its payload
    pose: Array  # (nodes, 4, 4)
    strain: Array  # (points, 6), less the stress-free one
    weight: Array  # (points,) [m]
    stiffness: Array  # (points, 6) diag(Sigma), 0 for rigid strains
    rod: Discretisation  # of the arm
    base: Array  # (12,) pose of the base, R rows and r, world frame
    state: Array  # (m,) internal state of the effect


class DeadLoads(NamedTuple):
    """Loads whose size and direction in the world frame never change.

    A strain can have them inside, see paper III-B.
    """

    acceleration: tuple[float, ...] = (0.0, 0.0, 0.0)  # [m/s^2] of all mass, payload included
    force: tuple[float, ...] = (0.0, 0.0, 0.0)  # [N] at the tip
    moment: tuple[float, ...] = (0.0, 0.0, 0.0)  # [N m] at the tip


class Effect(Configuration):
    """Base class of effects: the validated table of a scene.

    Attributes:
        is_contact: whether the arm comes upon it in places only, as upon obstacles: passive fields
            are made without it.
        is_actuation: whether it lies between commands and tensions, as numbers of the
            `transmission`: what is told of the arm under given tensions is without it.
        command_unit: unit of the commands that it takes; "N": the tension that comes of them at
            rest.
        strengths: keys, of numbers or vectors, whose size says how strong it is: passive fields
            made under it hold under weaker ones.
        is_uniform: whether it is the same everywhere in the world, so that the place of the base
            changes nothing.
    """

    strengths: ClassVar[tuple[str, ...]] = ()
    is_uniform: ClassVar[bool] = False
    is_contact: ClassVar[bool] = False
    is_actuation: ClassVar[bool] = False
    command_unit: ClassVar[str] = "N"

    @property
    def acts(self) -> bool:
        """Tells whether its kernels do anything with these numbers.

        One that does not costs nothing, as a payload without a force.
        """
        return True

    def parameters(self, rod: Discretisation) -> Any:
        """Returns the parameters that the kernels read.

        Args:
            rod: the discretised rod.

        Returns:
            An instance of the effect's own `Struct` class, see mechanics/effects.py.

        Raises:
            NotImplementedError: unless a class has the method.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method parameters(rod)")

    def transmission(self, rod: Discretisation) -> dict[str, Any]:
        """Returns the numbers of an effect between commands and tensions.

        Args:
            rod: the discretised rod.

        Returns:
            Numbers of `mechanics.effects.Transmission` by name.
        """
        return {}

    def added_inertia(self, rod: Discretisation) -> Array:
        """Returns the screw inertia that moves with the slices of the rod, about their axes.

        It is zero unless a class says otherwise.

        Args:
            rod: the discretised rod.

        Returns:
            Inertia (nodes, 6) [kg m^2, kg].
        """
        return np.zeros((rod.node.size, 6))

    @property
    def payload(self) -> Array:
        """Screw inertia (6,) [kg m^2, kg] of a body fixed to the tip, at which gravity pulls.

        It is zero unless a class says otherwise.
        """
        return np.zeros(6)

    def state(self, rod: Discretisation) -> Array:
        """Returns the internal state of the effect in the stress-free arm that is at rest.

        The arm has always been at rest. There is no state unless a class says so.

        Args:
            rod: the discretised rod.

        Returns:
            The state (m,).
        """
        return np.zeros(0)

    def potential_energy(self, arm: Configured) -> float:
        """Computes the potential energy of the effect.

        It is 0 of an effect between commands and tensions.

        Args:
            arm: configuration of the arm.

        Returns:
            Energy [J].

        Raises:
            ValueError: where the effect has no potential, as by default.
        """
        if self.is_actuation and self.command_unit == "N":
            return 0.0
        raise ValueError(f"the effect {type(self).__name__} has no potential energy")

    def dead_loads(self) -> DeadLoads | None:
        """Returns dead loads in place of the kernel, for a strain with `include_loads`.

        Returns:
            All that the kernel would add, or None.
        """
        return None


def _parameters_of(name: str, effect: Effect, rod: Discretisation) -> Struct:
    """The parameters of an effect that acts by kernels.

    Raises TypeError where no kernel is for them; warns of one that reads the time, but limits no
    step.
    """
    parameters = effect.parameters(rod)
    kind = type(parameters).__name__
    kernels = kernels_of(type(parameters))
    if not kernels:
        raise TypeError(
            f"the effect {name!r} has no kernel for its parameters: decorate one with"
            f" @adds_wrench({kind})"
        )
    names = set[str]()
    for kernel in kernels.values():
        names |= {*getattr(kernel, "py_func", kernel).__code__.co_names}
    reads_time = "time" in names and "time" not in type(parameters).names()
    if reads_time and "limit" not in kernels:
        warnings.warn(
            f"the effect with parameters {kind} reads the time, but no kernel of it is decorated"
            " with @limits_step: steps may pass over its changes",
            stacklevel=2,
        )
    return parameters


def _transmission_of(effect: Effect, rod: Discretisation) -> dict[str, Any]:
    """Numbers of the transmission that an effect gives.

    Raises TypeError for other names or types than kernels read.
    """
    known = {key: type(value) for key, value in DIRECT.fields().items() if key != "filter"}
    numbers = effect.transmission(rod)
    for key, value in numbers.items():
        if known.get(key) is not type(value):
            names = [f"{name} ({kind.__name__})" for name, kind in known.items()]
            allowed = ", ".join(names)
            raise TypeError(
                f"{type(effect).__name__}.transmission gives {key} = {shown(value)}: it may give"
                f" {allowed}"
            )
    return numbers


def _checked_effect(name: str, effect: Any) -> type[Effect]:
    """The class of an effect. Raises TypeError, ValueError where it lacks something."""
    check_class("effect", name, effect, Effect)
    if hasattr(Effects, name):
        raise ValueError(f"the name of the effect {name!r} is taken, by a method of Effects")
    if effect.parameters is Effect.parameters and not effect.is_actuation:
        raise TypeError(
            f"the effect {name!r}, {effect.__qualname__}, lacks a method parameters(rod), whose"
            " Struct its kernels read"
        )
    return effect


EFFECTS: Registry[type[Effect]] = Registry("effect", _checked_effect)
"""Every registered effect's configuration class, by the name that scenes use."""


class Effects(Configuration):
    """Effects of a scene, a table each, by the names of EFFECTS.

    None where the scene has none of that name.
    """

    model_config = ConfigDict(extra="allow")

    def __init__(self, /, **tables: Any):
        """Raises ConfigurationError."""
        chosen = {}
        problems = list[Problem]()
        for name, table in sorted(tables.items()):
            if name not in EFFECTS:
                reason = not_registered(name, EFFECTS)
                text = f"is an unknown key (given {shown(table)}): {reason}"
                problems.append(Problem((name,), text))
            elif isinstance(table, EFFECTS[name]):
                chosen[name] = table
            elif isinstance(table, dict):
                try:
                    chosen[name] = EFFECTS[name](**table)
                except ConfigurationError as error:
                    problems += [Problem((name, *key), text) for key, text in error.problems]
            elif table is not None:
                problems.append(Problem((name,), f"is {shown(table)}: it should be a table"))
        if problems:
            raise ConfigurationError(problems, type(self).__name__)
        super().__init__(**chosen)

    def chosen(self) -> dict[str, Effect]:
        """Effects that the scene has, by name, in the order of their names.

        In that order they act.
        """
        return dict(self.__pydantic_extra__ or {})

    def acting(self) -> dict[str, Effect]:
        """Effects whose kernels do anything, by name."""
        return {name: effect for name, effect in self.chosen().items() if effect.acts}

    def table(self, rod: Discretisation) -> EffectTable:
        """Table of the acting effects for the kernels, in the order of their names.

        Raises TypeError where one has no kernel.
        """
        parameters = list[Struct]()
        states = list[Array]()
        numbers = dict[str, Any]()
        for i, (name, effect) in enumerate(self.acting().items()):
            # first: it refuses numbers whose state would fill the memory
            numbers |= _transmission_of(effect, rod)
            state = effect.state(rod)
            states.append(state)
            if effect.is_actuation:  # it acts by the transmission alone
                parameters.append(Struct())
                if state.size:
                    numbers["filter"] = i
            else:
                parameters.append(_parameters_of(name, effect, rod))
        return EffectTable(parameters, states, DIRECT.replaced(**numbers))

    def added_inertia(self, rod: Discretisation) -> Array:
        """Screw inertia (nodes, 6) that the effects add to the slices of the rod."""
        return sum(
            (effect.added_inertia(rod) for effect in self.chosen().values()),
            np.zeros((rod.node.size, 6)),
        )

    @property
    def payload(self) -> Array:
        """Screw inertia (6,) of what is fixed to the tip."""
        return sum((effect.payload for effect in self.chosen().values()), np.zeros(6))

    def potential_energy(self, arm: Configured) -> float:
        """Potential energy [J] of all effects, `arm.state` being those of all in turn.

        Raises ValueError where one has none.
        """
        energy = 0.0
        first = 0
        for effect in self.chosen().values():
            last = first + effect.state(arm.rod).size
            energy += effect.potential_energy(arm._replace(state=arm.state[first:last]))
            first = last
        return energy

    @property
    def command_unit(self) -> str:
        """Unit of commands: "N" where they are tensions, as far as the arm is at rest."""
        for effect in self.chosen().values():
            if effect.command_unit != "N":
                return effect.command_unit
        return "N"

    def command_limits(self, limits: Array) -> Array:
        """Limits (n_a, 2) of commands where those of tensions are `limits` (n_a, 2) [N]."""
        elastic = self.tendon_elasticity
        if elastic is None:
            return limits
        return np.tile(np.array(elastic.displacement_limits), (len(limits), 1))

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
        total = np.zeros((len(DeadLoads._fields), 3))
        for effect in self.chosen().values():
            loads = effect.dead_loads()
            if loads is not None:
                total += np.array(loads)
        vectors = [tuple(vector) for vector in total.tolist()]
        return DeadLoads(*vectors)

    def sample_smaller(self, random: np.random.Generator) -> "Effects":
        """These effects with their `strengths` at a random size up to their own.

        Vectors have random directions.
        """
        tables = self.model_dump()
        for name, effect in self.chosen().items():
            table = tables[name]
            # all sizes are drawn before the directions
            smaller = {}
            for key in effect.strengths:
                share = 1.0 - random.random()
                smaller[key] = share * np.array(table[key])
            for key, value in smaller.items():
                table[key] = value
                if value.ndim:
                    direction = random.normal(size=value.size)
                    size = np.linalg.norm(value) / np.linalg.norm(direction)
                    table[key] = size * direction
        return Effects(**tables)

    def includes(self, other: "Effects") -> bool:
        """Tells whether `sample_smaller` reaches all of the other effects.

        What was made under these then holds under those.
        """
        most = self.model_dump()
        for name, effect in other.everywhere().chosen().items():
            if name not in most:
                return False
            for key, value in effect.model_dump().items():
                greatest = most[name][key]
                is_weaker = key in effect.strengths and (
                    np.linalg.norm(value) <= np.linalg.norm(greatest)
                )
                if not is_weaker and value != greatest:
                    return False
        return True

    def __getattr__(self, name: str) -> Any:
        """The effect of this name, None where the scene has none."""
        if name in EFFECTS:
            return self.chosen().get(name)
        return super().__getattr__(name)  # type: ignore[misc] # which pydantic hides
