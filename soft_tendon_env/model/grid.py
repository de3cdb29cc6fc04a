"""Discretisation of the rod: intervals, quadrature points and nodes, and the arrays of section and
tendons there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soft_tendon_env.effects import Discretisation
from soft_tendon_env.effects.loads import weights
from soft_tendon_env.mechanics.algebra.lanes import LANES
from soft_tendon_env.mechanics.motion.batch import Places
from soft_tendon_env.mechanics.types import IntVector, Rod, Tendons, node_field, point_field
from soft_tendon_env.scene.scene import (
    Scene,
    along_rod,
    breakpoints,
    disc_rows,
    rod_radius,
    segment_index,
    tendon_ends,
    tendon_offset,
)
from soft_tendon_env.scene.strain import STRAINS
from soft_tendon_env.tools.types import Array

GAUSS = np.array([0.5 - np.sqrt(3) / 6, 0.5 + np.sqrt(3) / 6])
STRAIGHT = np.array([1.0, 0.0, 0.0])  # p without stretch and shear
LARGEST_PANEL = 7  # closed Newton-Cotes rules have positive weights up to this many intervals


@dataclass(frozen=True)
class Grid:
    """Quadrature grid: intervals of the rod, padded with empty ones at the tip to whole packs."""

    start: Array  # (intervals,) [m]
    length: Array  # (intervals,) [m]
    points: Array  # (intervals, 2) [m]
    real: np.ndarray  # (intervals,) False where padded
    breakpoints: Array
    per_piece: int

    @property
    def packs(self) -> int:
        return self.length.size // LANES

    @property
    def weights(self) -> Array:
        """Weight of every point [m], (intervals, 2)."""
        return np.repeat(0.5 * self.length[:, None], 2, axis=1)

    def unpacked(self, field: Array) -> Array:
        """Strains (.., points, 6) at the points from base to tip, of fields (.., m) in the kernels'
        flat layout, see mechanics.types."""
        strain = self.at_points(field, 6)[..., self.real, :, :]
        return np.ascontiguousarray(strain).reshape(*field.shape[:-1], -1, 6)

    def packed(self, strain: Array) -> Array:
        """The inverse of `unpacked`; empty intervals get the strain of the last point."""
        lead, count = strain.shape[:-2], strain.shape[-2]
        filled = strain[..., np.minimum(np.arange(2 * self.real.size), count - 1), :]
        return point_field(filled.reshape(*lead, -1, 2, 6)).reshape(*lead, -1)

    def at_points(self, field: Array, components: int) -> Array:
        """Fields (.., m) in the kernels' flat layout as (.., intervals, 2, components), empty
        intervals among them."""
        lead = field.shape[:-1]
        packed = field.reshape(*lead, self.packs, 2, components, LANES)
        return np.moveaxis(packed, -1, -3).reshape(*lead, -1, 2, components)

    def locate(self, arc_length: Array) -> tuple[IntVector, Array]:
        """The interval of each arc length (m,) [m] and the distance from its start [m]."""
        starts = self.start[self.real]
        interval = np.clip(np.searchsorted(starts, arc_length, side="right") - 1, 0, None)
        return interval.astype(np.int64), np.asarray(
            arc_length - starts[interval], dtype=np.float64
        )

    def places(self, stations: Array, sensors: Array) -> Places:
        """Places for kernels that read poses at stations and strains at sensors, from their arc
        lengths (m,) [m]."""
        (station, station_distance), (sensor, sensor_distance) = (
            self.locate(stations),
            self.locate(sensors),
        )
        return Places(
            station=station,
            station_distance=station_distance,
            sensor=sensor,
            sensor_distance=sensor_distance,
        )


def make_grid(scene: Scene, count: int) -> Grid:
    """Grid of `count` uniform intervals on every piece between breakpoints."""
    borders = breakpoints(scene)
    starts = np.concatenate(
        [
            a + (b - a) * np.arange(count) / count
            for a, b in zip(borders[:-1], borders[1:], strict=True)
        ]
    )
    lengths = np.repeat(np.diff(borders) / count, count)
    points = starts[:, None] + lengths[:, None] * GAUSS
    padding = -starts.size % LANES
    start, length = (
        np.append(starts, np.full(padding, borders[-1])),
        np.append(lengths, np.zeros(padding)),
    )
    points = np.vstack([points, np.full((padding, 2), points[-1, 1])])
    return Grid(start, length, points, np.arange(start.size) < starts.size, borders, count)


def newton_cotes(intervals: int) -> Array:
    """Closed Newton-Cotes weights on the nodes 0..intervals of a unit interval, composed of panels
    with positive weights."""
    panels = -(-intervals // LARGEST_PANEL)
    weights, first = np.zeros(intervals + 1), 0
    for size in np.full(panels, intervals // panels) + (np.arange(panels) < intervals % panels):
        nodes, powers = np.linspace(-1.0, 1.0, size + 1), np.arange(size + 1)
        moments = (1.0 - (-1.0) ** (powers + 1)) / (powers + 1)
        weights[first : first + size + 1] += (
            np.linalg.solve(nodes ** powers[:, None], moments) * 0.5 * size / intervals
        )
        first += size
    return weights


def screw_matrices(scene: Scene, arc_length: Array) -> tuple[Array, Array, Array]:
    """Diagonals of Sigma, Upsilon and the screw inertia density at arc lengths (m,), each (m, 6),
    without discs. See scene.sections."""
    rows = along_rod(
        scene, arc_length, lambda segment, places: segment.screw_matrices(places).reshape(18, -1)
    )
    elasticity, damping, inertia = np.ascontiguousarray(rows.reshape(3, 6, -1).swapaxes(1, 2))
    return elasticity, damping, inertia


def disc_inertia(discs: Array) -> Array:
    """Diagonals (d, 6) of the screw inertia [kg m^2, kg] of spacer discs, full cylinders; rows as
    of `disc_rows`."""
    _, mass, radius, thickness = discs.T
    across = mass * (radius**2 / 4 + thickness**2 / 12)
    return np.stack([mass * radius**2 / 2, across, across, mass, mass, mass], axis=-1)


class AtPoints(NamedTuple):
    """Section and shape of the stress-free arm at the points of a grid, which rod, tendons and
    strain are all made from."""

    elasticity: Array  # (intervals, 2, 6) diag(Sigma) [N m^2, N]
    damping: Array  # (intervals, 2, 6) diag(Upsilon)
    curvature: Array  # (intervals, 2, 3) [1/m]
    geometry: Array  # (n_a, intervals, 2, 5), see `tendon_geometry`
    tendons: Tendons
    rod: Discretisation  # as effects see it


def at_points(scene: Scene, grid: Grid) -> AtPoints:
    """Section and shape at the points of a grid; lengths and turns of tendons to second order in
    the intervals."""
    elasticity, damping, _ = (
        m.reshape(-1, 2, 6) for m in screw_matrices(scene, grid.points.ravel())
    )
    k = np.array([segment.curvature for segment in scene.segments])[
        segment_index(scene, grid.points)
    ]
    geometry = tendon_geometry(scene, grid)
    _, chord = chords(geometry, k, STRAIGHT)
    size = np.linalg.norm(chord, axis=-1)
    length = (size * geometry[..., 4] * grid.weights).sum(axis=(1, 2))
    t = (chord / size[..., None])[:, grid.real].reshape(len(chord), -1, 3)
    there = geometry[..., 4][:, grid.real].reshape(len(chord), -1)
    rate, distance = (
        np.cross(k[grid.real].reshape(-1, 3), t),
        np.diff(grid.points[grid.real].ravel())[:, None],
    )
    turn = np.diff(t, axis=1) + 0.5 * distance * (rate[:, 1:] + rate[:, :-1])
    angle = (np.linalg.norm(turn, axis=-1) * there[:, 1:] * there[:, :-1]).sum(axis=1)
    begin, end = pack_ranges((geometry[..., 4] > 0.0).any(axis=2) & grid.real)
    tendons = Tendons(
        size=len(geometry), geometry=point_field(geometry), pack_begin=begin, pack_end=end
    )
    rod = Discretisation(
        length=float(grid.breakpoints[-1]),
        borders=grid.breakpoints,
        node=grid.start + grid.length,
        point=grid.points,
        radius=lambda arc_length: rod_radius(scene, arc_length)[0],
        hull=lambda arc_length: along_rod(
            scene, arc_length, lambda segment, places: segment.shape.hull(places, segment.length)
        ),
        discs=disc_rows(scene),
        elasticity=lambda arc_length: screw_matrices(scene, arc_length)[0],
        line_mass=lambda arc_length: screw_matrices(scene, arc_length)[2][:, 3],
        over_nodes=lambda density: over_nodes(grid, density),
        tendon_length=length,
        tendon_turn=np.asarray(angle),
        tension_limits=np.array([tendon.tension_limits for tendon in scene.tendons]),
        effects=scene.effects,
        step=scene.integrator.step,
    )
    return AtPoints(elasticity, damping, k, geometry, tendons, rod)


def make_rod(scene: Scene, grid: Grid, free: tuple[str, ...], here: AtPoints) -> Rod:
    """Arrays of the rod's section; strains not named in `free` are rigid."""
    exists = np.array([strain in free for strain in STRAINS], dtype=float)
    reference = np.zeros((*grid.points.shape, 6))
    reference[..., :3] = here.curvature
    reference[..., 3] = 1.0
    inertia = over_nodes(grid, lambda arc_length: screw_matrices(scene, arc_length)[2])
    inertia += weights(here.rod, here.rod.discs[:, 0]).T @ disc_inertia(here.rod.discs)
    mass = inertia[:, 3].copy()
    mass[-1] += scene.effects.payload[3]
    inertia += scene.effects.added_inertia(here.rod)
    inertia[-1] += scene.effects.payload
    last = max(STRAINS.index(strain) for strain in free)
    return Rod(
        packs=grid.packs,
        free=tuple(range(3 if last < 3 else 4 if last == 3 else 6)),
        mass=inertia[:, 3].sum(keepdims=True),
        length=grid.length,
        weight=point_field(grid.weights[..., None]),
        root_compliance=point_field(exists / np.sqrt(here.elasticity)),
        root_stiffness=point_field(exists * np.sqrt(here.elasticity)),
        reference_strain=point_field(reference),
        viscosity=point_field(here.damping * grid.weights[..., None]),
        inertia=node_field(inertia),
        node_mass=node_field(mass[:, None]),
    )


def over_nodes(grid: Grid, density: Callable[[Array], Array]) -> Array:
    """Integral of a line density, a function from arc lengths (m,) [m] to (m, k), over the slice of
    each node: (intervals, k)."""
    weights = newton_cotes(grid.per_piece)
    inside = 1e-12 * grid.breakpoints[-1]  # a node on a border has a share on either side
    total = np.zeros((grid.length.size, density(grid.breakpoints[:1]).shape[1]))
    for piece, (a, b) in enumerate(zip(grid.breakpoints[:-1], grid.breakpoints[1:], strict=True)):
        nodes = np.clip(np.linspace(a, b, grid.per_piece + 1), a + inside, b - inside)
        shares = (b - a) * weights[:, None] * density(nodes)
        first = piece * grid.per_piece
        total[first : first + grid.per_piece] += shares[1:]
        if piece:
            total[first - 1] += shares[0]
    return total


def tendon_geometry(scene: Scene, grid: Grid) -> Array:
    """y, z [m], y', z' and presence (1 or 0) of every tendon at the points: (n_a, intervals, 2,
    5)."""
    geometry = np.zeros((len(scene.tendons), *grid.points.shape, 5))
    for values, tendon in zip(geometry, scene.tendons, strict=True):
        start, end = tendon_ends(scene, tendon)
        offset, slope = tendon_offset(scene, tendon, np.clip(grid.points, start, end).ravel())
        values[..., 0:2], values[..., 2:4] = (
            offset.reshape(*grid.points.shape, 2),
            slope.reshape(*grid.points.shape, 2),
        )
        values[..., 4] = (grid.points > start) & (grid.points < end)
    return geometry


def chords(geometry: Array, k: Array, p: Array) -> tuple[Array, Array]:
    """Offsets and chords (.., 3), the paths' derivatives in the section, of tendons of a geometry
    (.., 5) at strains k, p (.., 3)."""
    d, d_prime = np.zeros((2, *geometry.shape[:-1], 3))
    d[..., 1:], d_prime[..., 1:] = geometry[..., 0:2], geometry[..., 2:4]
    return d, np.cross(k, d) + p + d_prime


def pack_ranges(intervals: np.ndarray) -> tuple[IntVector, IntVector]:
    """First pack with a marked interval, and one past the last, of each row (m, intervals): (m,)
    each."""
    marked = np.asarray(
        intervals.reshape(len(intervals), intervals.shape[1] // LANES, LANES).any(axis=2)
    )
    first, behind = marked.argmax(axis=1), marked[:, ::-1].argmax(axis=1)
    return first.astype(np.int64), (marked.shape[1] - behind).astype(np.int64)
