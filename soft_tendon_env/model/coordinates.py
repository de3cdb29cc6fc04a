"""Strain coordinates of a scene: what of the rod moves.

They are actuation and passive fields, independent tensions and explicit bases.
"""

import math

import numpy as np

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.mechanics.types import (
    Explicit,
    Loaded,
    StaticsBased,
    point_field,
)
from soft_tendon_env.model.grid import Grid, StressFreeArm, at_points, make_grid
from soft_tendon_env.scene.passive_fields import fields_of
from soft_tendon_env.scene.scene import MOST_INTERVALS, Scene, breakpoints
from soft_tendon_env.scene.strain import STRAINS, ExplicitBasis, Snapshots, mode_fields
from soft_tendon_env.scene.strain import StaticsBased as StaticsBasedStrain
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array

# intervals of each piece on which coordinates are counted, at least
COUNTING_INTERVALS = 6
# intervals of a resolving quadrature for the shortest wavelength of the geometry
PER_WAVE = 4.0
# intervals of a resolving quadrature for each Legendre function of a field
PER_FUNCTION = 3
# size of what is left of a unit vector beside a basis, up to which the basis spans it
SPANNED = 1e-6
# share of a tension in an independent combination, up to which it is round-off
NO_SHARE = 1e-12


def effects_inside(scene: Scene) -> bool:
    """Whether the strain answers to dead loads."""
    strain = scene.strain
    return isinstance(strain, StaticsBasedStrain) and strain.include_loads


def effects_outside(scene: Scene) -> Effects:
    """The effects that act as forces on the coordinates: all but those inside of the strain."""
    effects = scene.effects
    if effects_inside(scene):
        return effects.outside()
    return effects


def coordinate_count(scene: Scene) -> int:
    """How many coordinates the strain of a scene has.

    They are counted where the points of the quadrature tell all of its fields apart.
    """
    intervals = max(COUNTING_INTERVALS, resolving_intervals(scene))
    grid = make_grid(scene, intervals)
    stress_free = at_points(scene, grid)
    return make_strain(scene, grid, stress_free).size


def resolving_intervals(scene: Scene) -> int:
    """Intervals per piece on which no wave of the geometry and no field looks like another one.

    On fewer ones quadratures could agree with each other and be both wrong.
    """
    wavelengths = [tendon.routing.wavelength() for tendon in scene.tendons]
    for segment in scene.segments:
        tapers = segment.shape.tapers()
        for taper in tapers.values():
            wavelengths.append(taper.wavelength())
    shortest_wave = min(wavelengths)
    pieces = np.diff(breakpoints(scene))
    waves = PER_WAVE * pieces.max() / shortest_wave
    functions = scene.strain.highest_order + 1
    of_waves = math.ceil(waves)
    intervals = max(of_waves, PER_FUNCTION * functions)
    return min(intervals, MOST_INTERVALS)


def make_strain(
    scene: Scene, grid: Grid, stress_free: StressFreeArm, law: StaticsBased | None = None
) -> StaticsBased | Loaded | Explicit:
    """Arrays of the scene's strain parametrisation.

    Args:
        scene: of the arm.
        grid: of the scene's rod.
        stress_free: the arm at the points of the grid.
        law: of tensions and passive wrenches; None: made anew, where the strain needs one.

    Returns:
        An explicit basis, or the law, with its dead loads, if any.
    """
    if isinstance(scene.strain, ExplicitBasis):
        return _explicit_basis(scene.strain, grid, stress_free)
    assert isinstance(scene.strain, StaticsBasedStrain)  # the registry takes no others
    if law is None:
        law = tension_law(scene, scene.strain, grid, stress_free)
    dead_loads = scene.effects.dead_loads()
    has_loads_inside = effects_inside(scene) and np.any(dead_loads)
    if not has_loads_inside:
        return law
    return Loaded(
        size=law.size,
        pack_begin=np.zeros_like(law.pack_begin),
        pack_end=law.jacobian_end,
        jacobian_end=law.jacobian_end,
        law=law,
        **dead_loads._asdict(),
    )


def tension_law(
    scene: Scene, strain: StaticsBasedStrain, grid: Grid, stress_free: StressFreeArm
) -> StaticsBased:
    """Arrays of the strain law.

    They say which tensions are independent, and which passive fields are left beside them.
    """
    # of the inner product that energies are: int F^T Sigma^-1 G dX
    weights = grid.weights[..., None]
    weight = stress_free.compliance * weights
    actuation = stress_free.actuation
    gram = _inner(actuation, actuation, weight)
    mixing = independent_tensions(gram, strain.rank_tolerance)
    passive = _passive_fields(scene, strain, grid)
    if strain.passive_coordinates == "orthogonal":
        passive = _orthogonal_to(actuation, passive, weight, strain.rank_tolerance)
    tendons, active = mixing.shape
    size = active + len(passive)
    # where each coordinate strains the rod
    is_part = mixing.T != 0
    parts = is_part.astype(int) @ _intervals_of(actuation)
    active_present = parts > 0
    passive_present = _intervals_of(passive)
    present = np.concatenate([active_present, passive_present])
    begin, end = grid.pack_ranges(present)
    rows, columns = np.nonzero(mixing)
    return StaticsBased(
        size=size,
        pack_begin=begin,
        pack_end=end,
        jacobian_end=np.full(size, grid.packs),
        row_start=np.searchsorted(rows, np.arange(tendons + 1)),
        # the same type for all scenes and for copies, or the kernels compile again
        column=np.ascontiguousarray(columns),
        weight=mixing[rows, columns],
        mixed=int(active < tendons),
        active=active,
        passive=point_field(passive),
    )


def independent_tensions(gram: Array, tolerance: float) -> Array:
    """Basis of the independent tensions (n_a, rank).

    It is the identity where all are independent; else orthonormal and the same on every machine.

    Args:
        gram: inner products of the actuation columns (n_a, n_a).
        tolerance: relative size below which a combination of columns is dependent.
    """
    count = len(gram)
    scale = np.sqrt(np.diag(gram))
    # a tendon that strains nothing: all that it would strain is rigid
    scale[scale == 0] = 1.0
    scaled = gram / np.outer(scale, scale)
    sizes, directions = np.linalg.eigh(scaled)
    least = tolerance**2 * sizes[-1]
    is_independent = sizes > least
    if is_independent.all():
        return np.eye(count)
    independent = directions[:, is_independent]
    tensions = independent / scale[:, None]
    span, _ = np.linalg.qr(tensions)
    # eigenvectors may differ from machine to machine, and the projector to their span does not
    projector = span @ span.T
    rank = int(is_independent.sum())
    basis = _spanning_columns(projector, rank)
    columns = np.array(basis)
    mixing = columns.reshape(-1, count).T
    is_share = np.abs(mixing) > NO_SHARE
    return np.where(is_share, mixing, 0.0)


def _explicit_basis(strain: ExplicitBasis, grid: Grid, stress_free: StressFreeArm) -> Explicit:
    """Arrays of an explicit basis.

    Raises ConfigurationError where its fields are of another shape.
    """
    values = strain.fields(grid.points, grid.breakpoints)
    fields = np.asarray(values, dtype=np.float64)
    count = len(fields)
    expected = (count, *grid.points.shape, len(STRAINS))
    are_finite = np.isfinite(fields).all()
    if fields.shape != expected or not are_finite:
        text = f"has fields of shape {fields.shape}: they should be finite, and of shape {expected}"
        raise ConfigurationError([Problem(("strain",), text)])
    present = _intervals_of(fields)
    begin, end = grid.pack_ranges(present)
    weight = grid.weights[..., None]
    return Explicit(
        size=count,
        pack_begin=begin,
        pack_end=end,
        jacobian_end=np.full(count, grid.packs),
        field=point_field(fields),
        stiffness=_inner(fields, fields, stress_free.elasticity * weight),
        damping=_inner(fields, fields, stress_free.damping * weight),
    )


def _passive_fields(scene: Scene, strain: StaticsBasedStrain, grid: Grid) -> Array:
    """The passive fields as the scene has them, (fields, intervals, 2, 6)."""
    passive = strain.passive
    if isinstance(passive, Snapshots):
        own_fields = fields_of(scene)
        return own_fields.at(grid.points, passive.fields)
    return mode_fields(passive, grid.points, grid.breakpoints)


def _intervals_of(fields: Array) -> Array:
    """Whether fields (m, intervals, 2, 6) are present in each interval, (m, intervals)."""
    return np.asarray(fields.any(axis=(2, 3)))


def _spanning_columns(projector: Array, rank: int) -> list[Array]:
    """Orthonormal basis of what a projector (n, n) leaves, of its first columns that span it."""
    basis = list[Array]()
    for column in projector.T:
        spanned = np.zeros(len(projector))
        for vector in basis:
            amplitude = vector @ column
            spanned += vector * amplitude
        rest = column - spanned
        size = np.linalg.norm(rest)
        if len(basis) < rank and size > SPANNED:
            basis.append(rest / size)
    return basis


def _orthogonal_to(actuation: Array, passive: Array, weight: Array, tolerance: float) -> Array:
    """The parts of the passive fields orthogonal to the actuation fields and to each other.

    They are of unit energy; dependent ones are dropped.
    """
    weight = weight.ravel()
    fields = np.concatenate([actuation, passive])
    rows = fields.reshape(-1, weight.size)
    basis = list[Array]()
    actuation_rank = 0
    for i, field in enumerate(rows):
        rest = _orthogonal_part(field, basis, weight)
        size = _energy_norm(rest, weight)
        least = tolerance * _energy_norm(field, weight)
        if size > least:
            basis.append(rest / size)
            if i < len(actuation):
                actuation_rank += 1
    orthogonal = np.array(basis[actuation_rank:])
    shape = passive.shape[1:]
    return orthogonal.reshape(-1, *shape)


def _orthogonal_part(field: Array, basis: list[Array], weight: Array) -> Array:
    """The part of a field orthogonal to an orthonormal basis, by Gram-Schmidt."""
    rest = field
    # the second pass removes the rounding of the first
    for _ in range(2):
        for vector in basis:
            amplitude = vector @ (rest * weight)
            rest = rest - vector * amplitude
    return rest


def _energy_norm(field: Array, weight: Array) -> float:
    """Square root of the energy of a field, both (m,)."""
    energy = field @ (field * weight)
    return float(np.sqrt(energy))


def _inner(left: Array, right: Array, weight: Array) -> Array:
    """Inner products (m_left, m_right) of fields (m, intervals, 2, 6).

    Args:
        left: int left^T diag(density) right dX is computed.
        right: as left.
        weight: the density times the weight of the points, (intervals, 2, 6).
    """
    weighted = right * weight
    left_rows = left.reshape(len(left), -1)
    right_rows = weighted.reshape(len(right), -1)
    return left_rows @ right_rows.T
