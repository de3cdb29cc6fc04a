"""Reduced-order Cosserat-rod model of a scene.

It has the terms of the equation of motion, kinematics and energies at given coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Configured, Discretisation, Effect
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.effects import EffectTable
from soft_tendon_env.mechanics.terms.evaluate import (
    TOO_FAST,
    TOO_LARGE,
    configure,
    equation_of_motion,
)
from soft_tendon_env.mechanics.terms.kinematics import columns_inside, poses_inside, strains_inside
from soft_tendon_env.mechanics.terms.parametrisation import strain_columns, strain_from_guess
from soft_tendon_env.mechanics.terms.tendons import tendon_lengths
from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded
from soft_tendon_env.mechanics.workspace import Workspace, make_workspace
from soft_tendon_env.model.arm import make_arm
from soft_tendon_env.model.coordinates import effects_outside
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
    """Reduced-order Cosserat-rod model of a tendon-driven arm; it never changes.

    `build_model` makes it from a scene.

    Coordinates q (n,) of the statics-based strain are the tensions [N] that determine the strain
    (combinations of them if tendons are redundant), then the passive coordinates. With an explicit
    basis they are the amplitudes of its fields. Methods raise ValueError or TypeError for bad
    arrays, `StrainLimitError` if no strain balances the coordinates, and OverflowError for absurd
    rates.
    """

    scene: Scene  # that it was made from
    grid: Grid  # intervals and quadrature points along the rod
    arm: Arm  # what the compiled kernels read
    # wait for the next evaluation: making one takes longer than to fill it
    _idle: list[Workspace] = field(default_factory=list)

    def __repr__(self) -> str:
        return (
            f"Model({self.scene.name!r}, {self.coordinate_count} coordinates, {self.tendon_count}"
            " tendons)"
        )

    def with_scene(self, scene: Scene) -> Model:
        """Returns the model of a scene with other numbers or effects.

        Grid, combinations of tensions and strain fields stay.

        Args:
            scene: of the same arm.

        Returns:
            The new model.

        Raises:
            ConfigurationError: for an arm that cannot be computed.
        """
        arm = make_arm(scene, self.grid, self.arm.strain)
        # workspaces serve every arm of the same sizes
        own_kind = _workspace_kind(self.arm)
        if _workspace_kind(arm) == own_kind:
            idle = self._idle
        else:
            idle = []
        return Model(scene, self.grid, arm, idle)

    def with_numbers(self, changes: Mapping[str, float]) -> Model:
        """Returns the model with other numbers in its scene.

        Args:
            changes: numbers by keys of the scene, `{"segments.*.young_modulus": 1.1e6}`.

        Returns:
            The new model, with the same grid and strain fields.

        Raises:
            TypeError: for values that are no numbers.
            ConfigurationError: for keys or values that the scene does not allow, or numbers that
                need a model of their own.
        """
        scene_parameters(self.scene, changes)
        model = self.with_scene(scene_with_numbers(self.scene, changes))
        misfit = self.misfit(model)
        if misfit:
            text = f"changes {misfit}: build a model for each value"
            problems = [Problem((key,), text) for key in changes]
            raise ConfigurationError(problems)
        return model

    def misfit(self, other: Model) -> str:
        """Difference other than in numbers of a model `with_scene`, in words.

        It is empty where there is none, so that both can be rows of one batch.
        """
        other_kind = type(other.arm.strain)
        own_kind = type(self.arm.strain)
        if other_kind is not own_kind:
            return "whether there are loads inside of the strain"
        own_names = [*self.acting]
        other_names = [*other.acting]
        count = len(own_names)
        if other_names[:count] != own_names:
            own_list = ", ".join(own_names) or "none"
            other_list = ", ".join(other_names) or "none"
            return f"which effects act, from {own_list} to {other_list}"
        own = self.arm.effects
        others = other.arm.effects
        own_shapes = _shapes(own, count)
        other_shapes = _shapes(others, count)
        has_same_shapes = own_shapes == other_shapes
        first_states = others.first_state[: count + 1]
        has_same_states = np.array_equal(own.first_state, first_states)
        has_room = others.state.size <= own.state.size
        if has_same_shapes and has_same_states and has_room:
            return ""
        return "the number of internal states, or of places, of an effect"

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
        """Computes the terms of the equation of motion (23) at coordinates and rates.

        The effects' internal states are at rest at q.

        Args:
            q: coordinates (n,).
            q_dot: rates (n,).
            tension: (n_a,) [N], which matters to `stiffness` of explicit bases only.
            time: [s], on which disturbances and a moving base depend.

        Returns:
            The matrices and forces, tip pose and tip Jacobian.

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
            OverflowError: for absurd rates.
        """
        time = checked_number("time", time, -np.inf, "a finite number")
        with self.workspace() as work:
            return self._evaluate(tension, q, q_dot, time, work)

    def tip_pose(self, q: ArrayLike) -> Array:
        """Computes the pose of the tip in the world frame: forward kinematics.

        Args:
            q: coordinates (n,).

        Returns:
            The pose (4, 4), its translation in [m].

        Raises:
            TypeError: for an array that is not of numbers.
            ValueError: for a wrong shape or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
        """
        with self.configuration(q) as work:
            # the tip is the last lane of the last pack
            by_pack = work.kinematics.pose.reshape(-1, 12, LANES)
            tip = by_pack[-1:, :, -1]
            return _poses(tip)[0]

    def backbone(self, q: ArrayLike, points: int = 50) -> Array:
        """Computes the backbone: poses of the sections at equal distances from base to tip.

        Args:
            q: coordinates (n,).
            points: number of sections.

        Returns:
            Poses (points, 4, 4) in the world frame, their translations in [m].

        Raises:
            TypeError: for arguments that are no numbers.
            ValueError: for a wrong shape, numbers that are not finite, or fewer than one point.
            StrainLimitError: if no strain balances the coordinates.
        """
        count = checked_count("points", points, 1)
        places = np.linspace(0.0, self.length, count)
        return self.backbone_at(q, places)

    def backbone_at(self, q: ArrayLike, arc_length: ArrayLike) -> Array:
        """Computes the backbone at arc lengths: poses of the sections there.

        Args:
            q: coordinates (n,).
            arc_length: (m,) [m] from the base.

        Returns:
            Poses (m, 4, 4) in the world frame, their translations in [m].

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes, or arc lengths beyond the rod.
            StrainLimitError: if no strain balances the coordinates.
        """
        places = self.arc_lengths("arc_length", arc_length)
        shape = (places.size, 1, 1)
        poses = np.tile(np.eye(4), shape)
        with self.configuration(q) as work:
            xi = work.strain.xi
            located = self.grid.locate(places)
            poses_inside(self.grid.length, *located, xi, work.kinematics, poses)
        return poses

    def strain_at(self, q: ArrayLike, arc_length: ArrayLike) -> tuple[Array, Array]:
        """Computes strains and their derivatives at arc lengths.

        Both are linear between the two points of an interval.

        Args:
            q: coordinates (n,).
            arc_length: (m,) [m] from the base.

        Returns:
            Strains (m, 6) [1/m, 1], and Phi (m, 6, n), their derivatives by q.

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes, or arc lengths beyond the rod.
            StrainLimitError: if no strain balances the coordinates.
        """
        places = self.arc_lengths("arc_length", arc_length)
        q = checked_array("q", q, (self.coordinate_count,))
        # the strain, then a column of Phi for each coordinate
        shape = (1 + q.size, places.size, 6)
        rows = np.empty(shape)
        with self.configuration(q) as work:
            strain = work.strain
            still = np.zeros_like(q)
            no_tension = np.zeros(self.tendon_count)
            strain_from_guess(self.arm, q, TOLERANCE, strain, work.kinematics)
            strain_columns(self.arm, no_tension, q, still, strain, work.kinematics)
            columns = strain.Phi.reshape(q.size, -1)
            located = self.grid.locate(places)
            strains_inside(self.grid.length, *located, strain.xi, rows[0])
            columns_inside(self.grid.length, *located, columns, rows[1:])
        derivatives = np.moveaxis(rows[1:], 0, 2)
        return rows[0], derivatives

    @cached_property
    def discretisation(self) -> Discretisation:
        """The discretised rod as effects see it."""
        return at_points(self.scene, self.grid).rod

    @property
    def acting(self) -> dict[str, Effect]:
        """Effects that act as forces on the coordinates, by name.

        They stand in the order of the arm's table of effects.
        """
        return effects_outside(self.scene).acting()

    @property
    def length(self) -> float:
        """Length of the unstrained rod [m]."""
        return float(self.grid.breakpoints[-1])

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Meaning of the numbers of a state.

        An effect with internal states or other commands than tensions has an entry, "actuators:20";
        so have relaxation times.
        """
        counts = np.diff(self.arm.effects.first_state)
        sizes = counts.tolist()
        names = []
        for (name, effect), size in zip(self.acting.items(), sizes, strict=True):
            if size or effect.command_unit != "N":
                names.append(f"{name}:{size}")
        memory = self.scene.effects.viscoelastic_memory
        if memory is not None:
            times = [branch.relaxation_time for branch in memory.branches]
            names.append(f"relaxation times {times} s")
        return tuple(names)

    @cached_property
    def metric(self) -> Array:
        """Metric in which coordinates are compared, (n, n).

        It is the symmetric part of G of the unloaded arm.
        """
        rest = np.zeros(self.coordinate_count)
        G = self.terms(rest, rest).stiffness
        return np.asarray(0.5 * (G + G.T))

    @cached_property
    def metric_unit(self) -> Array:
        """Coordinates (n, n) that are orthonormal in the metric, unit^T G unit = 1."""
        root = np.linalg.cholesky(self.metric)
        return np.linalg.inv(root).T

    @cached_property
    def bending_energy(self) -> float:
        """Unit in which stiffnesses of coordinates compare: twice a bending energy [J].

        It is that of the rod bent evenly by an angle of 1.
        """
        points = self.grid.points.ravel()
        elasticity, _, _ = screw_matrices(self.scene, points)
        bending = elasticity[:, 1]
        weights = self.grid.weights.ravel()
        integral = float(bending @ weights)
        return integral / self.length**2

    def strain(self, q: ArrayLike) -> tuple[Array, Array]:
        """Computes the strain field at the quadrature points.

        Args:
            q: coordinates (n,).

        Returns:
            Arc lengths (m,) [m] of the points, and the strains xi = (k, p) there, (m, 6) [1/m, 1].

        Raises:
            TypeError: for an array that is not of numbers.
            ValueError: for a wrong shape or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
        """
        points = self.grid.points[self.grid.real]
        places = points.ravel()
        strains = self.grid.unpacked(self.packed_strain(q))
        return places, strains

    def packed_strain(self, q: ArrayLike) -> Array:
        """Strain at the points in the kernels' flat layout (points * 6,), see mechanics.types."""
        with self.configuration(q) as work:
            return work.strain.xi.copy()

    def tendon_lengths(self, q: ArrayLike) -> Array:
        """Computes the lengths of the tendons along the strained rod.

        Args:
            q: coordinates (n,).

        Returns:
            Lengths (n_a,) [m].

        Raises:
            TypeError: for an array that is not of numbers.
            ValueError: for a wrong shape or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
        """
        lengths = np.empty(self.tendon_count)
        with self.configuration(q) as work:
            strain = work.strain.xi
            tendon_lengths(self.arm.rod, self.arm.tendons, strain, lengths)
        return lengths

    def energy(self, q: ArrayLike, q_dot: ArrayLike, effects: ArrayLike | None = None) -> Energy:
        """Computes the kinetic, elastic and load energy.

        Args:
            q: coordinates (n,).
            q_dot: rates (n,).
            effects: internal states (m,); None is at rest.

        Returns:
            The energies [J].

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes, or an effect without a potential.
            StrainLimitError: if no strain balances the coordinates.
        """
        rod = self.arm.rod
        grid = self.grid
        rate = checked_array("q_dot", q_dot, (self.coordinate_count,))
        with self.workspace() as work:
            mass = self._evaluate(None, q, rate, 0.0, work).mass
            change = work.strain.xi - rod.reference_strain
            strain = grid.at_points(change, 6).reshape(-1, 6)
            state = work.inputs.state.copy()
            by_pack = work.kinematics.pose.reshape(-1, 12, LANES)
            by_node = by_pack.swapaxes(1, 2).reshape(-1, 12)
        if effects is not None:
            state = checked_array("effects", effects, state.shape)
        root_stiffness = grid.at_points(rod.root_stiffness, 6)
        root = root_stiffness.reshape(-1, 6)
        stiffness = root**2
        weight = grid.weights.ravel()
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
        # int xi^T Sigma xi dX
        density = (stiffness * strain**2).sum(axis=1)
        elastic = 0.5 * float(weight @ density)
        doubled = rate @ mass @ rate
        kinetic = 0.5 * float(doubled)
        load = self.scene.effects.potential_energy(configured)
        return Energy(kinetic, elastic, load)

    @property
    def command_unit(self) -> str:
        """Unit of commands: "N" of tensions, "m" of displacements of elastic tendons' actuators."""
        return self.scene.effects.command_unit

    def command(self, tension: ArrayLike, q: ArrayLike) -> Array:
        """Computes the command that holds tensions at rest.

        Args:
            tension: (n_a,) [N].
            q: coordinates (n,) at rest under them.

        Returns:
            The command (n_a,): tensions [N] or displacements [m], see `command_unit`.

        Raises:
            TypeError: for arrays that are not of numbers.
            ValueError: for wrong shapes or numbers that are not finite.
            StrainLimitError: if no strain balances the coordinates.
        """
        u = checked_array("tension", tension, (self.tendon_count,))
        path = self.arm.effects.transmission
        if not path.elastic:
            return u
        shortening = path.length - self.tendon_lengths(q)
        stretch = u / path.stiffness
        return np.asarray(stretch + shortening)

    def rest_coordinates(self, tension: ArrayLike) -> Array:
        """Returns the coordinates at rest under tensions alone, [u; 0] of (34).

        Args:
            tension: (n_a,) [N].

        Returns:
            Coordinates (n,).

        Raises:
            TypeError: for an array that is not of numbers.
            ValueError: for a wrong shape, or an explicit strain, whose coordinates are no tensions.
        """
        u = checked_array("tension", tension, (self.tendon_count,))
        if isinstance(self.arm.strain, Explicit):
            raise ValueError(
                "an explicit basis has no coordinates that equal tensions; use static_equilibrium"
            )
        return self.arm.strain.rest_coordinates(u)

    def coordinate_scale(self) -> Array:
        """Returns the unit of each coordinate: the amplitude that stores a bending energy.

        It is the energy of bending the arm by 1 rad.

        Returns:
            Units (n,).
        """
        stiffness = np.diag(self.metric)
        squares = self.bending_energy / stiffness
        return np.asarray(np.sqrt(squares))

    def arc_lengths(self, name: str, value: ArrayLike) -> Array:
        """Arc lengths (m,) [m] along the rod, checked.

        Raises TypeError or ValueError naming `name`.
        """
        # an empty list has no type of its own
        if np.size(value) == 0:
            value = np.zeros(0)
        places = checked_array(name, value, (None,))
        if not places.size:
            return places
        least = places.min()
        greatest = places.max()
        end = self.length * (1 + 1e-12)
        is_on_rod = least >= 0.0 and greatest <= end
        if not is_on_rod:
            raise ValueError(
                f"{name} should lie between 0 and {self.length:g}, not {least:g} to {greatest:g}"
            )
        return places

    @contextmanager
    def workspace(self) -> Iterator[Workspace]:
        """A workspace that nobody else uses, with the effects' states at rest.

        What it holds otherwise is of evaluations before.
        """
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
            is_finite = np.isfinite(work.kinematics.pose)
            is_placed = bool(is_finite.all())
            self._check(q, work, block, reached, is_placed)
            yield work

    def _check(self, q: Array, work: Workspace, block: int, reached: float, placed: bool) -> None:
        """Raises StrainLimitError where the strain was not found or the rod could not be placed.

        The block where it was not found is -1 for none.
        """
        if block >= 0:
            strain = work.strain.xi
            nearest = nearest_limit(self.arm, self.grid, q, strain, reached, block)
            if isinstance(self.arm.strain, Loaded):
                what = "coordinates and loads"
            else:
                what = "coordinates"
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
        """Terms at coordinates and rates, under tensions u, none for None, in a workspace."""
        q = checked_array("q", q, (self.coordinate_count,))
        q_dot = checked_array("q_dot", q_dot, (self.coordinate_count,))
        tension = np.zeros(self.tendon_count)
        if u is not None:
            tension = checked_array("tension", u, (self.tendon_count,))
        work.inputs.clock[0] = time
        out = _empty_terms(self.coordinate_count, self.tendon_count)
        has_states = work.inputs.state.size > 0
        block, reached, placed = equation_of_motion(
            self.arm, tension, q, q_dot, has_states, TOLERANCE, work, out
        )
        # without rates it is the mass that is infinite
        is_at_rest = not q_dot.any()
        is_too_large = placed == TOO_LARGE or (placed == TOO_FAST and is_at_rest)
        self._check(q, work, block, reached, not is_too_large)
        if placed == TOO_FAST:
            raise OverflowError(
                f"the rates q_dot are too large to compute with, up to {np.abs(q_dot).max():.3g}"
            )
        strain = self.arm.strain
        if isinstance(strain, Explicit):
            stiffness = strain.stiffness
        else:
            stiffness = out.stiffness
        out.elastic_force[:] = stiffness @ q
        return out

    def __reduce__(self) -> tuple[type[Model], tuple[Scene, Grid, Arm]]:
        parts = (self.scene, self.grid, self.arm)
        return Model, parts

    def __deepcopy__(self, memo: object) -> Model:
        return self  # copies of what has a model share it, since it never changes


def model_on(scene: Scene, intervals: int) -> Model:
    """Model of a scene on a quadrature with this many intervals per piece.

    The number holds whatever the scene says, and however coarse that is.
    """
    grid = make_grid(scene, intervals)
    return Model(scene, grid, make_arm(scene, grid))


def is_singular(matrix: Array) -> bool:
    """Whether the least eigenvalue of a matrix, scaled to a unit diagonal, is 0 to round-off."""
    scale = np.sqrt(np.diag(matrix))
    if not scale.min() > 0.0:
        return True
    scaled = matrix / np.outer(scale, scale)
    least = np.linalg.eigvalsh(scaled)[0]
    return not least > 1e-14


def _empty_terms(n: int, n_a: int) -> Terms:
    """Terms of n coordinates and n_a tendons, to be filled."""
    return Terms(
        mass=np.empty((n, n)),
        bias=np.empty(n),
        damping=np.empty((n, n)),
        stiffness=np.empty((n, n)),
        actuation=np.empty((n, n_a)),
        elastic_force=np.empty(n),
        external_force=np.empty(n),
        tip_pose=np.empty((4, 4)),
        tip_jacobian=np.empty((6, n)),
        tip_bias=np.empty(6),
        external_stiffness=np.empty((n, n)),
        external_damping=np.empty((n, n)),
    )


def _workspace_kind(arm: Arm) -> tuple[type, int, int]:
    """Kind of strain, number of effects and size of their state, which a workspace is made for."""
    effects = arm.effects
    kind = type(arm.strain)
    return kind, effects.count, effects.state.size


def _shapes(effects: EffectTable, count: int) -> list[tuple[int, ...]]:
    """Shapes of all numbers of the first effects of a table."""
    shapes = []
    for struct in effects.structs[:count]:
        for values in struct:
            shapes.append(np.shape(values))
    return shapes


def _poses(rows: Array) -> Array:
    """Poses (m, 4, 4) of rotations, row by row, and positions (m, 12)."""
    shape = (len(rows), 1, 1)
    poses = np.tile(np.eye(4), shape)
    rotation = rows[:, :9]
    poses[:, :3, :3] = rotation.reshape(-1, 3, 3)
    poses[:, :3, 3] = rows[:, 9:]
    return poses
