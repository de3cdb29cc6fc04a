"""Strain coordinates of a scene: actuation and passive fields, independent tensions, explicit
bases; and all arrays of the arm."""

import numpy as np
from numpy.polynomial import legendre

from soft_tendon_env.effects.base import Effects
from soft_tendon_env.mechanics.algebra.lanes import aligned_copy
from soft_tendon_env.mechanics.types import Arm, Explicit, Loaded, StaticsBased, point_field
from soft_tendon_env.model.grid import (
    STRAIGHT,
    AtPoints,
    Grid,
    at_points,
    chords,
    make_grid,
    make_rod,
    pack_ranges,
)
from soft_tendon_env.scene.passive_fields import fields_of
from soft_tendon_env.scene.scene import Scene
from soft_tendon_env.scene.strain import STRAINS, ExplicitStrain, Modes, Snapshots
from soft_tendon_env.scene.strain import StaticsBased as StaticsBasedStrain
from soft_tendon_env.tools.configuration import ConfigurationError, Problem
from soft_tendon_env.tools.types import Array


def make_arm(
    scene: Scene, grid: Grid, strain: StaticsBased | Loaded | Explicit | None = None
) -> Arm:
    """All that the kernels read of a scene, on this grid; strain: with the combinations of tensions
    and passive fields that stay."""
    here = at_points(scene, grid)
    effects = effects_outside(scene).table(here.rod)
    if effects.base.any() and effects_inside(scene):
        text = (
            "is given, but the loads inside of a strain have to stand still beside the arm's base,"
            " which moves: leave it out"
        )
        raise ConfigurationError([Problem(("strain", "include_loads"), text)])
    law = None if strain is None or isinstance(strain, Explicit) else strain.law
    rod, strain = (
        make_rod(scene, grid, scene.strain.free, here),
        make_strain(scene, grid, here, law),
    )
    base = aligned_copy(np.append(scene.base.pose[:3, :3], scene.base.pose[:3, 3]))
    return Arm(base=base, rod=rod, tendons=here.tendons, strain=strain, effects=effects)


def effects_inside(scene: Scene) -> bool:
    """Whether the strain answers to dead loads."""
    return isinstance(scene.strain, StaticsBasedStrain) and scene.strain.include_loads


def effects_outside(scene: Scene) -> Effects:
    """The effects that act as forces on the coordinates: all but those inside of the strain."""
    return scene.effects.outside() if effects_inside(scene) else scene.effects


def coordinate_count(scene: Scene) -> int:
    """How many coordinates the strain of a scene has."""
    grid = make_grid(scene, 6)  # it does not depend on the intervals
    return make_strain(scene, grid, at_points(scene, grid)).size


def make_strain(
    scene: Scene, grid: Grid, here: AtPoints, law: StaticsBased | None = None
) -> StaticsBased | Loaded | Explicit:
    """Arrays of the scene's strain parametrisation: an explicit basis, or a law, made anew if None,
    with its dead loads, if any."""
    if isinstance(scene.strain, ExplicitStrain):
        fields = mode_fields(scene.strain.modes, grid)
        begin, end = pack_ranges(fields.any(axis=(2, 3)) & grid.real)
        stiffness, damping = (
            _inner(fields, fields, density, grid) for density in (here.elasticity, here.damping)
        )
        reach = {
            "size": len(fields),
            "pack_begin": begin,
            "pack_end": end,
            "jacobian_end": np.full(len(fields), grid.packs),
        }
        return Explicit(**reach, field=point_field(fields), stiffness=stiffness, damping=damping)
    law, dead = law or tension_law(scene, scene.strain, grid, here), scene.effects.dead_loads()
    if not (effects_inside(scene) and np.any(dead)):
        return law
    begin, end = np.zeros_like(law.pack_begin), law.jacobian_end
    return Loaded(
        size=law.size, pack_begin=begin, pack_end=end, jacobian_end=end, law=law, **dead._asdict()
    )


def mode_fields(modes: tuple[Modes, ...], grid: Grid) -> Array:
    """Legendre fields at the points: (fields, intervals, 2, 6); by piece, then strain, then
    order."""
    borders, length = grid.breakpoints, grid.breakpoints[-1]
    fields = []
    for group in modes:
        spans = (
            [(0.0, length)]
            if group.span == "rod"
            else list(zip(borders[:-1], borders[1:], strict=True))
        )
        for a, b in spans:
            inside = (grid.points > a) & (grid.points < b)
            values = (
                legendre.legvander(2 * (grid.points - a) / (b - a) - 1, group.order)
                * inside[..., None]
            )
            for strain in group.strains:
                block = np.zeros((group.order + 1, *grid.points.shape, 6))
                block[..., STRAINS.index(strain)] = np.moveaxis(values, -1, 0)
                fields += [*block]
    return np.array(fields).reshape(len(fields), *grid.points.shape, 6)


def tension_law(
    scene: Scene, strain: StaticsBasedStrain, grid: Grid, here: AtPoints
) -> StaticsBased:
    """Arrays of the strain law: which tensions are independent, and the passive fields that are
    left beside them."""
    exists = np.array([name in strain.strains for name in STRAINS], dtype=float)
    compliance = exists / here.elasticity
    actuation = actuation_columns(here.geometry, here.curvature, STRAIGHT)
    mixing = independent_tensions(
        _inner(actuation, actuation, compliance, grid), strain.rank_tolerance
    )
    if isinstance(strain.passive, Snapshots):
        passive = fields_of(scene).at(grid.points, strain.passive.fields)
    else:
        passive = mode_fields(strain.passive, grid)
    if strain.passive_coordinates == "orthogonal":
        passive = _orthogonal_to(actuation, passive, compliance, grid, strain.rank_tolerance)
    active = mixing.shape[1]
    rows, columns = np.nonzero(mixing)
    pulled = (mixing != 0).T.astype(int) @ actuation.any(axis=(2, 3)) > 0
    begin, end = pack_ranges(np.concatenate([pulled, passive.any(axis=(2, 3))]) & grid.real)
    return StaticsBased(
        size=active + len(passive),
        pack_begin=begin,
        pack_end=end,
        jacobian_end=np.full(active + len(passive), grid.packs),
        row_start=np.searchsorted(rows, np.arange(len(actuation) + 1)),
        column=np.ascontiguousarray(
            columns
        ),  # the same type for all scenes and for copies, or the kernels compile again
        weight=mixing[rows, columns],
        mixed=int(active < len(actuation)),
        active=active,
        passive=point_field(passive),
    )


def with_every_tension(arm: Arm) -> Arm:
    """The arm with a coordinate for every tension, those of redundant tendons too: it can be
    placed, and not moved."""
    strain, count = arm.strain, arm.tendons.size
    assert not isinstance(strain, Explicit)
    size = count + strain.law.size - strain.law.active
    begin, end, each = (
        np.zeros(size, dtype=np.int64),
        np.full(size, arm.rod.packs),
        np.arange(count),
    )
    everywhere = {"size": size, "pack_begin": begin, "pack_end": end, "jacobian_end": end}
    law = strain.law.replaced(
        **everywhere,
        row_start=np.arange(count + 1),
        column=each,
        weight=np.ones(count),
        mixed=0,
        active=count,
    )
    return arm.replaced(
        strain=strain.replaced(**everywhere, law=law) if isinstance(strain, Loaded) else law
    )


def actuation_columns(geometry: Array, k: Array, p: Array) -> Array:
    """Actuation columns Phi_a (.., 6) of tendons of this geometry (.., 5), see `tendon_geometry`,
    at strains k, p (.., 3)."""
    d, chord = chords(geometry, k, p)
    t = chord / np.linalg.norm(chord, axis=-1, keepdims=True)
    return np.asarray(
        -np.concatenate([np.cross(np.broadcast_to(d, t.shape), t), t], axis=-1) * geometry[..., 4:]
    )


def independent_tensions(gram: Array, tolerance: float) -> Array:
    """Basis of the independent tensions (n_a, rank), the identity where all are; else orthonormal
    and the same on every machine."""
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0] = 1.0  # a tendon that strains nothing: all that it would strain is rigid
    sizes, directions = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = sizes > tolerance**2 * sizes[-1]
    if keep.all():
        return np.eye(len(gram))
    span = np.linalg.qr(directions[:, keep] / scale[:, None])[0]
    projector = span @ span.T
    basis: list[Array] = []
    for column in projector.T:
        rest = column - sum((b * (b @ column) for b in basis), np.zeros(len(gram)))
        if len(basis) < keep.sum() and np.linalg.norm(rest) > 1e-6:
            basis.append(rest / np.linalg.norm(rest))
    mixing = np.array(basis).reshape(-1, len(gram)).T
    return np.where(np.abs(mixing) > 1e-12, mixing, 0.0)


def _orthogonal_to(
    actuation: Array, passive: Array, compliance: Array, grid: Grid, tolerance: float
) -> Array:
    """The parts of the passive fields orthogonal to the actuation fields and to each other, of unit
    energy; dependent ones dropped."""
    weight = (compliance * grid.weights[..., None]).ravel()
    basis, begin = list[Array](), 0  # of the passive ones
    for i, field in enumerate(np.concatenate([actuation, passive]).reshape(-1, weight.size)):
        rest = field
        for _ in range(2):  # the second pass removes the rounding of the first
            for b in basis:
                rest = rest - b * (b @ (rest * weight))
        before, left = (float(np.sqrt(part @ (part * weight))) for part in (field, rest))
        if left > tolerance * before:
            basis.append(rest / left)
            begin += i < len(actuation)
    return np.array(basis[begin:]).reshape(-1, *passive.shape[1:])


def _inner(left: Array, right: Array, weight: Array, grid: Grid) -> Array:
    """int left^T diag(weight) right dX for fields (m, intervals, 2, 6): (m_left, m_right)."""
    weighted = right * (weight * grid.weights[..., None])
    return left.reshape(len(left), -1) @ weighted.reshape(len(right), -1).T
