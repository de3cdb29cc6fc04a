"""Discretisation of the rod: its intervals, quadrature points and nodes.

There it has the section and tendons of the stress-free arm.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from soft_tendon_env.effects import Discretisation
from soft_tendon_env.effects.loads import weights
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.motion.batch import Places
from soft_tendon_env.mechanics.types import IntVector, Rod, Tendons, node_field, point_field
from soft_tendon_env.scene.scene import (
    Scene,
    Segment,
    along_rod,
    breakpoints,
    disc_rows,
    rod_radius,
    segment_index,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.scene.strain import STRAINS, Strain
from soft_tendon_env.tools.types import Array

# distance of the two Gauss points from the middle of an interval of length 1, and their places
GAUSS_FROM_MIDDLE = np.sqrt(3) / 6
GAUSS = np.array([0.5 - GAUSS_FROM_MIDDLE, 0.5 + GAUSS_FROM_MIDDLE])
# linear strain p without stretch and shear
STRAIGHT = np.array([1.0, 0.0, 0.0])
# intervals up to which closed Newton-Cotes rules have positive weights
LARGEST_PANEL = 7
# share of the rod's length by which a place on a border is moved into the piece that is looked at
INTO_PIECE = 1e-12


@dataclass(frozen=True)
class Grid:
    """Quadrature grid: intervals of the rod, padded with empty ones at the tip to whole packs."""

    start: Array  # (intervals,) [m]
    length: Array  # (intervals,) [m]
    points: Array  # (intervals, 2) [m]
    real: np.ndarray  # (intervals,) False where padded
    breakpoints: Array  # (pieces + 1,) [m]
    per_piece: int  # intervals of each piece between breakpoints

    @property
    def packs(self) -> int:
        """Number of packs of LANES intervals."""
        return self.length.size // LANES

    @property
    def weights(self) -> Array:
        """Weight of every point [m], (intervals, 2)."""
        half = 0.5 * self.length
        return np.stack([half, half], axis=1)

    def unpacked(self, field: Array) -> Array:
        """Strains (.., points, 6) at the points from base to tip.

        Args:
            field: strains (.., m) in the kernels' flat layout, see `mechanics.types`.
        """
        *lead, _ = field.shape
        padded = self.at_points(field, 6)
        strain = padded[..., self.real, :, :]
        from_base = np.ascontiguousarray(strain)
        return from_base.reshape(*lead, -1, 6)

    def packed(self, strain: Array) -> Array:
        """The inverse of `unpacked`; empty intervals get the strain of the last point."""
        *lead, count, _ = strain.shape
        every_point = np.arange(2 * self.real.size)
        last = count - 1
        source = np.minimum(every_point, last)
        filled = strain[..., source, :]
        by_interval = filled.reshape(*lead, -1, 2, 6)
        field = point_field(by_interval)
        return field.reshape(*lead, -1)

    def at_points(self, field: Array, components: int) -> Array:
        """Fields (.., intervals, 2, components) at the points, empty intervals among them.

        Args:
            field: (.., m) in the kernels' flat layout, see `mechanics.types`.
            components: numbers at each point.
        """
        *lead, _ = field.shape
        by_pack = field.reshape(*lead, self.packs, 2, components, LANES)
        by_lane = np.moveaxis(by_pack, -1, -3)
        return by_lane.reshape(*lead, -1, 2, components)

    def locate(self, arc_length: Array) -> tuple[IntVector, Array]:
        """The interval of each arc length (m,) [m] and the distance from its start [m]."""
        starts = self.start[self.real]
        starts_before = np.searchsorted(starts, arc_length, side="right")
        # a place at the base, or before it by round-off, is in the first
        interval = np.maximum(starts_before - 1, 0)
        own_start = starts[interval]
        distance = np.asarray(arc_length - own_start, dtype=np.float64)
        return interval.astype(np.int64), distance

    def places(self, stations: Array, sensors: Array) -> Places:
        """Places for kernels that read poses at stations and strains at sensors.

        Args:
            stations: arc lengths (m,) [m].
            sensors: arc lengths (k,) [m].
        """
        station, station_distance = self.locate(stations)
        sensor, sensor_distance = self.locate(sensors)
        return Places(
            station=station,
            station_distance=station_distance,
            sensor=sensor,
            sensor_distance=sensor_distance,
        )

    def pack_ranges(self, present: np.ndarray) -> tuple[IntVector, IntVector]:
        """First pack that holds a part of each field, and one past the last: (m,) each.

        A field that is nowhere gets all packs.

        Args:
            present: (m, intervals), whether a field is present in an interval.
        """
        in_rod = present & self.real
        rows = len(present)
        by_pack = in_rod.reshape(rows, self.packs, LANES)
        from_base = np.any(by_pack, axis=2)
        from_tip = np.flip(from_base, axis=1)
        begin = np.argmax(from_base, axis=1)
        empty_at_tip = np.argmax(from_tip, axis=1)
        end = self.packs - empty_at_tip
        begin_numbers = begin.astype(np.int64)
        end_numbers = end.astype(np.int64)
        return begin_numbers, end_numbers


class StressFreeArm(NamedTuple):
    """Section and shape of the stress-free arm at the points of a grid.

    The kernels' arrays of rod, tendons and strain are made from it.
    """

    elasticity: Array  # (intervals, 2, 6) diag(Sigma) [N m^2, N]
    compliance: Array  # (intervals, 2, 6) diag(Sigma)^-1, 0 for rigid strains
    damping: Array  # (intervals, 2, 6) diag(Upsilon)
    curvature: Array  # (intervals, 2, 3) [1/m]
    actuation: Array  # (n_a, intervals, 2, 6) the columns Phi_a, see `actuation_columns`
    tendons: Tendons
    rod: Discretisation  # as effects see it


def make_grid(scene: Scene, count: int) -> Grid:
    """Grid of `count` uniform intervals on every piece between breakpoints."""
    borders = breakpoints(scene)
    piece_start = borders[:-1, None]
    piece_length = np.diff(borders)[:, None]
    index = np.arange(count)
    in_piece = piece_length * index / count
    start = np.ravel(piece_start + in_piece)
    length = np.repeat(piece_length / count, count)
    in_interval = length[:, None] * GAUSS
    points = start[:, None] + in_interval
    # empty intervals at the tip, up to a whole pack
    size = start.size
    padding = -size % LANES
    tip = np.full(padding, borders[-1])
    no_length = np.zeros(padding)
    last_point = points[-1, 1]
    at_tip = np.full((padding, 2), last_point)
    interval = np.arange(size + padding)
    return Grid(
        start=np.append(start, tip),
        length=np.append(length, no_length),
        points=np.vstack([points, at_tip]),
        real=interval < size,
        breakpoints=borders,
        per_piece=count,
    )


def at_points(scene: Scene, grid: Grid) -> StressFreeArm:
    """Section and shape of the stress-free arm at the points of a grid.

    Lengths and turns of tendons are exact to second order in the intervals.
    """
    places = grid.points.ravel()
    elasticity, damping, _ = screw_matrices(scene, places)
    elasticity = elasticity.reshape(-1, 2, 6)
    index = segment_index(scene, grid.points)
    by_segment = [segment.curvature for segment in scene.segments]
    curvature = np.array(by_segment)[index]
    geometry = tendon_geometry(scene, grid)
    length, turn = _lengths_and_turns(geometry, curvature, grid)
    return StressFreeArm(
        elasticity=elasticity,
        compliance=_existing_strains(scene) / elasticity,
        damping=damping.reshape(-1, 2, 6),
        curvature=curvature,
        actuation=actuation_columns(geometry, curvature, STRAIGHT),
        tendons=_tendon_arrays(geometry, grid),
        rod=_discretisation(scene, grid, length, turn),
    )


def make_rod(scene: Scene, grid: Grid, stress_free: StressFreeArm) -> Rod:
    """Arrays of the rod's section for the kernels; strains that the scene has not are rigid."""
    exists = _existing_strains(scene)
    reference = np.empty_like(stress_free.elasticity)
    reference[..., :3] = stress_free.curvature
    reference[..., 3:] = STRAIGHT
    inertia, mass = _node_inertia(scene, grid, stress_free.rod)
    root_stiffness = np.sqrt(stress_free.elasticity)
    weight = grid.weights[..., None]
    return Rod(
        packs=grid.packs,
        free=_leading_strains(scene.strain.free),
        mass=inertia[:, 3].sum(keepdims=True),
        length=grid.length,
        weight=point_field(weight),
        root_compliance=point_field(exists / root_stiffness),
        root_stiffness=point_field(exists * root_stiffness),
        reference_strain=point_field(reference),
        viscosity=point_field(stress_free.damping * weight),
        inertia=node_field(inertia),
        node_mass=node_field(mass[:, None]),
    )


def screw_matrices(scene: Scene, arc_length: Array) -> tuple[Array, Array, Array]:
    """Diagonals of Sigma, Upsilon and the screw inertia density, each (m, 6), without discs.

    See `scene.sections`.

    Args:
        scene: of the rod.
        arc_length: (m,) [m].
    """

    def diagonals(segment: Segment, places: Array) -> Array:
        return segment.screw_matrices(places).reshape(18, -1)

    rows = along_rod(scene, arc_length, diagonals)
    by_matrix = rows.reshape(3, 6, -1)
    by_place = by_matrix.swapaxes(1, 2)
    elasticity, damping, inertia = np.ascontiguousarray(by_place)
    return elasticity, damping, inertia


def disc_inertia(discs: Array) -> Array:
    """Diagonals (d, 6) of the screw inertia [kg m^2, kg] of spacer discs, full cylinders.

    Args:
        discs: rows as of `disc_rows`.
    """
    _, mass, radius, thickness = discs.T
    squared_radius = radius**2
    # m r^2 / 2 about the axis, m (r^2 / 4 + t^2 / 12) across
    about_axis = mass * squared_radius / 2
    of_circle = squared_radius / 4
    of_thickness = thickness**2 / 12
    across = mass * (of_circle + of_thickness)
    diagonal = [about_axis, across, across, mass, mass, mass]
    return np.stack(diagonal, axis=-1)


def mass_moment_over_nodes(scene: Scene, grid: Grid) -> float:
    """Moment [kg m] of the rod's mass about its base, by the rule of the nodes, without discs."""

    def density(places: Array) -> Array:
        return _mass_moment_density(scene, places)[:, None]

    return float(over_nodes(grid, density).sum())


def mass_moment_over_points(scene: Scene, grid: Grid) -> float:
    """Moment [kg m] of the rod's mass about its base, by the rule of the points, without discs."""
    density = _mass_moment_density(scene, grid.points.ravel())
    return float(density @ grid.weights.ravel())


def newton_cotes(intervals: int) -> Array:
    """Closed Newton-Cotes weights on the nodes 0..intervals of a unit interval.

    They are composed of panels with positive weights, whose sizes differ by one at most.
    """
    panels = math.ceil(intervals / LARGEST_PANEL)
    smaller, larger_panels = divmod(intervals, panels)
    sizes = np.full(panels, smaller)
    sizes[:larger_panels] += 1
    weights = np.zeros(intervals + 1)
    first = 0
    for size in sizes:
        last = first + size
        half_weights = _panel_weights(size) * 0.5
        panel = half_weights * size / intervals
        weights[first : last + 1] += panel
        first = last
    return weights


def over_nodes(grid: Grid, density: Callable[[Array], Array]) -> Array:
    """Integral (intervals, k) of a line density over the slice of each node.

    The share of the base, which does not move, is left out.

    Args:
        grid: of the rod.
        density: a function from arc lengths (m,) [m] to (m, k).
    """
    count = grid.per_piece
    borders = grid.breakpoints
    into_piece = INTO_PIECE * borders[-1]
    weights = newton_cotes(count)[:, None]
    at_base = density(borders[:1])
    components = at_base.shape[1]
    nodes_in_all = grid.length.size
    total = np.zeros((nodes_in_all, components))
    first = 0  # node of the piece, beside the one on its first border
    for a, b in pairwise(borders):
        nodes = np.linspace(a, b, count + 1)
        # a node on a border has a share on either side
        least = a + into_piece
        greatest = b - into_piece
        inside = np.clip(nodes, least, greatest)
        scaled = (b - a) * weights
        shares = scaled * density(inside)
        behind = first + count
        total[first:behind] += shares[1:]
        if first > 0:
            total[first - 1] += shares[0]
        first = behind
    return total


def tendon_geometry(scene: Scene, grid: Grid) -> Array:
    """y, z [m], y', z' and presence (1 or 0) of every tendon at the points.

    Returns:
        The numbers (n_a, intervals, 2, 5).
    """
    places = grid.points.ravel()
    rows = list[Array]()
    for tendon in scene.tendons:
        start, end = tendon_ends(scene, tendon)
        on_tendon = np.clip(places, start, end)
        offset, slope = tendon_offset(scene, tendon, on_tendon)
        is_behind_start = places > start
        is_before_end = places < end
        presence = is_behind_start & is_before_end
        columns = [offset, slope, presence[:, None]]
        row = np.concatenate(columns, axis=1)
        rows.append(row)
    geometry = np.array(rows)
    shape = (len(rows), *grid.points.shape, 5)
    return geometry.reshape(shape)


def chords(geometry: Array, k: Array, p: Array) -> tuple[Array, Array]:
    """Offsets d and chords t_c (.., 3) of tendons, the paths' derivatives in the section (22).

    Args:
        geometry: (.., 5), see `tendon_geometry`.
        k: angular strains (.., 3) [1/m].
        p: linear strains (.., 3).
    """
    *lead, _ = geometry.shape
    offset = geometry[..., 0:2]
    slope = geometry[..., 2:4]
    # both lie in the section: their x is 0
    d = np.zeros((*lead, 3))
    d_prime = np.zeros((*lead, 3))
    d[..., 1:] = offset
    d_prime[..., 1:] = slope
    # t_c = k~ d + p + d'
    turned = np.cross(k, d)
    t_c = turned + p + d_prime
    return d, t_c


def actuation_columns(geometry: Array, k: Array, p: Array) -> Array:
    """Actuation columns Phi_a = -[d~ t; t] (.., 6) of tendons.

    Args:
        geometry: of the tendons (.., 5), see `tendon_geometry`.
        k: angular strains (.., 3) [1/m].
        p: linear strains (.., 3).
    """
    d, chord = chords(geometry, k, p)
    chord_size = np.linalg.norm(chord, axis=-1, keepdims=True)
    t = chord / chord_size
    d = np.broadcast_to(d, t.shape)
    moment = np.cross(d, t)
    push = np.concatenate([moment, t], axis=-1)
    presence = geometry[..., 4:]
    return np.asarray(-push * presence)


def _existing_strains(scene: Scene) -> Array:
    """1 for each of the six strains that the rod has, 0 for the rigid ones: (6,)."""
    exists = [strain in scene.strain.free for strain in STRAINS]
    return np.array(exists, dtype=float)


def _mass_moment_density(scene: Scene, arc_length: Array) -> Array:
    """Moment of the rod's mass about its base per length (m,) [kg] at arc lengths (m,) [m]."""
    _, _, inertia = screw_matrices(scene, arc_length)
    line_mass = inertia[:, 3]
    return arc_length * line_mass


def _lengths_and_turns(geometry: Array, curvature: Array, grid: Grid) -> tuple[Array, Array]:
    """Lengths [m] of the tendons along the stress-free rod, and angles [rad] by which they turn."""
    presence = geometry[..., 4]
    _, chord = chords(geometry, curvature, STRAIGHT)
    chord_size = np.linalg.norm(chord, axis=-1)
    length_at_points = chord_size * presence * grid.weights
    length = np.sum(length_at_points, axis=(1, 2))
    tangent = chord / chord_size[..., None]
    # points from base to tip, without the empty intervals
    count = len(geometry)
    real = grid.real
    real_tangent = tangent[:, real]
    tangent = real_tangent.reshape(count, -1, 3)
    real_presence = presence[:, real]
    presence = real_presence.reshape(count, -1)
    k = curvature[real].reshape(-1, 3)
    place = grid.points[real].ravel()
    # from point to point a tangent turns in the section, and with it
    distance = np.diff(place)[:, None]
    rate = np.cross(k, tangent)
    end_rate = rate[:, 1:]
    begin_rate = rate[:, :-1]
    rate_sum = end_rate + begin_rate
    with_section = 0.5 * distance * rate_sum
    in_section = np.diff(tangent, axis=1)
    angle = np.linalg.norm(in_section + with_section, axis=-1)
    # where a tendon ends between two points it does not turn
    present_after = presence[:, 1:]
    present_before = presence[:, :-1]
    present_at_both = present_after * present_before
    turn = np.sum(angle * present_at_both, axis=1)
    return np.asarray(length), np.asarray(turn)


def _tendon_arrays(geometry: Array, grid: Grid) -> Tendons:
    """The tendons as the kernels read them."""
    is_present = geometry[..., 4] > 0.0
    in_interval = np.any(is_present, axis=2)
    begin, end = grid.pack_ranges(in_interval)
    return Tendons(
        size=len(geometry),
        geometry=point_field(geometry),
        pack_begin=begin,
        pack_end=end,
    )


def _discretisation(
    scene: Scene, grid: Grid, tendon_length: Array, tendon_turn: Array
) -> Discretisation:
    """The discretised rod as effects see it."""

    def segment_hull(segment: Segment, places: Array) -> ArrayLike:
        return segment.shape.hull(places, segment.length)

    def segment_corners(segment: Segment, places: Array) -> ArrayLike:
        shape = (1, places.size)
        return np.full(shape, segment.shape.has_corners)

    def line_mass(arc_length: Array) -> Array:
        _, _, inertia = screw_matrices(scene, arc_length)
        return inertia[:, 3]

    tension_limits = [tendon.tension_limits for tendon in scene.tendons]
    return Discretisation(
        length=float(grid.breakpoints[-1]),
        borders=grid.breakpoints,
        node=grid.start + grid.length,
        point=grid.points,
        radius=lambda arc_length: rod_radius(scene, arc_length)[0],
        hull=lambda arc_length: along_rod(scene, arc_length, segment_hull),
        has_corners=lambda arc_length: along_rod(scene, arc_length, segment_corners)[0] > 0.0,
        discs=disc_rows(scene),
        elasticity=lambda arc_length: screw_matrices(scene, arc_length)[0],
        line_mass=line_mass,
        over_nodes=lambda density: over_nodes(grid, density),
        tendon_length=tendon_length,
        tendon_turn=tendon_turn,
        tension_limits=np.array(tension_limits),
        effects=scene.effects,
        step=scene.integrator.step,
    )


def _node_inertia(scene: Scene, grid: Grid, rod: Discretisation) -> tuple[Array, Array]:
    """Screw inertia (nodes, 6) [kg m^2, kg] with what effects add, and mass (nodes,) [kg].

    Gravity pulls at the mass.
    """
    effects = scene.effects

    def density(arc_length: Array) -> Array:
        _, _, inertia = screw_matrices(scene, arc_length)
        return inertia

    inertia = over_nodes(grid, density)
    disc_place = rod.discs[:, 0]
    share_of_disc = weights(rod, disc_place).T
    inertia += share_of_disc @ disc_inertia(rod.discs)
    mass = inertia[:, 3].copy()
    mass[-1] += effects.payload[3]
    inertia += effects.added_inertia(rod)
    inertia[-1] += effects.payload
    return inertia, mass


def _leading_strains(free: tuple[Strain, ...]) -> tuple[int, ...]:
    """Indices of the leading strains up to the last that is not rigid, as `Rod.free` has them."""
    stretch = STRAINS.index("stretch")
    numbers = (STRAINS.index(strain) for strain in free)
    last = max(numbers)
    if last < stretch:
        return tuple(range(3))
    if last == stretch:
        return tuple(range(4))
    return tuple(range(6))


def _panel_weights(size: int) -> Array:
    """Closed Newton-Cotes weights (size + 1,) on [-1, 1]: exact for powers up to `size`."""
    nodes = np.linspace(-1.0, 1.0, size + 1)
    powers = np.arange(size + 1)
    of_nodes = nodes ** powers[:, None]
    # integral of each power: (1 - (-1)^(p + 1)) / (p + 1)
    integral_powers = powers + 1
    at_left_end = (-1.0) ** integral_powers
    moments = (1.0 - at_left_end) / integral_powers
    weights = np.linalg.solve(of_nodes, moments)
    return np.asarray(weights, dtype=np.float64)
