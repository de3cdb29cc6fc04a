"""Reduced-order Cosserat-rod model of a scene: terms of the equation of motion, kinematics and
energies at given coordinates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Configured, Discretisation, Effect
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.terms.evaluate import (
    TOO_FAST,
    TOO_LARGE,
    configure,
    equation_of_motion,
)
from soft_tendon_env.mechanics.terms.kinematics import poses_inside, strains_inside
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.tendons import tendon_lengths
from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded
from soft_tendon_env.mechanics.workspace import Workspace, make_workspace
from soft_tendon_env.model.coordinates import effects_outside, make_arm
from soft_tendon_env.model.grid import Grid, at_points, make_grid, screw_matrices
from soft_tendon_env.model.strain_limits import StrainLimitError, nearest_limit
from soft_tendon_env.model.terms import Energy, Terms
from soft_tendon_env.scene.parameters import scene_parameters, scene_with_numbers
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.tools.checks import checked_array, checked_count, checked_number
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.forks import cached_property
from soft_tendon_env.tools.types import Array

# relative size of the last Newton correction at which a strain counts as found: round-off
TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Model:
    """Reduced-order Cosserat-rod model of a tendon-driven arm, made by `build_model` from a scene;
    it never changes.

    Coordinates q (n,) of the statics-based strain are the tensions [N] that determine the strain
    (combinations of them if tendons are redundant), then the passive coordinates. With an explicit
    basis they are the amplitudes of its fields. Methods raise ValueError or TypeError for bad
    arrays, `StrainLimitError` if no strain balances the coordinates, and OverflowError for absurd
    rates.
    """

    scene: Scene
    grid: Grid  # intervals and quadrature points along the rod
    arm: Arm  # what the compiled kernels read
    _idle: list[Workspace] = field(
        default_factory=list
    )  # wait for the next evaluation: making one takes longer than to fill it

    def __repr__(self) -> str:
        return (
            f"Model({self.scene.name!r}, {self.coordinate_count} coordinates, {self.tendon_count}"
            " tendons)"
        )

    def with_scene(self, scene: Scene) -> Model:
        """Model of a scene with other numbers or effects; grid, combinations of tensions and fields
        stay. Raises ConfigurationError."""
        arm = make_arm(scene, self.grid, self.arm.strain)
        sizes = [
            (type(arm.strain), arm.effects.count, arm.effects.state.size) for arm in (self.arm, arm)
        ]
        return Model(scene, self.grid, arm, self._idle if sizes[0] == sizes[1] else [])

    def with_numbers(self, changes: Mapping[str, float]) -> Model:
        """Model `with_scene` of other numbers, `{"segments.*.young_modulus": 1.1e6}`.

        Raises TypeError or ConfigurationError.
        """
        scene_parameters(self.scene, changes)
        made = self.with_scene(scene_with_numbers(self.scene, changes))
        if misfit := self.misfit(made):
            raise ConfigurationError(
                [
                    Problem((key,), f"changes {misfit}: build a model for each value")
                    for key in changes
                ]
            )
        return made

    def misfit(self, other: Model) -> str:
        """Difference other than in numbers of a model `with_scene`; "": there is none, and both can
        be rows of one batch."""
        if type(other.arm.strain) is not type(self.arm.strain):
            return "whether there are loads inside of the strain"
        here, there, ours, theirs = (
            [*self.acting],
            [*other.acting],
            self.arm.effects,
            other.arm.effects,
        )
        if there[: len(here)] != here:
            return (
                f"which effects act, from {', '.join(here) or 'none'} to"
                f" {', '.join(there) or 'none'}"
            )
        sizes = [
            [np.shape(values) for struct in table.structs[: len(here)] for values in struct]
            for table in (ours, theirs)
        ]
        is_alike = sizes[0] == sizes[1] and np.array_equal(
            ours.first_state, theirs.first_state[: len(here) + 1]
        )
        return (
            ""
            if is_alike and theirs.state.size <= ours.state.size
            else "the number of internal states, or of places, of an effect"
        )

    @property
    def coordinate_count(self) -> int:
        """Number of coordinates n."""
        return self.arm.strain.size

    @property
    def tendon_count(self) -> int:
        """Number of tendons n_a."""
        return self.arm.tendons.size

    def terms(
        self, q: ArrayLike, q_dot: ArrayLike, tension: ArrayLike | None = None, *, time: float = 0.0
    ) -> Terms:
        """Terms of the equation of motion (23) at q, q_dot (n,), the effects' internal states at
        rest at q.

        `tension` (n_a,) matters to `stiffness` of explicit bases only; on time [s] disturbances and
        a moving base depend.
        """
        with self.workspace() as work:
            return self._evaluate(
                tension, q, q_dot, checked_number("time", time, -np.inf, "a finite number"), work
            )

    def tip_pose(self, q: ArrayLike) -> Array:
        """Pose of the tip in the world frame, (4, 4): forward kinematics."""
        with self.configuration(q) as work:
            return _poses(work.kinematics.pose.reshape(-1, 12, LANES)[-1:, :, -1])[0]

    def backbone(self, q: ArrayLike, points: int = 50) -> Array:
        """Backbone: poses of the sections at `points` arc lengths evenly from base to tip, (points,
        4, 4)."""
        return self.backbone_at(
            q, np.linspace(0.0, self.length, checked_count("points", points, 1))
        )

    def backbone_at(self, q: ArrayLike, arc_length: ArrayLike) -> Array:
        """Backbone at the given arc lengths (m,) [m]: poses of the sections, (m, 4, 4)."""
        places = self.arc_lengths("arc_length", arc_length)
        poses = np.tile(np.eye(4), (places.size, 1, 1))
        with self.configuration(q) as work:
            xi = work.strain.xi
            located = self.grid.locate(places)
            poses_inside(self.grid.length, *located, xi, work.kinematics, poses)
        return poses

    def strain_at(self, q: ArrayLike, arc_length: ArrayLike) -> tuple[Array, Array]:
        """Strains (m, 6) at arc lengths (m,) [m] and their derivative Phi (m, 6, n), linear between
        the two points of an interval."""
        places, q = (
            self.arc_lengths("arc_length", arc_length),
            checked_array("q", q, (self.coordinate_count,)),
        )
        found = np.empty((1 + q.size, places.size, 6))
        with self.configuration(q) as work:
            strain = work.strain
            still = np.zeros_like(q)
            no_tension = np.zeros(self.tendon_count)
            strain_from_guess(self.arm, q, TOLERANCE, strain, work.kinematics)
            strain_columns(self.arm, no_tension, q, still, strain, work.kinematics)
            fields = [strain.xi, *strain.Phi.reshape(q.size, -1)]
            for values, out in zip(fields, found, strict=True):
                strains_inside(self.grid.length, *self.grid.locate(places), values, out)
        return found[0], np.moveaxis(found[1:], 0, 2)

    @cached_property
    def discretisation(self) -> Discretisation:
        """The discretised rod as effects see it."""
        return at_points(self.scene, self.grid).rod

    @property
    def acting(self) -> dict[str, Effect]:
        """The effects that act as forces on the coordinates, by name, in the order of the arm's
        table of effects."""
        return effects_outside(self.scene).acting()

    @property
    def length(self) -> float:
        """Length of the unstrained rod [m]."""
        return float(self.grid.breakpoints[-1])

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Meaning of the numbers of a state: effects with internal states or other commands than
        tensions, "actuators:20"; times."""
        effects = zip(
            self.acting.items(), np.diff(self.arm.effects.first_state).tolist(), strict=True
        )
        names = tuple(
            f"{name}:{size}"
            for (name, effect), size in effects
            if size or effect.command_unit != "N"
        )
        memory = self.scene.effects.viscoelastic_memory
        return (
            names
            if memory is None
            else (
                *names,
                f"relaxation times {[branch.relaxation_time for branch in memory.branches]} s",
            )
        )

    @cached_property
    def metric(self) -> Array:
        """G (n, n) of the unloaded arm, its symmetric part: the metric in which coordinates are
        compared."""
        G = self.terms(rest := np.zeros(self.coordinate_count), rest).stiffness
        return np.asarray(0.5 * (G + G.T))

    @cached_property
    def metric_unit(self) -> Array:
        """Coordinates (n, n) that are orthonormal in the metric, unit^T G unit = 1."""
        return np.linalg.inv(np.linalg.cholesky(self.metric)).T

    @cached_property
    def bending_energy(self) -> float:
        """Twice the energy [J] of the rod bent evenly by an angle of 1: the unit in which
        stiffnesses of coordinates compare."""
        bending = screw_matrices(self.scene, self.grid.points.ravel())[0][:, 1]
        return float(bending @ self.grid.weights.ravel()) / self.length**2

    def strain(self, q: ArrayLike) -> tuple[Array, Array]:
        """Strain field: arc lengths (m,) [m] of the quadrature points and the strains xi = (k, p)
        there, (m, 6)."""
        return self.grid.points[self.grid.real].ravel(), self.grid.unpacked(self.packed_strain(q))

    def packed_strain(self, q: ArrayLike) -> Array:
        """The strain at the points in the kernels' flat layout (points * 6,), see mechanics.types."""
        with self.configuration(q) as work:
            return work.strain.xi.copy()

    def tendon_lengths(self, q: ArrayLike) -> Array:
        """Lengths of the tendons along the strained rod (n_a,) [m]."""
        lengths = np.empty(self.tendon_count)
        with self.configuration(q) as work:
            tendon_lengths(self.arm.rod, self.arm.tendons, work.strain.xi, lengths)
        return lengths

    def energy(self, q: ArrayLike, q_dot: ArrayLike, effects: ArrayLike | None = None) -> Energy:
        """Kinetic, elastic and load energy; effects (m,): internal states, by default at rest.

        Raises ValueError without a potential.
        """
        rod, grid, rate = (
            self.arm.rod,
            self.grid,
            checked_array("q_dot", q_dot, (self.coordinate_count,)),
        )
        with self.workspace() as work:
            mass = self._evaluate(None, q, rate, 0.0, work).mass
            strain, state = (
                grid.at_points(work.strain.xi - rod.reference_strain, 6).reshape(-1, 6),
                work.inputs.state.copy(),
            )
            by_node = work.kinematics.pose.reshape(-1, 12, LANES).swapaxes(1, 2).reshape(-1, 12)
        state = state if effects is None else checked_array("effects", effects, state.shape)
        stiffness, weight = (
            grid.at_points(rod.root_stiffness, 6).reshape(-1, 6) ** 2,
            grid.weights.ravel(),
        )
        configured = Configured(
            rod.node_mass,
            _poses(by_node),
            strain,
            weight,
            stiffness,
            self.discretisation,
            self.arm.base,
            state,
        )
        elastic = 0.5 * float(weight @ (stiffness * strain**2).sum(axis=1))
        return Energy(
            0.5 * float(rate @ mass @ rate),
            elastic,
            self.scene.effects.potential_energy(configured),
        )

    @property
    def command_unit(self) -> str:
        """Unit of commands: "N" where they are tensions, "m" where they are displacements of
        elastic tendons' actuators."""
        return self.scene.effects.command_unit

    def command(self, tension: ArrayLike, q: ArrayLike) -> Array:
        """The command (n_a,), tensions [N] or displacements [m], that holds tensions (n_a,) [N] at
        rest at q (n,)."""
        u, path = (
            checked_array("tension", tension, (self.tendon_count,)),
            self.arm.effects.transmission,
        )
        return (
            np.asarray(u / path.stiffness + path.length - self.tendon_lengths(q))
            if path.elastic
            else u
        )

    def rest_coordinates(self, tension: ArrayLike) -> Array:
        """Coordinates (n,) at rest under tensions (n_a,) [N] alone, [u; 0] of (34); statics-based
        strain only, else ValueError."""
        u = checked_array("tension", tension, (self.tendon_count,))
        if isinstance(self.arm.strain, Explicit):
            raise ValueError(
                "an explicit basis has no coordinates that equal tensions; use static_equilibrium"
            )
        return self.arm.strain.rest_coordinates(u)

    def coordinate_scale(self) -> Array:
        """Unit of each coordinate (n,): the amplitude that stores as much energy as bending the arm
        by 1 rad."""
        return np.asarray(np.sqrt(self.bending_energy / np.diag(self.metric)))

    def arc_lengths(self, name: str, value: ArrayLike) -> Array:
        """Arc lengths (m,) [m] along the rod, checked.

        Raises TypeError or ValueError naming `name`.
        """
        places = checked_array(name, np.zeros(0) if np.size(value) == 0 else value, (None,))
        if places.size and not (places.min() >= 0.0 and places.max() <= self.length * (1 + 1e-12)):
            raise ValueError(
                f"{name} should lie between 0 and {self.length:g}, not {places.min():g} to"
                f" {places.max():g}"
            )
        return places

    @contextmanager
    def workspace(self) -> Iterator[Workspace]:
        """A workspace that nobody else uses, with the effects' states at rest; what it holds
        otherwise is of evaluations before."""
        try:
            work = self._idle.pop()
        except IndexError:  # asked for and taken at once, for threads
            work = make_workspace(self.arm)
        work.inputs.state[:] = self.arm.effects.state
        work.inputs.clock[:] = 0.0
        try:
            yield work
        finally:
            self._idle.append(work)

    @contextmanager
    def configuration(self, q: ArrayLike) -> Iterator[Workspace]:
        """A workspace with strains and poses at q (n,).

        Raises StrainLimitError.
        """
        q = checked_array("q", q, (self.coordinate_count,))
        with self.workspace() as work:
            block, reached = configure(self.arm, q, TOLERANCE, work)
            self._check(q, work, block, reached, bool(np.isfinite(work.kinematics.pose).all()))
            yield work

    def _check(self, q: Array, work: Workspace, block: int, reached: float, placed: bool) -> None:
        """Raises StrainLimitError where the strain could not be found at a block, of -1 for none,
        or the rod could not be placed."""
        if block >= 0:
            nearest = nearest_limit(self.arm, self.grid, q, work.strain.xi, reached, block)
            what = "coordinates and loads" if isinstance(self.arm.strain, Loaded) else "coordinates"
            raise StrainLimitError(
                f"no strain balances these {what} beyond {100 * reached:.3g} % of them: {nearest}"
            )
        if not placed:
            raise StrainLimitError(
                f"the coordinates are too large to place the rod, up to {np.abs(q).max():.3g}"
            )

    def _evaluate(
        self, u: ArrayLike | None, q: ArrayLike, q_dot: ArrayLike, time: float, work: Workspace
    ) -> Terms:
        q, q_dot = (
            checked_array("q", q, (self.coordinate_count,)),
            checked_array("q_dot", q_dot, (self.coordinate_count,)),
        )
        tension = (
            np.zeros(self.tendon_count)
            if u is None
            else checked_array("tension", u, (self.tendon_count,))
        )
        work.inputs.clock[0] = time
        n, n_a = self.coordinate_count, self.tendon_count
        shapes: list[tuple[int, ...]] = [
            (n, n),
            (n,),
            (n, n),
            (n, n),
            (n, n_a),
            (n,),
            (n,),
            (4, 4),
            (6, n),
            (6,),
            (n, n),
            (n, n),
        ]
        out = Terms(*(np.empty(shape) for shape in shapes))
        block, reached, placed = equation_of_motion(
            self.arm, tension, q, q_dot, work.inputs.state.size > 0, TOLERANCE, work, out
        )
        self._check(q, work, block, reached, placed != TOO_LARGE)
        if placed == TOO_FAST:
            raise OverflowError(
                f"the rates q_dot are too large to compute with, up to {np.abs(q_dot).max():.3g}"
            )
        strain = self.arm.strain
        out.elastic_force[:] = (
            strain.stiffness if isinstance(strain, Explicit) else out.stiffness
        ) @ q
        return out

    def __reduce__(self) -> tuple[type[Model], tuple[Scene, Grid, Arm]]:
        return Model, (self.scene, self.grid, self.arm)

    def __deepcopy__(self, memo: object) -> Model:
        return self  # copies of what has a model share it, since it never changes


def model_on(scene: Scene, intervals: int) -> Model:
    """Model of a scene on a quadrature with this many intervals per piece, whatever the scene says,
    and however coarse that is."""
    grid = make_grid(scene, intervals)
    return Model(scene, grid, make_arm(scene, grid))


def is_singular(matrix: Array) -> bool:
    """Whether the least eigenvalue of a matrix, scaled to a unit diagonal, is 0 to round-off."""
    scale = np.sqrt(np.diag(matrix))
    return not (
        scale.min() > 0.0 and np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] > 1e-14
    )


def _poses(rows: Array) -> Array:
    """Poses (m, 4, 4) of rotations, row by row, and positions (m, 12)."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    return poses
